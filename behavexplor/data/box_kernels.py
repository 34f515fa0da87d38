"""Compiled distances of boxes, see `behavexplor.data.geometry`, whose functions call these."""

import math
from typing import Final

from behavexplor.data.array_types import Floats, Ints
from behavexplor.jit import kernel_in_place, kernel_inner

BLOCK: Final = 8  # points that share one bound in the search for the nearest segment
_SLACK: Final = 1e-6  # more than rounding changes a distance [m]


@kernel_in_place
def fill_box_distances(a: Floats, b: Floats, gaps: Floats) -> None:
    """Fill in the distance of each pair of boxes; corners of shape (n, 4, 2), distances of shape (n,)."""
    for i in range(len(gaps)):
        gaps[i] = _between_boxes(a[i], b[i])


@kernel_in_place
def fill_distances_from_first(
    position: Floats, cos: Floats, sin: Floats, size: Floats, frame: Ints, vehicle: Ints, room: Floats, gaps: Floats
) -> None:
    """Fill in distances; see `behavexplor.data.geometry.distances_from_first`.

    The directions of the first vehicle and of the others have the shape (2, n). `room` is for the corners of two boxes.
    """
    for i in range(len(gaps)):
        t, other = frame[i], vehicle[i]
        _fill_corners(position[t, 0], cos[0, i], sin[0, i], size[0], room[0])
        _fill_corners(position[t, other], cos[1, i], sin[1, i], size[other], room[1])
        gaps[i] = _between_boxes(room[0], room[1])


@kernel_in_place
def fill_distances_from_segments(
    position: Floats,
    cos: Floats,
    sin: Floats,
    size: Floats,
    segments: Floats,
    segment: Ints,
    room: Floats,
    gaps: Floats,
) -> None:
    """Fill in distances; see `behavexplor.data.geometry.distances_from_segments`.

    The directions of the boxes have the shape (n,). `room` is for the corners of a box.
    """
    for i in range(len(gaps)):
        box, line = room[0], segments[segment[i]]
        _fill_corners(position[i], cos[i], sin[i], size, box)
        gaps[i] = 0.0
        if not _meets(box, line):
            gaps[i] = min(_to_segment(box[0], line[0], line[1]), _corners_to_edges(line, box))
            for k in range(1, 4):
                gaps[i] = min(gaps[i], _to_segment(box[k], line[0], line[1]))


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


@kernel_in_place
def fill_near_segments(
    points: Floats, segments: Floats, reach: float, within: float, gaps: Floats, point: Ints, segment: Ints
) -> tuple[int, float]:
    """Fill in the pairs that may have the least distance; see `behavexplor.data.geometry.near_segments`.

    All points of a block lie within `spread` of its first one, whose distances from the segments are the `gaps`.

    Returns:
        The number of pairs, and the upper bound of the least distance [m].
    """
    upper, count = math.inf, 0
    for block in range(len(gaps)):
        for k in range(len(segments)):
            gaps[block, k] = _to_segment(points[block * BLOCK], segments[k, 0], segments[k, 1])
            upper = min(upper, gaps[block, k])
    upper = max(upper - within, 0.0)
    for block in range(len(gaps)):
        first, end, spread = block * BLOCK, min((block + 1) * BLOCK, len(points)), 0.0
        for i in range(first + 1, end):
            stray = math.hypot(points[i, 0] - points[first, 0], points[i, 1] - points[first, 1])
            spread = max(spread, stray)
        for k in range(len(segments)):
            if gaps[block, k] - spread - reach <= upper:
                for i in range(first, end):
                    point[count], segment[count] = i, k
                    count += 1
    return count, upper


@kernel_in_place
def fill_gaps_from_lines(
    position: Floats, cos: Floats, sin: Floats, size: Floats, lines: Floats, line: Ints, gaps: Floats
) -> None:
    """Fill in gaps; see `behavexplor.data.geometry.gaps_from_lines`.

    `cos` and `sin` are of the boxes' headings relative to their lines. The columns of `lines` are x and y of a point,
    and the direction.
    """
    for i in range(len(gaps)):
        k = line[i]
        x, y, line_cos, line_sin = lines[k, 0], lines[k, 1], lines[k, 2], lines[k, 3]
        across = abs((position[i, 1] - y) * line_cos - (position[i, 0] - x) * line_sin)
        gaps[i] = across - (abs(sin[i]) * size[0] + abs(cos[i]) * size[1]) / 2


