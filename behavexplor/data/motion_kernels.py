"""Compiled conversion of motion to differences and back, see `behavexplor.data.motion_bytes`, which calls these."""

import numpy as np

from behavexplor.data.array_types import Bytes, Floats, Ints
from behavexplor.jit import kernel_in_place


@kernel_in_place
def fill_changes(motion: Floats, resolution: float, changes: Ints) -> int:
    """Fill in the second differences of motion, shape (T, n), over time; differences of shape (n, T).

    Returns:
        The number of bytes that each of them needs, at least 1.
    """
    size = np.int64(0)
    for i in range(motion.shape[1]):
        before, step = np.int64(0), np.int64(0)
        for t in range(len(motion)):
            now = np.int64(np.rint(motion[t, i] / resolution))
            change = (now - before) - step
            before, step = now, now - before
            changes[i, t] = change
            size |= change ^ (change >> 63)  # the bits below the sign
    count = 1
    while count < 8 and size >> (8 * count - 1):
        count += 1
    return count


@kernel_in_place
def fill_bytes(changes: Ints, planes: Bytes) -> None:
    """Fill in the lowest bytes of differences, shape (n, T); bytes of shape (b, n, T)."""
    for k in range(len(planes)):
        for i in range(len(changes)):
            for t in range(changes.shape[1]):
                planes[k, i, t] = (changes[i, t] >> (8 * k)) & 255


@kernel_in_place
def fill_values(planes: Bytes, resolution: float, motion: Floats) -> None:
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
