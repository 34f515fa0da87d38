"""Motion as few bytes that compress well, by second differences over time; and compressed arrays, by name."""

import threading
from collections.abc import Mapping
from typing import Final

import numpy as np
import safetensors.numpy
import zstandard

from behavexplor.data.array_types import Array, Bytes, Floats, Ints
from behavexplor.errors import InputError
from behavexplor.jit import kernel_in_place

MOST_VALUES: Final = 20_000_000  # of one quantity of all vehicles in all frames
LEVEL: Final = 3  # of Zstandard
MAX_UNPACKED: Final = 450_000_000  # [bytes]; the largest trace has 10 million places (vehicles times frames) of 41 each


def pack_motion(motion: Floats, resolution: float) -> Bytes:
    """Return motion (T, ...) as second differences over time, byte by byte from the lowest, shape (b, ..., T).

    Motion is in multiples of the resolution, which is the unit of the differences. Each difference needs b bytes.
    """
    frames, *rest = motion.shape
    rows = np.ascontiguousarray(motion).reshape(frames, -1)
    changes = np.empty(rows.shape[::-1], dtype=np.int64)
    n_bytes = _fill_changes(rows, resolution, changes)
    planes = np.empty((n_bytes, *changes.shape), dtype=np.uint8)
    _fill_bytes(changes, planes)
    return planes.reshape(-1, *rest, frames)


def unpack_motion(planes: Bytes, frames: int, resolution: float) -> Floats:
    """Return the motion that `pack_motion` packed with this resolution, read-only, shape (T, ...) with T = `frames`.

    Raises:
        InputError: if the bytes have another shape, or stand for more than `MOST_VALUES`.
    """
    is_packed = planes.dtype == np.uint8 and planes.ndim >= 2 and 1 <= len(planes) <= 8 and planes.shape[-1] == frames
    if not is_packed:
        raise InputError("Not a trace, or a damaged one: its motion has a wrong shape")
    if planes[0].size > MOST_VALUES:
        raise InputError(f"Not a trace: its motion has {planes[0].size} values, more than {MOST_VALUES}")
    motion = np.empty((frames, *planes.shape[1:-1]))
    rows = np.array(planes, order="C").reshape(len(planes), -1, frames)
    _fill_values(rows, resolution, motion.reshape(frames, -1))
    motion.setflags(write=False)
    return motion


@kernel_in_place
def _fill_changes(motion: Floats, resolution: float, changes: Ints) -> int:
    """Fill in the second differences of motion, shape (T, n), over time; differences of shape (n, T).

    Return the number of bytes that each of them needs, at least 1.
    """
    bits = np.int64(0)  # those that any difference needs
    for i in range(motion.shape[1]):
        before, step = np.int64(0), np.int64(0)
        for t in range(len(motion)):
            now = np.int64(np.rint(motion[t, i] / resolution))
            change = (now - before) - step
            before, step = now, now - before
            changes[i, t] = change
            bits |= change ^ (change >> 63)  # the bits below the sign
    count = 1
    while count < 8 and bits >> (8 * count - 1):
        count += 1
    return count


@kernel_in_place
def _fill_bytes(changes: Ints, planes: Bytes) -> None:
    """Fill in the lowest bytes of differences, shape (n, T); bytes of shape (b, n, T)."""
    for k in range(len(planes)):
        for i in range(len(changes)):
            for t in range(changes.shape[1]):
                planes[k, i, t] = (changes[i, t] >> (8 * k)) & 255


@kernel_in_place
def _fill_values(planes: Bytes, resolution: float, motion: Floats) -> None:
    """Fill in motion, shape (T, n), from the bytes of its differences, shape (b, n, T)."""
    unused = 64 - 8 * len(planes)
    for i in range(motion.shape[1]):
        now, step = np.int64(0), np.int64(0)
        for t in range(len(motion)):
            change = np.int64(0)
            for k in range(len(planes)):
                change |= np.int64(planes[k, i, t]) << (8 * k)
            step += (change << unused) >> unused  # the highest bit is the sign
            now += step
            motion[t, i] = now * resolution


class _Compression(threading.local):
    """A compressor and a decompressor for each thread. Creating them takes longer than they need for a trace."""

    def __init__(self) -> None:
        self.compressor = zstandard.ZstdCompressor(level=LEVEL)
        self.decompressor = zstandard.ZstdDecompressor()


_compression = _Compression()


def pack_arrays(arrays: Mapping[str, Array]) -> bytes:
    """Return numbers or truth values as bytes: safetensors, compressed by Zstandard. Equal arrays give equal bytes."""
    contiguous = {name: np.asarray(array, order="C") for name, array in arrays.items()}
    return _compression.compressor.compress(safetensors.numpy.save(contiguous))


def unpack_arrays(data: bytes) -> dict[str, Array]:
    """Return the arrays that `pack_arrays` packed. No code in the data is executed.

    Raises:
        ValueError: if the data is of another form, is damaged, or would unpack to more than `MAX_UNPACKED`.
    """
    try:
        size = zstandard.frame_content_size(data)
        if not 0 <= size <= MAX_UNPACKED:
            raise ValueError(f"it declares an unpacked size of {size} bytes")  # noqa: TRY301
        return safetensors.numpy.load(_compression.decompressor.decompress(data))
    except Exception as error:  # both libraries raise several kinds of errors for damaged data
        raise ValueError(" ".join(f"{type(error).__name__}: {error}".split())[:300]) from None
