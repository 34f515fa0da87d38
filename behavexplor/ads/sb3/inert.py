"""Read pickles without executing them: a call is kept as a name and its arguments."""

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
    """A placeholder: a subclass stands for a global name of a pickle, its instance for the result of calling that name.

    Attributes:
        name: global name, "module.attribute".
        arguments: arguments of the call.
        state: state that the object would have been given; None without a state.
        items: items that would have been put into the object.
    """

    name: ClassVar[str] = ""

    def __new__(cls, *arguments: Any, **_: Any) -> "Inert":
        """Keep the arguments of the call that would have been made."""
        inert = super().__new__(cls)
        inert.arguments, inert.state, inert.items = arguments, None, []
        return inert

    arguments: tuple[Any, ...]
    state: Any
    items: list[Any]

    def __init__(self, *_: Any, **__: Any) -> None:
        """Do nothing: `__new__` has kept the arguments."""

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
    """An unpickler that resolves every name to a placeholder, so that nothing can be called."""

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
    """Read a pickle: plain values, with `Inert` in place of anything else.

    Returns:
        The value, and all global names ("module.attribute") that the pickle refers to.

    Raises:
        ValueError: if the data is not a pickle, is cut short, or asks for more memory than it has bytes.
    """
    try:
        _check_memory(data)
        unpickler = _InertUnpickler(data)
        value = unpickler.load()
    except Exception as error:  # a damaged pickle can make the unpickler raise anything
        raise ValueError(f"not a readable pickle: {type(error).__name__}: {error}") from None
    return value, frozenset(unpickler.names)


def _check_memory(data: bytes) -> None:
    """Refuse a pickle that numbers more values than it has bytes: the unpickler makes a table of that length."""
    for opcode, argument, _ in pickletools.genops(data):
        if opcode.name in ("PUT", "LONG_BINPUT") and int(argument or 0) > len(data):
            raise ValueError("it would fill the memory")


def as_array(value: Any) -> NDArray[Any]:
    """Return the array or scalar of numbers that numpy would make.

    Raises:
        ValueError: if the value is not an array or scalar of numbers.
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
    if isinstance(data, Inert):  # bytes in protocol 2: a call of an encoder, without arguments if empty
        return str(data.arguments[0]).encode(data.arguments[1]) if data.arguments else b""
    return bytes(data)


def _dtype(value: Any) -> np.dtype[Any]:
    dtype: np.dtype[Any] = np.dtype(value.arguments[0])
    if dtype.kind not in "fiub":
        raise ValueError(f"an array of {dtype}")
    return dtype.newbyteorder(value.state[1]) if value.state and value.state[1] in "<>" else dtype
