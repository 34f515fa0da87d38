"""Files of weights, read without executing anything: those that torch writes, and safetensors."""

import hashlib
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from math import prod
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final
from zipfile import ZipFile

import numpy as np
from safetensors import SafetensorError, deserialize

from behavexplor.ads.sb3.archive import SAVE_WEIGHTS, opened_torch, suspicions_about
from behavexplor.ads.sb3.arrays import as_mapping
from behavexplor.ads.sb3.inert import MAX_DEPTH, MAX_PARTS, OLD_TORCH, Inert, Name, PickleReader, TooLongError
from behavexplor.data.array_types import Array
from behavexplor.data.untrusted import member, read_file
from behavexplor.errors import InputError

MAX_BYTES: Final = 200_000_000  # greatest size of a file
MAX_HEADER: Final = 5_000_000  # greatest size of the header of safetensors
MAX_MEMBERS: Final = 20_000  # members of a file of torch, which has one for each tensor
_MEMBER: Final = b"PK\x01\x02"  # begins the entry of a member

# Types of numbers.
_DTYPES: Final[Mapping[str, str]] = MappingProxyType(
    {"Float": "<f4", "Double": "<f8", "Half": "<f2", "BFloat16": "<u2", "Long": "<i8", "Int": "<i4"}
    | {"Short": "<i2", "Char": "<i1", "Byte": "<u1", "Bool": "<u1"}
)
_OF_SAFETENSORS: Final[Mapping[str, str]] = MappingProxyType(
    {"F32": "Float", "F64": "Double", "F16": "Half", "BF16": "BFloat16"}
)
_INTEGERS: Final = re.compile(r"[IU]\d+|BOOL")  # those of safetensors
_UNTYPED: Final = "Untyped"  # torch's storage of the other types, which are arguments of the tensor

# Names of tensors.
_OPTIMIZER: Final = re.compile(r"optim(?!al)")  # such as "optimizer" and "optim_state", but not "optimal_q"
_WEIGHTS: Final = re.compile(r"(weight|bias)$")  # ends the names of numbers that a layer multiplies or adds

