"""Motion as bytes that compress well: second differences over time, of which all but the lowest bytes are mostly 0."""

import numpy as np
from numpy.typing import NDArray

from behavexplor.errors import InputError

Floats = NDArray[np.float64]
Bytes = NDArray[np.uint8]


def pack_motion(motion: Floats, resolution: float) -> Bytes:
    """Return motion as second differences over time, byte by byte, from the lowest byte to the highest.

    Args:
        motion: multiples of the resolution, shape (T, ...).
        resolution: unit of the differences.

    Returns:
        Bytes, shape (8, ..., T).
    """
    from behavexplor.data.motion_kernels import fill_bytes  # noqa: PLC0415 - numba is slow to import

    frames, *rest = motion.shape
    planes = np.empty((8, *rest, frames), dtype=np.uint8)
    fill_bytes(np.ascontiguousarray(motion).reshape(frames, -1), resolution, planes.reshape(8, -1, frames))
    return planes


def unpack_motion(planes: Bytes, frames: int, resolution: float) -> Floats:
    """Return the motion that `pack_motion` packed, a read-only array of shape (T, ...).

    Args:
        planes: bytes, shape (8, ..., T).
        frames: number of frames T.
        resolution: unit of the differences.

    Raises:
        InputError: if the bytes have another shape.
    """
    from behavexplor.data.motion_kernels import fill_values  # noqa: PLC0415 - numba is slow to import

    if planes.dtype != np.uint8 or planes.ndim < 2 or planes.shape[0] != 8 or planes.shape[-1] != frames:
        raise InputError("Not a trace, or a damaged one: its motion has a wrong shape")
    motion = np.empty((frames, *planes.shape[1:-1]))
    rows = np.array(planes, order="C").reshape(8, -1, frames)
    fill_values(rows, resolution, motion.reshape(frames, -1))
    motion.setflags(write=False)
    return motion
