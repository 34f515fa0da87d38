"""Occlusion: the share of a vehicle that other vehicles hide from the ego (weakness R1-1)."""

import math

import numpy as np
from numpy.typing import NDArray

from behavexplor.data.scene import EGO, HEADING, LENGTH, PRESENT, WIDTH, X, Y
from behavexplor.jit import kernel_inner

Floats = NDArray[np.float64]

TWO_PI = 2 * math.pi


@kernel_inner
def hidden_share(scene: Floats, row: int) -> float:
    """Return the hidden share of a vehicle's angular width, as seen from the ego's center.

    It is the largest share that a single nearer vehicle covers.
    """
    bearing, low, high = bearings(scene, row)
    distance = math.hypot(scene[row, X] - scene[EGO, X], scene[row, Y] - scene[EGO, Y])
    most = 0.0
    for other in range(EGO + 1, len(scene)):
        if other == row or scene[other, PRESENT] == 0.0:
            continue
        if math.hypot(scene[other, X] - scene[EGO, X], scene[other, Y] - scene[EGO, Y]) >= distance:
            continue
        middle, other_low, other_high = bearings(scene, other)
        away = (middle - bearing + math.pi) % TWO_PI - math.pi
        covered = min(high, away + other_high) - max(low, away + other_low)
        most = max(most, covered / (high - low))
    return most


@kernel_inner
def bearings(scene: Floats, row: int) -> tuple[float, float, float]:
    """Return the bearing of a vehicle's center from the ego's center [rad], and the range of its corners' bearings.

    The range is the least and the greatest bearing of a corner relative to that of the center [rad].

    Args:
        scene: scene, see `behavexplor.data.scene`.
        row: row of the vehicle.
    """
    dx, dy = scene[row, X] - scene[EGO, X], scene[row, Y] - scene[EGO, Y]
    bearing = math.atan2(dy, dx)
    cos, sin = math.cos(scene[row, HEADING]), math.sin(scene[row, HEADING])
    low, high = math.inf, -math.inf
    for along in (-0.5 * scene[row, LENGTH], 0.5 * scene[row, LENGTH]):
        for across in (-0.5 * scene[row, WIDTH], 0.5 * scene[row, WIDTH]):
            corner = math.atan2(dy + along * sin + across * cos, dx + along * cos - across * sin)
            away = (corner - bearing + math.pi) % TWO_PI - math.pi
            low, high = min(low, away), max(high, away)
    return bearing, low, high
