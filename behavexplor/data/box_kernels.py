"""Compiled distances of boxes, see `behavexplor.data.geometry`, whose functions call these."""

import math

import numpy as np
from numpy.typing import NDArray

from behavexplor.jit import kernel_in_place, kernel_inner

Floats = NDArray[np.float64]


@kernel_in_place
def fill_box_distances(a: Floats, b: Floats, gaps: Floats) -> None:
    """Fill in the distance of each pair of boxes; corners of shape (n, 4, 2), distances of shape (n,)."""
    for i in range(len(gaps)):
        gaps[i] = 0.0 if _overlap(a[i], b[i]) else min(_corners_to_edges(a[i], b[i]), _corners_to_edges(b[i], a[i]))


@kernel_in_place
def fill_box_segment_distances(boxes: Floats, segments: Floats, gaps: Floats) -> None:
    """Fill in the distance of each box, shape (n, 4, 2), from its segment, shape (n, 2, 2); distances of shape (n,)."""
    for i in range(len(gaps)):
        box, segment = boxes[i], segments[i]
        gaps[i] = 0.0
        if not _meets(box, segment):
            gaps[i] = min(_to_segment(box[0], segment[0], segment[1]), _corners_to_edges(segment, box))
            for k in range(1, 4):
                gaps[i] = min(gaps[i], _to_segment(box[k], segment[0], segment[1]))


@kernel_in_place
def fill_gap_bounds(position: Floats, heading: Floats, outer: Floats, inner: Floats, lower: Floats) -> float:
    """Fill in the lower bounds, and return the upper one; see `behavexplor.data.geometry.gap_bounds`."""
    upper = math.inf
    for t in range(len(position)):
        if t > 0 and _is_still(position[t], position[t - 1], heading[t], heading[t - 1]):
            lower[t] = math.inf
            continue
        for i in range(1, position.shape[1]):
            centers = math.hypot(position[t, i, 0] - position[t, 0, 0], position[t, i, 1] - position[t, 0, 1])
            lower[t, i - 1] = centers - (outer[0] + outer[i])
            upper = min(upper, max(centers - (inner[0] + inner[i]), 0.0))
    return upper


@kernel_in_place
def fill_point_segment_distances(points: Floats, segments: Floats, gaps: Floats) -> None:
    """Fill in the distances of points, shape (n, 2), from segments, shape (m, 2, 2); distances of shape (n, m)."""
    for i in range(len(points)):
        for k in range(len(segments)):
            gaps[i, k] = _to_segment(points[i], segments[k, 0], segments[k, 1])


@kernel_inner
def _is_still(position: Floats, before: Floats, heading: Floats, heading_before: Floats) -> bool:
    """Return whether no vehicle has moved or turned."""
    for i in range(len(heading)):
        if heading[i] != heading_before[i] or position[i, 0] != before[i, 0] or position[i, 1] != before[i, 1]:
            return False
    return True


@kernel_inner
def _corners_to_edges(points: Floats, box: Floats) -> float:
    """Return the least distance of points, shape (n, 2), from the edges of a box, shape (4, 2)."""
    least = math.inf
    for i in range(len(points)):
        for k in range(4):
            least = min(least, _to_segment(points[i], box[k], box[(k + 1) % 4]))
    return least


@kernel_inner
def _to_segment(point: Floats, start: Floats, end: Floats) -> float:
    along_x, along_y = end[0] - start[0], end[1] - start[1]
    squared = along_x * along_x + along_y * along_y
    share = ((point[0] - start[0]) * along_x + (point[1] - start[1]) * along_y) / (squared if squared > 0.0 else 1.0)
    share = min(max(share, 0.0), 1.0)
    return math.hypot(point[0] - (start[0] + share * along_x), point[1] - (start[1] + share * along_y))


@kernel_inner
def _overlap(a: Floats, b: Floats) -> bool:
    """Return whether two boxes touch or overlap, by the separating axis theorem."""
    for k in range(2):
        if _separates(a, b, a[k + 1, 0] - a[k, 0], a[k + 1, 1] - a[k, 1]):
            return False
        if _separates(a, b, b[k + 1, 0] - b[k, 0], b[k + 1, 1] - b[k, 1]):
            return False
    return True


@kernel_inner
def _meets(box: Floats, segment: Floats) -> bool:
    """Return whether a segment touches or enters a box, by the separating axis theorem."""
    for k in range(2):
        if _separates(box, segment, box[k + 1, 0] - box[k, 0], box[k + 1, 1] - box[k, 1]):
            return False
    return not _separates(box, segment, -(segment[1, 1] - segment[0, 1]), segment[1, 0] - segment[0, 0])


@kernel_inner
def _separates(a: Floats, b: Floats, x: float, y: float) -> bool:
    """Return whether two sets of points lie apart along a direction."""
    low_a, high_a = _extent(a, x, y)
    low_b, high_b = _extent(b, x, y)
    return high_a < low_b or high_b < low_a


@kernel_inner
def _extent(points: Floats, x: float, y: float) -> tuple[float, float]:
    low, high = math.inf, -math.inf
    for i in range(len(points)):
        along = points[i, 0] * x + points[i, 1] * y
        low, high = min(low, along), max(high, along)
    return low, high
