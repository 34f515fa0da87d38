"""Safe loading of YAML, JSON, npz and packed files of others. Limits are checked before a file's values are created."""

import io
import json
import stat
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final
from zipfile import ZIP_DEFLATED, ZIP_STORED, ZipFile

import numpy as np
import yaml

from behavexplor.data.array_types import Array
from behavexplor.errors import InputError, brief

MAX_NODES: Final = 100_000  # nodes in a YAML file; an alias counts as often as it is used
MAX_DEPTH: Final = 40  # nesting depth of values in a YAML file
MAX_DIGITS: Final = 100  # characters of an integer in a YAML file; Python cannot write very long ones as text
MAX_JSON_LENGTH: Final = 1_000_000  # characters; a scenario of the paper has about 1500
MAX_ARRAY_BYTES: Final = 200_000_000  # unpacked size of all arrays in an npz file
MAX_FILE_BYTES: Final = 100_000_000  # size of a file that is read as a whole, unless a reader says otherwise

_GZIP: Final = 31  # tells zlib that data has the header of gzip
_MERGE: Final = "tag:yaml.org,2002:merge"  # of the key `<<`
_INTEGER: Final = "tag:yaml.org,2002:int"


def read_file(path: Path, most: int = MAX_FILE_BYTES, *, pipes: bool = False) -> bytes:
    """Return the contents of a file of at most `most` bytes.

    A pipe is refused, because it might be waited for without end. With `pipes`, for a file that the user names, a pipe
    with which the process was started is read as well, such as /dev/stdin or that of a shell's `<(...)`.

    Raises:
        InputError: if it is not a regular file, or too large.
        OSError: if it cannot be read.
    """
    status = path.stat()
    is_file = stat.S_ISREG(status.st_mode)
    is_given = pipes and path.is_relative_to("/dev")
    if not (is_given or is_file or stat.S_ISDIR(status.st_mode)):  # opening a folder says what it is
        raise InputError(f"{path} is not a regular file")
    is_too_large = is_file and status.st_size > most
    data = b""
    if not is_too_large:
        with path.open("rb") as file:
            data = file.read(most + 1)
    if is_too_large or len(data) > most:
        raise InputError(f"{path} has more than {most} bytes, which are not read")
    if data.startswith(b"version https://git-lfs"):
        raise InputError(f"{path} only says where Git LFS has the file: fetch it by `git lfs pull` in its repository")
    return data


def parse_yaml(text: str, loader: type[yaml.SafeLoader] = yaml.SafeLoader) -> Any:
    """Return the value of a YAML document.

    Raises:
        ValueError: if the text is not YAML, has a key twice, or its value would become too large or too deep.
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
    except (yaml.YAMLError, LookupError, AttributeError, TypeError) as error:  # odd tags and keys raise the last three
        raise ValueError(" ".join(str(error).split())) from None


def _extent(node: yaml.Node, known: dict[int, tuple[int, int]]) -> tuple[int, int]:
    """Return the number of nodes in a node, with aliases expanded, and their depth; check depth, integers and keys."""
    if node.tag == _INTEGER and len(node.value) > MAX_DIGITS:
        raise ValueError("an integer in it is too long")
    if id(node) not in known:
        _check_keys(node)
        known[id(node)] = (0, MAX_DEPTH)  # found if the node contains itself, and too deep then
        extents = [_extent(child, known) for child in _children(node)]
        depth = 1 + max((deep for _, deep in extents), default=0)
        if depth > MAX_DEPTH:
            raise ValueError("its values are nested too deeply")
        known[id(node)] = (1 + sum(count for count, _ in extents), depth)
    return known[id(node)]


def _check_keys(node: yaml.Node) -> None:
    """Refuse a mapping that has a key twice: the loader would keep the last one."""
    keys = [key for key, _ in node.value] if isinstance(node, yaml.MappingNode) else []
    seen = set()
    for key in keys:
        if not isinstance(key, yaml.ScalarNode) or key.tag == _MERGE:
            continue
        if (key.tag, key.value) in seen:
            raise ValueError(f"the key {key.value!r:.80} stands twice, again in line {key.start_mark.line + 1}")
        seen.add((key.tag, key.value))


def _children(node: yaml.Node) -> list[yaml.Node]:
    if isinstance(node, yaml.MappingNode):
        return [child for pair in node.value for child in pair]
    return list(node.value) if isinstance(node, yaml.SequenceNode) else []


def parse_json(text: str, what: str) -> Any:
    """Return the value of a JSON document. `what` says for error messages what it should be, such as "a scenario".

    Raises:
        InputError: if the text is too long or not JSON.
    """
    if len(text) > MAX_JSON_LENGTH:
        raise InputError(f"{what.capitalize()} of {len(text)} characters is too long: the limit is {MAX_JSON_LENGTH}.")
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"Not {what} in JSON: {error}") from None


def object_fields(what: str, value: object, names: tuple[str, ...]) -> dict[str, Any]:
    """Return the fields of a JSON object that must have exactly these names.

    Raises:
        InputError: if the value is not an object, or a field is missing or unknown.
    """
    if not isinstance(value, dict):
        raise InputError(f"{what} must be an object with {', '.join(names)}, got {brief(value)}")
    for name in names:
        if name not in value:
            raise InputError(f"{name}: missing")
    for name in value:
        if name not in names:
            raise InputError(f"{name!r:.80} is not a field of {what}; the fields are {', '.join(names)}")
    return value


def read_arrays(data: bytes) -> Mapping[str, Array]:
    """Read the arrays in an npz file, by name. No code in the file is executed.

    Raises:
        ValueError: if it is not an npz file, is damaged, or would unpack to more than `MAX_ARRAY_BYTES`.
    """
    try:
        with ZipFile(io.BytesIO(data)) as file:
            if (size := unpacked_size(file)) > MAX_ARRAY_BYTES:
                raise ValueError(f"it would unpack to {size} bytes, more than {MAX_ARRAY_BYTES}")  # noqa: TRY301
            members = {name.removesuffix(".npy"): io.BytesIO(member(file, name)) for name in file.namelist()}
        return {name: np.lib.format.read_array(content, allow_pickle=False) for name, content in members.items()}
    except Exception as error:  # zipfile, zlib and numpy raise a dozen kinds of errors for damaged files
        raise ValueError(" ".join(f"{type(error).__name__}: {error}".split())[:300]) from None


def unpacked_size(file: ZipFile) -> int:
    """Return how many bytes the members of a zip file have, as it says.

    Raises:
        ValueError: if they are compressed by a method that `member` could not stop at this size.
    """
    if any(one.compress_type not in (ZIP_STORED, ZIP_DEFLATED) for one in file.infolist()):
        raise ValueError("it is compressed by another method than deflate")
    return sum(one.file_size for one in file.infolist())


def member(file: ZipFile, name: str) -> bytes:
    """Return a member of a zip file, at most as many bytes as the file states. `ZipFile.read` has no such limit."""
    with file.open(name) as opened:
        return opened.read(file.getinfo(name).file_size)


def decompressed(data: bytes, most: int = MAX_FILE_BYTES) -> bytes:
    """Return what gzip has compressed.

    Raises:
        ValueError: if it is cut short, or would unpack to more than `most` bytes.
        zlib.error: if it is damaged.
    """
    stream = zlib.decompressobj(_GZIP)
    found = stream.decompress(data, most)
    if not stream.eof:
        raise ValueError(f"it is cut short, or would unpack to more than {most} bytes")
    return found
