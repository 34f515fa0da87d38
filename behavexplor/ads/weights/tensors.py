"""Files of weights, read without executing anything: those that torch writes, and safetensors."""

import hashlib
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from math import prod
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final
from zipfile import ZipFile

import numpy as np
from safetensors import SafetensorError, deserialize

from behavexplor.ads.sb3.archive import SAVE_WEIGHTS, opened_torch, suspicions_about
from behavexplor.ads.sb3.inert import MAX_DEPTH, MAX_PARTS, OLD_TORCH, Inert, Name, PickleReader, TooLongError
from behavexplor.ads.sb3.normalization import as_mapping
from behavexplor.data.array_types import Array
from behavexplor.data.untrusted import member, read_file
from behavexplor.errors import InputError

MAX_BYTES: Final = 200_000_000  # greatest size of a file
_DTYPES: Final[Mapping[str, str]] = MappingProxyType(
    {"Float": "<f4", "Double": "<f8", "Half": "<f2", "BFloat16": "<u2", "Long": "<i8", "Int": "<i4"}
    | {"Short": "<i2", "Char": "<i1", "Byte": "<u1", "Bool": "<u1"}
)
_OF_SAFETENSORS: Final[Mapping[str, str]] = MappingProxyType({"F32": "Float", "F64": "Double", "F16": "Half"})
MAX_HEADER: Final = 5_000_000  # greatest size of the header of safetensors
MAX_MEMBERS: Final = 20_000  # members of a file of torch, which has one for each tensor
_MEMBER: Final = b"PK\x01\x02"  # begins the entry of a member
_OPTIMIZER: Final = re.compile(r"optim(?!al)")


@dataclass(frozen=True)
class TensorFile:
    """The contents of a file of weights."""

    path: Path  # path of the file
    digest: str  # its digest, "sha256:..."
    size: int  # its size [bytes]
    # the tensors by their dotted names, such as "q_net.fc1.weight", in the order of the file. Those of optimizers are
    # left out.
    arrays: Mapping[str, Array] = field(repr=False)
    in_order: bool = True  # whether this order is the one in which the layers were made
    suspicions: tuple[str, ...] = ()  # unusual calls that unpickling the file would make, each as a phrase


def read_tensors(path: Path) -> TensorFile:
    """Read a file of weights.

    Raises:
        InputError: if it is no such file, is damaged or too large, or has no tensors.
    """
    try:
        data = read_file(path, MAX_BYTES)
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
    digest = f"sha256:{hashlib.sha256(data).hexdigest()}"
    if path.suffix == ".safetensors":
        return TensorFile(path, digest, len(data), _of_safetensors(path, data), in_order=False)
    if data.startswith(OLD_TORCH):
        raise InputError(
            f"{path} has the format of torch before 1.6, which is not read: load it with torch.load(..., "
            "weights_only=True), and save it again by torch.save"
        )
    if not data.startswith(b"PK"):
        raise InputError(f"{path} is not a file that torch.save writes: {SAVE_WEIGHTS}")
    try:
        return tensors_in(path, data, digest)
    except InputError:
        raise
    except TooLongError as error:
        raise InputError(f"The pickle in {path} has {error}, which no policy needs: {SAVE_WEIGHTS}") from None
    except Exception as error:  # zipfile, zlib and numpy raise many kinds of errors for damaged files
        raise InputError(f"{path} is not a file that torch.save writes, or is damaged: {error}") from None


def tensors_in(path: Path, data: bytes, digest: str) -> TensorFile:
    """Return the tensors in what torch has written; see `read_tensors`.

    Raises:
        InputError: if it has none, or would unpack to more bytes than it has.
        Exception: of many kinds, if it is damaged.
    """
    if data.count(_MEMBER) > MAX_MEMBERS:
        raise InputError(f"{path} has more than {MAX_MEMBERS} members, which no policy needs; it was not read")
    with opened_torch(str(path), data) as file:
        names = file.namelist()
        root = next((name.removesuffix("data.pkl") for name in names if name.endswith("/data.pkl")), None)
        if root is None:
            raise InputError(f"{path} is not a file that torch.save writes: it has no data.pkl")
        if f"{root}byteorder" in names and member(file, f"{root}byteorder") != b"little":
            raise InputError(f"{path} was written on a machine of another byte order, which is not read")
        content, called = PickleReader().read(member(file, f"{root}data.pkl"))
        storages = _Storages(file, root)
        entries = list(_entries(content))
        arrays = {name: storages.tensor(one) for name, one in entries if _is_tensor(one)}
    if not arrays:
        raise InputError(_without_tensors(path, content, entries))
    suspicions = tuple(suspicions_about("its pickle", called))
    return TensorFile(path, digest, len(data), MappingProxyType(arrays), suspicions=suspicions)


