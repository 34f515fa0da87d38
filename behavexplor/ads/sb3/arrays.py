"""Arrays and scalars of numpy in pickles that are not executed; see `behavexplor.ads.sb3.inert`."""

from typing import Any, Final

import numpy as np

from behavexplor.ads.sb3.inert import Inert
from behavexplor.data.array_types import Array

_RECONSTRUCT: Final = {"numpy._core.multiarray._reconstruct", "numpy.core.multiarray._reconstruct"}
_FROM_BUFFER: Final = {"numpy._core.numeric._frombuffer", "numpy.core.numeric._frombuffer"}
_SCALAR: Final = {"numpy._core.multiarray.scalar", "numpy.core.multiarray.scalar"}


def as_array(value: Any) -> Array:
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
    except (TypeError, KeyError, IndexError, AttributeError, OverflowError) as error:
        raise ValueError(f"an array that cannot be read: {error}") from None


def as_arrays(value: Any) -> Array | dict[str, Array]:
    """Return an array, or a dictionary of arrays.

    Raises:
        ValueError: if the value is neither.
    """
    mapping = as_mapping(value)
    return as_array(value) if mapping is None else {str(key): as_array(entry) for key, entry in mapping.items()}


def as_mapping(value: Any) -> dict[Any, Any] | None:
    """Return a dictionary or ordered dictionary; None if the value is neither."""
    if isinstance(value, Inert) and value.name == "collections.OrderedDict":
        return dict(value.items)
    return value if isinstance(value, dict) else None


def _decoded(value: Inert) -> Array:
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
    if isinstance(data, Inert):  # bytes in protocol 2: text to be encoded, or no arguments if empty
        text, encoding = data.arguments or ("", "latin1")
        if encoding not in ("latin1", "latin-1"):
            raise ValueError(f"bytes encoded as {encoding}")
        return str(text).encode("latin-1")
    if not isinstance(data, (bytes, bytearray)):
        raise TypeError(f"expected bytes, got {type(data).__name__}")
    return bytes(data)


def _dtype(value: Any) -> np.dtype[Any]:
    if not isinstance(value.arguments[0], str):
        raise TypeError("its type has no name")
    dtype: np.dtype[Any] = np.dtype(value.arguments[0])
    if dtype.kind not in "fiub":
        raise ValueError(f"an array of {dtype}")
    return dtype.newbyteorder(value.state[1]) if value.state and value.state[1] in "<>" else dtype