# How torch makes tensors: by calls of `_rebuild_...`.
_REBUILT: Final = re.compile(r"torch\.(?:_utils|_tensor)\._rebuild_(\w+)")
_PARAMETERS: Final = ("parameter", "parameter_with_state")
_DENSE: Final = ("tensor", "tensor_v2", "tensor_v3")
_OTHER_FORMS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "qtensor": "quantized",
        "sparse_tensor": "sparse",
        "nested_tensor": "nested",
        "meta_tensor_no_storage": "without numbers, on the device meta",
    }
)


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
    """Return the tensors in what torch has written. The path is for error messages, and the digest is that of the data.

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
        arrays = {name: storages.tensor(path, name, one) for name, one in _tensors(path, entries)}
    if not arrays:
        raise InputError(_without_tensors(path, content, entries))
    suspicions = tuple(suspicions_about("its pickle", called))
    return TensorFile(path, digest, len(data), MappingProxyType(arrays), suspicions=suspicions)


def _without_tensors(path: Path, content: Any, entries: list[tuple[str, Any]]) -> str:
    """Return a sentence on a file that has no tensors where a policy has them."""
    modules = [value for value in (content, *(value for _, value in entries)) if isinstance(value, Inert)]
    whole = next((one.name for one in modules if isinstance(one.state, dict) and "_parameters" in one.state), None)
    if whole is not None:
        return f"{path} holds a whole pickled module ({whole}), whose code is not run: {SAVE_WEIGHTS}"
    return f"{path} holds no tensors of a network: {SAVE_WEIGHTS}"


def _entries(content: Any) -> Iterator[tuple[str, Any]]:
    """Yield what the dictionaries of a file hold, except optimizers, by dotted name."""
    count = 0
    waiting: list[tuple[tuple[str, ...], Any]] = [((), content)]
    while waiting:
        keys, value = waiting.pop()
        count += 1
        if count > MAX_PARTS or len(keys) > MAX_DEPTH:
            raise ValueError("its dictionaries are too large")
        mapping = as_mapping(value)
        if mapping is None:
            yield ".".join(keys), value
            continue
        named = [(key, part) for key, part in mapping.items() if isinstance(key, str) and not _OPTIMIZER.search(key)]
        waiting += [((*keys, key), part) for key, part in reversed(named)]  # the first one is taken next


def _tensors(path: Path, entries: Iterable[tuple[str, Any]]) -> Iterator[tuple[str, Inert]]:
    """Yield the dense tensors among entries, by name. Any other tensor is refused, also one in a list of an entry."""
    for name, value in entries:
        is_list = isinstance(value, list | tuple)
        for one in value if is_list else (value,):
            tensor, maker = _unwrapped(one)
            if maker is not None and maker not in _DENSE:
                raise _unread(path, name, _OTHER_FORMS.get(maker, f"of another form ({maker})"))
            if maker is not None and not is_list:  # those in a list belong to no layer
                yield name, tensor


def _unwrapped(value: Any) -> tuple[Any, str | None]:
    """Return a tensor without the parameters that it is in, and which `_rebuild_...` makes it; None: no tensor."""
    maker = None
    while isinstance(value, Inert) and (call := _REBUILT.fullmatch(value.name)):
        maker = call[1]
        if maker not in _PARAMETERS:
            break
        value = value.arguments[0]
    return value, maker


def _unread(path: Path, name: str, form: str) -> InputError:
    """Return the refusal of a tensor: without it, a network would lack a layer."""
    return InputError(
        f"{path} has the tensor {name!r:.80}, which is {form}, and only dense floats are read: save a copy of its "
        "weights as dense tensors of torch.float32"
    )


class _Storages:
    """The numbers of a file of torch, read when a tensor needs them."""

    def __init__(self, file: ZipFile, root: str) -> None:
        self._file, self._root = file, root
        self._read: dict[str, bytes] = {}

    def tensor(self, path: Path, name: str, made: Inert) -> Array:
        """Return the array of a tensor, which shares the memory of its numbers."""
        storage, offset, shape, strides, *others = made.arguments
        _, kind, key, *_ = storage
        if not (isinstance(kind, Name) and isinstance(key, str)):
            raise ValueError("a tensor in it has no numbers")  # noqa: TRY004 - it comes from a file
        storage_type = kind.name.rpartition(".")[2].removesuffix("Storage")
        if storage_type not in _DTYPES or (_WEIGHTS.search(name) and not _is_float(storage_type)):
            dtype = others[2].name if storage_type == _UNTYPED else storage_type  # others: requires_grad, hooks, dtype
            raise _unread(path, name, f"of the type {dtype}")
        if key not in self._read:
            self._read[key] = member(self._file, f"{self._root}data/{key}")
        numbers = np.frombuffer(self._read[key], _DTYPES[storage_type])
        if not all(type(one) is int and one >= 0 for one in (offset, *shape, *strides)):
            raise ValueError("a tensor in it has a wrong shape")
        last = offset + sum((count - 1) * stride for count, stride in zip(shape, strides, strict=True))
        if not prod(shape):
            return np.zeros(shape, np.float32)
        if max(last + 1, prod(shape)) > len(numbers):  # strides of 0 would repeat numbers
            raise ValueError("a tensor in it has more numbers than the file")
        steps = [stride * numbers.itemsize for stride in strides]
        found = np.lib.stride_tricks.as_strided(numbers[offset:], shape, steps, writeable=False)
        return _widened(found) if storage_type == "BFloat16" else found


def _is_float(storage_type: str) -> bool:
    return storage_type == "BFloat16" or np.dtype(_DTYPES[storage_type]).kind == "f"


def _widened(halves: Array) -> Array:
    """Return numbers of the type bfloat16, which are the upper halves of those of the type float32."""
    return (halves.astype(np.uint32) << 16).view(np.float32)


def _of_safetensors(path: Path, data: bytes) -> Mapping[str, Array]:
    """Return the tensors of floats in a file of safetensors, whose own library checks sizes against the file."""
    if int.from_bytes(data[:8], "little") > MAX_HEADER:
        raise InputError(f"{path} is not a file of safetensors, or has a header that no policy needs")
    try:
        arrays = dict(_safe_arrays(path, deserialize(data)))  # type: ignore[no-untyped-call]
    except InputError:
        raise
    except (SafetensorError, ValueError, OverflowError) as error:  # numpy raises the last two for extreme shapes
        raise InputError(f"{path} is not a file of safetensors, or is damaged: {error}") from None
    if not arrays:
        raise InputError(f"{path} holds no tensors of a network: save its weights by safetensors.torch.save_model")
    return MappingProxyType(arrays)


def _safe_arrays(path: Path, tensors: Iterable[tuple[str, Mapping[str, Any]]]) -> Iterator[tuple[str, Array]]:
    """Yield the tensors of floats by name. Integers that no layer needs are left out, and all others are refused."""
    for name, one in tensors:
        kind = _OF_SAFETENSORS.get(one["dtype"])
        if kind is None and (_WEIGHTS.search(name) or not _INTEGERS.fullmatch(one["dtype"])):
            raise _unread(path, name, f"of the type {one['dtype']}")
        if kind is not None:
            array = np.frombuffer(one["data"], _DTYPES[kind]).reshape(one["shape"])
            yield name, _widened(array) if kind == "BFloat16" else array
