"""Arrays by name as bytes: the safetensors format, compressed by Zstandard."""

import threading
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import safetensors.numpy
import zstandard
from numpy.typing import NDArray

LEVEL: Final = 3
MAX_BYTES: Final = 450_000_000  # unpacked size; the largest trace has 41 bytes for each of 10 million places


class _Compression(threading.local):
    """A compressor and a decompressor for each thread. Creating them takes longer than they need for a trace."""

    def __init__(self) -> None:
        self.compressor = zstandard.ZstdCompressor(level=LEVEL)
        self.decompressor = zstandard.ZstdDecompressor()


_compression = _Compression()


def pack_arrays(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Return arrays of numbers or truth values as bytes. Equal arrays give equal bytes."""
    contiguous = {name: np.asarray(array, order="C") for name, array in arrays.items()}
    return _compression.compressor.compress(safetensors.numpy.save(contiguous))


def unpack_arrays(data: bytes) -> dict[str, NDArray[Any]]:
    """Return the arrays that `pack_arrays` packed. No code in the data is executed.

    Raises:
        ValueError: if the data is of another form, is damaged, or would unpack to more than `MAX_BYTES`.
    """
    try:
        size = zstandard.frame_content_size(data)
        if not 0 <= size <= MAX_BYTES:
            raise ValueError(f"it declares an unpacked size of {size} bytes")  # noqa: TRY301
        return safetensors.numpy.load(_compression.decompressor.decompress(data))
    except Exception as error:  # both libraries raise several kinds of errors for damaged data
        raise ValueError(" ".join(f"{type(error).__name__}: {error}".split())[:300]) from None
