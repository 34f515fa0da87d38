"""Compiled conversion of motion to bytes and back, see `behavexplor.data.motion_bytes`, whose functions call these."""

import numpy as np
from numpy.typing import NDArray

from behavexplor.jit import kernel_in_place

Floats = NDArray[np.float64]
Bytes = NDArray[np.uint8]


@kernel_in_place
def fill_bytes(motion: Floats, resolution: float, planes: Bytes) -> None:
    """Fill in the bytes of motion, shape (T, n); bytes of shape (8, n, T)."""
    for i in range(motion.shape[1]):
        before, step = np.int64(0), np.int64(0)
        for t in range(len(motion)):
            now = np.int64(np.rint(motion[t, i] / resolution))
            change = (now - before) - step
            before, step = now, now - before
            for k in range(8):
                planes[k, i, t] = (change >> (8 * k)) & 255


@kernel_in_place
def fill_values(planes: Bytes, resolution: float, motion: Floats) -> None:
    """Fill in motion, shape (T, n), from bytes of shape (8, n, T)."""
    for i in range(motion.shape[1]):
        now, step = np.int64(0), np.int64(0)
        for t in range(len(motion)):
            change = np.int64(0)
            for k in range(8):
                change |= np.int64(planes[k, i, t]) << (8 * k)
            step += change
            now += step
            motion[t, i] = now * resolution
