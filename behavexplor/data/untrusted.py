"""Plain values from files of strangers: limits are kept before anything is made of what a file claims to hold."""

import io
from collections.abc import Mapping
from typing import Any, Final
from zipfile import ZipFile

import numpy as np
import yaml
from numpy.typing import NDArray

MAX_NODES: Final = 100_000  # of a YAML file, each alias counted as often as it is used
MAX_DEPTH: Final = 40  # of values within values in a YAML file
MAX_ARRAY_BYTES: Final = 200_000_000  # of all arrays in an npz file


def parse_yaml(text: str, loader: type[yaml.SafeLoader] = yaml.SafeLoader) -> Any:
    """The value of a YAML document.

    Args:
        text: the document.
        loader: makes the values.

    Raises:
        ValueError: if it is none, or would become too large.
    """
    try:
        making = loader(text)
        try:
            node = making.get_single_node()
            if node is None:
                return None
            if _extent(node, {})[0] > MAX_NODES:
                raise ValueError("its aliases make it too large")
            return making.construct_document(node)
        finally:
            making.dispose()
    except RecursionError:
        raise ValueError("its values are nested too deeply") from None
    except (yaml.YAMLError, LookupError, AttributeError, TypeError) as error:  # the latter for odd tags and keys
        raise ValueError(" ".join(str(error).split())) from None


def _extent(node: yaml.Node, known: dict[int, tuple[int, int]]) -> tuple[int, int]:
    """How many nodes there are in a node, aliases expanded, and how deep they lie.

    Raises:
        ValueError: if they lie too deep, or a node lies within itself.
    """
    if id(node) not in known:
        known[id(node)] = (0, MAX_DEPTH)  # of whoever finds itself inside
        extents = [_extent(child, known) for child in _children(node)]
        depth = 1 + max((deep for _, deep in extents), default=0)
        if depth > MAX_DEPTH:
            raise ValueError("its values are nested too deeply")
        known[id(node)] = (1 + sum(count for count, _ in extents), depth)
    return known[id(node)]


def _children(node: yaml.Node) -> list[yaml.Node]:
    if isinstance(node, yaml.MappingNode):
        return [child for pair in node.value for child in pair]
    return list(node.value) if isinstance(node, yaml.SequenceNode) else []


def read_arrays(data: bytes) -> Mapping[str, NDArray[Any]]:
    """The arrays in an npz file by name; nothing in it is ever executed.

    Raises:
        ValueError: if it is none, is damaged, or would unpack to too much.
    """
    try:
        with ZipFile(io.BytesIO(data)) as file:
            size = sum(member.file_size for member in file.infolist())
        if size > MAX_ARRAY_BYTES:
            raise ValueError(f"it would unpack to {size} bytes, which nothing needs")  # noqa: TRY301
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            return {name: arrays[name] for name in arrays.files}
    except Exception as error:  # damaged zips and arrays make zipfile, zlib and numpy raise a dozen kinds
        raise ValueError(" ".join(f"{type(error).__name__}: {error}".split())[:300]) from None
