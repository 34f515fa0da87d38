"""Motion as few bytes that compress well: second differences over time."""

from typing import Final

import numpy as np

from behavexplor.data.array_types import Bytes, Floats
from behavexplor.errors import InputError

MOST_VALUES: Final = 20_000_000  # of one quantity of all vehicles in all frames


def pack_motion(motion: Floats, resolution: float) -> Bytes:
    """Return motion as second differences over time, byte by byte, from the lowest byte to the highest.

    Args:
        motion: multiples of the resolution, shape (T, ...).
        resolution: unit of the differences.

    Returns:
        Bytes, shape (b, ..., T), of which each difference needs b.
    """
    from behavexplor.data.motion_kernels import fill_bytes, fill_changes  # noqa: PLC0415 - numba is slow to import

    frames, *rest = motion.shape
    rows = np.ascontiguousarray(motion).reshape(frames, -1)
    changes = np.empty(rows.shape[::-1], dtype=np.int64)
    planes = np.empty((fill_changes(rows, resolution, changes), *changes.shape), dtype=np.uint8)
    fill_bytes(changes, planes)
    return planes.reshape(-1, *rest, frames)


def unpack_motion(planes: Bytes, frames: int, resolution: float) -> Floats:
    """Return the motion that `pack_motion` packed, a read-only array of shape (T, ...).

    Args:
        planes: bytes, shape (b, ..., T), b in [1, 8].
        frames: number of frames T.
        resolution: unit of the differences.

    Raises:
        InputError: if the bytes have another shape.
    """
    from behavexplor.data.motion_kernels import fill_values  # noqa: PLC0415 - numba is slow to import

    if planes.dtype != np.uint8 or planes.ndim < 2 or not 1 <= len(planes) <= 8 or planes.shape[-1] != frames:
        raise InputError("Not a trace, or a damaged one: its motion has a wrong shape")
    if planes[0].size > MOST_VALUES:
        raise InputError(f"Not a trace: its motion has {planes[0].size} values, more than {MOST_VALUES}")
    motion = np.empty((frames, *planes.shape[1:-1]))
    rows = np.array(planes, order="C").reshape(len(planes), -1, frames)
    fill_values(rows, resolution, motion.reshape(frames, -1))
    motion.setflags(write=False)
    return motion