def _without_tensors(path: Path, content: Any, entries: list[tuple[str, Any]]) -> str:
    """Return a sentence on a file that has no tensors where a policy has them."""
    modules = [one for one in (content, *(one for _, one in entries)) if isinstance(one, Inert)]
    whole = next((one.name for one in modules if isinstance(one.state, dict) and "_parameters" in one.state), None)
    if whole is not None:
        return f"{path} holds a whole pickled module ({whole}), whose code is not run: {SAVE_WEIGHTS}"
    return f"{path} holds no tensors of a network: {SAVE_WEIGHTS}"


def _entries(content: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[str, Any]]:
    """Yield what the dictionaries of a file hold, except optimizers, by dotted name."""
    count, waiting = 0, [(path, content)]
    while waiting:
        path, value = waiting.pop()
        count += 1
        if count > MAX_PARTS or len(path) > MAX_DEPTH:
            raise ValueError("its dictionaries are too large")
        mapping = as_mapping(value)
        if mapping is None:
            yield ".".join(path), value
            continue
        inner = [
            ((*path, key), part) for key, part in mapping.items() if isinstance(key, str) and not _OPTIMIZER.search(key)
        ]
        waiting += reversed(inner)


def _is_tensor(value: Any) -> bool:
    return isinstance(value, Inert) and value.name.startswith(("torch._utils._rebuild_tensor", _PARAMETER))


_PARAMETER: Final = "torch._utils._rebuild_parameter"


class _Storages:
    """The numbers of a file of torch, read when a tensor needs them."""

    def __init__(self, file: ZipFile, root: str) -> None:
        self._file, self._root = file, root
        self._read: dict[str, bytes] = {}

    def tensor(self, made: Inert) -> Array:
        """Return the array of a tensor, which shares the memory of its numbers."""
        if made.name.startswith(_PARAMETER):
            made = made.arguments[0]
        storage, offset, shape, strides = made.arguments[:4]
        _, kind, key, *_ = storage
        if not (isinstance(kind, Name) and isinstance(key, str)):
            raise ValueError("a tensor in it has no numbers")  # noqa: TRY004 - it comes from a file
        if key not in self._read:
            self._read[key] = member(self._file, f"{self._root}data/{key}")
        numbers = np.frombuffer(self._read[key], _DTYPES[kind.name.rpartition(".")[2].removesuffix("Storage")])
        if not all(type(one) is int and one >= 0 for one in (offset, *shape, *strides)):
            raise ValueError("a tensor in it has a wrong shape")
        last = offset + sum((count - 1) * stride for count, stride in zip(shape, strides, strict=True))
        if prod(shape) and (last >= len(numbers) or prod(shape) > len(numbers)):
            raise ValueError("a tensor in it has more numbers than the file")
        if not prod(shape):
            return np.zeros(shape, np.float32)
        steps = [stride * numbers.itemsize for stride in strides]
        found = np.lib.stride_tricks.as_strided(numbers[offset:], shape, steps, writeable=False)
        return _widened(found) if kind.name.endswith("BFloat16Storage") else found


def _widened(halves: Array) -> Array:
    """Return numbers of the type bfloat16, which are the upper halves of those of the type float32."""
    return (halves.astype(np.uint32) << 16).view(np.float32)


def _of_safetensors(path: Path, data: bytes) -> Mapping[str, Array]:
    """Return the tensors of floats in a file of safetensors, whose own library checks sizes against the file."""
    if int.from_bytes(data[:8], "little") > MAX_HEADER:
        raise InputError(f"{path} is not a file of safetensors, or has a header that no policy needs")
    try:
        found = deserialize(data)  # type: ignore[no-untyped-call]
    except SafetensorError as error:
        raise InputError(f"{path} is not a file of safetensors, or is damaged: {error}") from None
    floats = {name: one for name, one in found if one["dtype"] in (*_OF_SAFETENSORS, "BF16")}
    if not floats:
        raise InputError(f"{path} holds no tensors of a network: save its weights by safetensors.torch.save_model")
    arrays = {}
    for name, one in floats.items():
        kind = _OF_SAFETENSORS.get(one["dtype"], "BFloat16")
        array = np.frombuffer(one["data"], _DTYPES[kind]).reshape(one["shape"])
        arrays[name] = _widened(array) if kind == "BFloat16" else array
    return MappingProxyType(arrays)