@kernel_in_place
def fill_changed_frames(position: Floats, heading: Floats, frames: Ints) -> int:
    """Fill in the frames in which the first vehicle differs from the frame before, and the first frame.

    Args:
        position: centers, shape (T, N, 2) [m].
        heading: headings, shape (T, N) [rad].
        frames: frames, in order, shape (T,); changed in place.

    Returns:
        The number of such frames.
    """
    count = 0
    for t in range(len(heading)):
        if t == 0 or not _is_still(position[t, :1], position[t - 1, :1], heading[t, :1], heading[t - 1, :1]):
            frames[count] = t
            count += 1
    return count


@kernel_inner
def _fill_corners(position: Floats, cos: float, sin: float, size: Floats, corners: Floats) -> None:
    """Fill in the corners of a box, as `behavexplor.data.geometry.box_corners` computes them."""
    for k in range(4):
        ahead = (0.5 if k < 2 else -0.5) * size[0]
        aside = (-0.5 if 0 < k < 3 else 0.5) * size[1]
        corners[k, 0] = ahead * cos - aside * sin + position[0]
        corners[k, 1] = ahead * sin + aside * cos + position[1]


@kernel_inner
def _between_boxes(a: Floats, b: Floats) -> float:
    """Return the distance between two boxes, corners of shape (4, 2)."""
    return 0.0 if _overlap(a, b) else min(_corners_to_edges(a, b), _corners_to_edges(b, a))


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


@kernel_in_place
def fill_stations(points: Floats, vertices: Floats, pieces: Floats, ends: Floats, stations: Floats) -> None:
    """Fill in the station of each point's nearest place, on the segments around its nearest vertex [m].

    Args:
        points: points, shape (T, 2) [m].
        vertices: vertices of the polyline, shape (P, 2) [m].
        pieces: direction and length [m] of each segment, shape (P - 1, 3).
        ends: stations of the vertices [m], shape (P,).
        stations: stations of the points [m], shape (T,); changed in place.
    """
    vertex, longest = 0, _longest(pieces)
    for t in range(len(points)):
        x, y = points[t, 0], points[t, 1]
        vertex, least = _nearest(vertices, x, y, vertex, longest), math.inf
        for near in range(vertex - 2, vertex + 2):
            i = min(max(near, 0), len(pieces) - 1)
            dx, dy = pieces[i, 0], pieces[i, 1]
            ahead = min(max((x - vertices[i, 0]) * dx + (y - vertices[i, 1]) * dy, 0.0), pieces[i, 2])
            aside_x, aside_y = x - vertices[i, 0] - ahead * dx, y - vertices[i, 1] - ahead * dy
            gap = aside_x * aside_x + aside_y * aside_y
            if gap < least:
                stations[t], least = ends[i] + ahead, gap


@kernel_inner
def _longest(pieces: Floats) -> float:
    longest = 0.0
    for i in range(len(pieces)):
        longest = max(longest, pieces[i, 2])
    return longest


@kernel_inner
def _nearest(vertices: Floats, x: float, y: float, guess: int, longest: float) -> int:
    """Return the index of the vertex that is nearest to a point, the first of several.

    From both ends, it looks for vertices nearer than the guess. The farther away a vertex is, the more of the next ones
    cannot be nearer, and are left out.

    Args:
        vertices: vertices of the polyline, shape (P, 2) [m].
        x: the point's x [m].
        y: the point's y [m].
        guess: index of a vertex that may be near. It changes only the time that this takes.
        longest: greatest distance between neighboring vertices [m].
    """
    nearest, least = guess, _squared_distance(vertices[guess], x, y)
    for first, step in ((0, 1), (len(vertices) - 1, -1)):
        i = first
        while (guess - i) * step > 0:
            gap = _squared_distance(vertices[i], x, y)
            if gap < least or (gap == least and i < nearest):
                nearest, least = i, gap
            farther = (math.sqrt(gap) - math.sqrt(least) - _SLACK) / longest
            i += step * (int(farther) if farther > 1.0 else 1)
    return nearest


@kernel_inner
def _squared_distance(vertex: Floats, x: float, y: float) -> float:
    dx, dy = vertex[0] - x, vertex[1] - y
    squared: float = dx * dx + dy * dy
    return squared
