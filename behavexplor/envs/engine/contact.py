"""Compiled contact tests of boxes with boxes and lines, one pair at a time; see `behavexplor.data.geometry`."""

import math
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from behavexplor.data.vehicle_sizes import EGO_SIZE
from behavexplor.jit import kernel_inner

Floats = NDArray[np.float64]

Corners: TypeAlias = tuple[tuple[float, float, float, float], tuple[float, float, float, float]]  # all x, all y [m]

RADIUS: Final = math.hypot(*EGO_SIZE) / 2  # distance of the ego's corners from its center [m]


@kernel_inner
def corners(x: float, y: float, heading: float, length: float, width: float) -> Corners:
    """Compute the corners of an oriented box, in order around it."""
    cos, sin = math.cos(heading), math.sin(heading)
    a, b = 0.5 * length, 0.5 * width
    return (
        (a * cos - b * sin + x, a * cos - -b * sin + x, -a * cos - -b * sin + x, -a * cos - b * sin + x),
        (a * sin + b * cos + y, a * sin + -b * cos + y, -a * sin + -b * cos + y, -a * sin + b * cos + y),
    )


@kernel_inner
def boxes_touch(a: Corners, b: Corners) -> bool:
    """Return whether two boxes touch or overlap, by the separating axis theorem."""
    return not (_sides_separate(a, b) or _sides_separate(b, a))


@kernel_inner
def _sides_separate(box: Corners, other: Corners) -> bool:
    """Return whether a side of the box is an axis that separates it from the other box."""
    xs, ys = box
    for i in range(2):
        ex, ey = xs[i + 1] - xs[i], ys[i + 1] - ys[i]
        low, high = _span(box, ex, ey)
        other_low, other_high = _span(other, ex, ey)
        if high < other_low or other_high < low:
            return True
    return False


@kernel_inner
def _span(box: Corners, ex: float, ey: float) -> tuple[float, float]:
    """Compute the least and greatest projection of the corners on an axis."""
    xs, ys = box
    low, high = math.inf, -math.inf
    for i in range(4):
        along = xs[i] * ex + ys[i] * ey
        low, high = min(low, along), max(high, along)
    return low, high


@kernel_inner
def line_distance(x: float, y: float, ax: float, ay: float, bx: float, by: float) -> float:
    """Compute the distance of a point from a segment [m]."""
    dx, dy = bx - ax, by - ay
    squared = dx * dx + dy * dy
    share = ((x - ax) * dx + (y - ay) * dy) / (squared if squared > 0 else 1.0)
    share = min(max(share, 0.0), 1.0)
    return math.hypot(x - (ax + share * dx), y - (ay + share * dy))


@kernel_inner
def line_meets_box(box: Corners, ax: float, ay: float, bx: float, by: float) -> bool:
    """Return whether a segment touches or enters a box.

    The separating axes are two sides of the box and the normal of the segment.
    """
    xs, ys = box
    for i in range(3):
        ex, ey = ay - by, bx - ax
        if i < 2:
            ex, ey = xs[i + 1] - xs[i], ys[i + 1] - ys[i]
        low, high = _span(box, ex, ey)
        start, end = ax * ex + ay * ey, bx * ex + by * ey
        if high < min(start, end) or max(start, end) < low:
            return False
    return True


@kernel_inner
def touches_line(lines: Floats, x: float, y: float, heading: float) -> bool:
    """Return whether the ego's box touches any of the lines, shape (lines, 4) [m]."""
    for i in range(len(lines)):
        ax, ay, bx, by = lines[i, 0], lines[i, 1], lines[i, 2], lines[i, 3]
        if min(ax, bx) - x > RADIUS or x - max(ax, bx) > RADIUS or min(ay, by) - y > RADIUS or y - max(ay, by) > RADIUS:
            continue
        if line_distance(x, y, ax, ay, bx, by) > RADIUS:
            continue
        if line_meets_box(corners(x, y, heading, EGO_SIZE[0], EGO_SIZE[1]), ax, ay, bx, by):
            return True
    return False
