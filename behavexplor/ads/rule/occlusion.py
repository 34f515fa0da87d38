"""Occlusion: the share of a vehicle that other vehicles hide from the ego (weakness R1-1)."""

import math
from typing import Final

from behavexplor.data.array_types import Floats
from behavexplor.data.scene import EGO, HEADING, LENGTH, PRESENT, WIDTH, X, Y
from behavexplor.jit import kernel_inner

TWO_PI = 2 * math.pi
MARGIN: Final = 1e-6  # much more than the share by which roundings change a product
NARROW: Final = 0.7  # sine of half the angular width below which vehicles in opposite half-planes do not overlap


@kernel_inner
def hidden_share(scene: Floats, row: int) -> float:
    """Return the hidden share of a vehicle's angular width, as seen from the ego's center.

    It is the largest share that a single nearer vehicle covers.
    """
    most, distance = 0.0, _distance(scene, row)
    for other in range(EGO + 1, len(scene)):
        if other == row or scene[other, PRESENT] == 0.0 or _is_apart(scene, row, other):
            continue
        if _distance(scene, other) < distance:
            most = max(most, _covered_share(scene, row, other))
    return most


@kernel_inner
def _distance(scene: Floats, row: int) -> float:
    return math.hypot(scene[row, X] - scene[EGO, X], scene[row, Y] - scene[EGO, Y])


@kernel_inner
def _is_apart(scene: Floats, row: int, other: int) -> bool:
    """Return whether two vehicles are surely in different directions from the ego. It takes no slow functions."""
    x, y = scene[row, X] - scene[EGO, X], scene[row, Y] - scene[EGO, Y]
    other_x, other_y = scene[other, X] - scene[EGO, X], scene[other, Y] - scene[EGO, Y]
    radius = (scene[row, LENGTH] + scene[row, WIDTH]) / 2  # an upper bound of half the diagonal
    other_radius = (scene[other, LENGTH] + scene[other, WIDTH]) / 2
    widths = radius * (abs(other_x) + abs(other_y)) + other_radius * (abs(x) + abs(y))
    if abs(x * other_y - y * other_x) > (1.0 + MARGIN) * widths:
        return True
    if x * other_x + y * other_y >= 0.0:
        return False
    widest = max(
        radius * radius / (x * x + y * y), other_radius * other_radius / (other_x * other_x + other_y * other_y)
    )
    return bool(widest < NARROW * NARROW)


@kernel_inner
def _covered_share(scene: Floats, row: int, other: int) -> float:
    """Return the share of a vehicle's angular width that another one covers, negative with a gap between them."""
    bearing, low, high = bearings(scene, row)
    middle, other_low, other_high = bearings(scene, other)
    away = (middle - bearing + math.pi) % TWO_PI - math.pi
    covered = min(high, away + other_high) - max(low, away + other_low)
    return covered / (high - low)


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
