"""Pickles read without running them: what they would call is kept as a name and its arguments."""

import io
import pickle
import pickletools
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

_RECONSTRUCT = {"numpy._core.multiarray._reconstruct", "numpy.core.multiarray._reconstruct"}
_FROM_BUFFER = {"numpy._core.numeric._frombuffer", "numpy.core.numeric._frombuffer"}
_SCALAR = {"numpy._core.multiarray.scalar", "numpy.core.multiarray.scalar"}


class Inert:
    """What stands in for a global name of a pickle, as a class, and for what a call of it would make, as an instance.

    Attributes:
        name: "module.attribute".
        arguments: of the call.
        state: that the made object would have been given, None without one.
        items: that would have been put into it.
    """

    name: ClassVar[str] = ""

    def __new__(cls, *arguments: Any, **_: Any) -> "Inert":
        """Keep the arguments of what would have been a call."""
        inert = super().__new__(cls)
        inert.arguments, inert.state, inert.items = arguments, None, []
        return inert

    arguments: tuple[Any, ...]
    state: Any
    items: list[Any]

    def __init__(self, *_: Any, **__: Any) -> None:
        """Nothing is left to do."""

    def __setstate__(self, state: Any) -> None:
        self.state = state

    def __setitem__(self, key: Any, value: Any) -> None:
        self.items.append((key, value))

    def append(self, value: Any) -> None:
        """Keep a value that would have been appended."""
        self.items.append(value)

    def extend(self, values: Any) -> None:
        """Keep values that would have been appended."""
        self.items.extend(values)


class _InertUnpickler(pickle.Unpickler):
    """An unpickler that finds no name of this process, so that nothing can be called."""

    def __init__(self, data: bytes) -> None:
        super().__init__(io.BytesIO(data))
        self.names: dict[str, type[Inert]] = {}

    def find_class(self, module_name: str, global_name: str, /) -> type[Inert]:
        name = f"{module_name}.{global_name}"
        if name not in self.names:
            self.names[name] = type("Inert", (Inert,), {"name": name})
        return self.names[name]

    def persistent_load(self, pid: Any) -> Any:
        return pid


def read_pickle(data: bytes) -> tuple[Any, frozenset[str]]:
    """What a pickle holds: plain values, and `Inert` where it holds anything else.

    Returns:
        The value, and all the names ("module.attribute") that it refers to.

    Raises:
        ValueError: if it is no pickle, is cut short, or asks for more memory than it has bytes.
    """
    try:
        _check_memory(data)
        unpickler = _InertUnpickler(data)
        value = unpickler.load()
    except Exception as error:  # whatever a damaged pickle makes of the unpickler
        raise ValueError(f"no pickle that can be read: {type(error).__name__}: {error}") from None
    return value, frozenset(unpickler.names)


def _check_memory(data: bytes) -> None:
    """Refuse a pickle that numbers more values than it has bytes: a table of that length would be made."""
    for opcode, argument, _ in pickletools.genops(data):
        if opcode.name in ("PUT", "LONG_BINPUT") and int(argument or 0) > len(data):
            raise ValueError("it is made to fill the memory")


def as_array(value: Any) -> NDArray[Any]:
    """The array or scalar of numbers that numpy would make.

    Raises:
        ValueError: if it is no such array.
    """
    if isinstance(value, (bool, int, float)):
        return np.asarray(value)
    if not isinstance(value, Inert):
        raise ValueError(f"expected an array, got {type(value).__name__}")  # noqa: TRY004 - it comes from a file
    try:
        return _decoded(value)
    except (TypeError, KeyError, IndexError, AttributeError) as error:
        raise ValueError(f"an array that cannot be read: {error}") from None


def _decoded(value: Inert) -> NDArray[Any]:
    if value.name in _RECONSTRUCT:
        _, shape, dtype, in_columns, data = value.state
        order = "F" if in_columns else "C"
    elif value.name in _FROM_BUFFER:
        data, dtype, shape, order = value.arguments
    elif value.name in _SCALAR:
        (dtype, data), shape, order = value.arguments, (), "C"
    else:
        raise ValueError(f"expected an array, got {value.name}")
    flat = np.frombuffer(_bytes(data), dtype=_dtype(dtype))
    return flat.reshape(shape, order="F" if order == "F" else "C").copy()


def _bytes(data: Any) -> bytes:
    if isinstance(data, Inert):  # as pickles of protocol 2 spell bytes, and none at all
        return str(data.arguments[0]).encode(data.arguments[1]) if data.arguments else b""
    return bytes(data)


def _dtype(value: Any) -> np.dtype[Any]:
    dtype: np.dtype[Any] = np.dtype(value.arguments[0])
    if dtype.kind not in "fiub":
        raise ValueError(f"an array of {dtype}")
    return dtype.newbyteorder(value.state[1]) if value.state and value.state[1] in "<>" else dtype
