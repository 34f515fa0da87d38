"""Contact and distances of boxes and segments, and stations on polylines, compiled for `behavexplor.data.geometry`."""

import math
from typing import Final, TypeAlias

from behavexplor.data.array_types import Floats, Ints
from behavexplor.jit import kernel_in_place, kernel_inner

Corners: TypeAlias = tuple[tuple[float, float, float, float], tuple[float, float, float, float]]  # all x, all y [m]

BLOCK: Final = 8  # points that share one bound in the search for the nearest segment
_SLACK: Final = 1e-6  # more than rounding changes a distance [m]


@kernel_in_place
def fill_box_distances(a: Floats, b: Floats, gaps: Floats) -> None:
    """Fill in the distance of each pair of boxes; corners of shape (n, 4, 2), distances of shape (n,)."""
    for i in range(len(gaps)):
        gaps[i] = _between_boxes(_corners_in(a[i]), _corners_in(b[i]))


@kernel_in_place
def fill_distances_from_first(
    position: Floats, cos: Floats, sin: Floats, size: Floats, frame: Ints, vehicle: Ints, gaps: Floats
) -> None:
    """Fill in distances; see `behavexplor.data.geometry.distances_from_first`.

    The directions of the first vehicle and of the others have the shape (2, n).
    """
    for i in range(len(gaps)):
        t, other = frame[i], vehicle[i]
        ego = corners(position[t, 0, 0], position[t, 0, 1], cos[0, i], sin[0, i], size[0, 0], size[0, 1])
        place, extent = position[t, other], size[other]
        npc = corners(place[0], place[1], cos[1, i], sin[1, i], extent[0], extent[1])
        gaps[i] = _between_boxes(ego, npc)


@kernel_in_place
def fill_distances_from_segments(
    position: Floats, cos: Floats, sin: Floats, size: Floats, segments: Floats, segment: Ints, gaps: Floats
) -> None:
    """Fill in distances; see `behavexplor.data.geometry.distances_from_segments`.

    The directions of the boxes have the shape (n,).
    """
    for i in range(len(gaps)):
        box = corners(position[i, 0], position[i, 1], cos[i], sin[i], size[0], size[1])
        line = segments[segment[i]]
        ax, ay, bx, by = line[0, 0], line[0, 1], line[1, 0], line[1, 1]
        gaps[i] = 0.0
        if not line_meets_box(box, ax, ay, bx, by):
            gaps[i] = min(_to_edges(ax, ay, box), _to_edges(bx, by, box))
            for k in range(4):
                gaps[i] = min(gaps[i], line_distance(box[0][k], box[1][k], ax, ay, bx, by))


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
            gaps[i, k] = _to_segment(points[i], segments[k])


@kernel_in_place
def fill_near_segments(
    points: Floats, segments: Floats, reach: float, within: float, gaps: Floats, point: Ints, segment: Ints
) -> tuple[int, float]:
    """Fill in the pairs that may have the least distance; see `behavexplor.data.geometry.near_segments`.

    All points of a block lie within `spread` of its first one, whose distances from the segments are the `gaps`.

    Return the number of pairs, and the upper bound of the least distance [m].
    """
    upper, count = math.inf, 0
    for block in range(len(gaps)):
        for k in range(len(segments)):
            gaps[block, k] = _to_segment(points[block * BLOCK], segments[k])
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
    """Fill in frame 0 and each frame in which the first vehicle moves or turns, in order, and return their number.

    Centers have the shape (T, N, 2) [m], headings (T, N) [rad], `frames` (T,).
    """
    count = 0
    for t in range(len(heading)):
        if t == 0 or not _is_still(position[t, :1], position[t - 1, :1], heading[t, :1], heading[t - 1, :1]):
            frames[count] = t
            count += 1
    return count


@kernel_inner
def corners(x: float, y: float, cos: float, sin: float, length: float, width: float) -> Corners:
    """Compute the corners of an oriented box, in order around it, term by term as `geometry.box_corners` does."""
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
        low, high = span(box, ex, ey)
        other_low, other_high = span(other, ex, ey)
        if high < other_low or other_high < low:
            return True
    return False


@kernel_inner
def span(box: Corners, ex: float, ey: float) -> tuple[float, float]:
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
        ex, ey = (xs[i + 1] - xs[i], ys[i + 1] - ys[i]) if i < 2 else (ay - by, bx - ax)
        low, high = span(box, ex, ey)
        start, end = ax * ex + ay * ey, bx * ex + by * ey
        if high < min(start, end) or max(start, end) < low:
            return False
    return True


@kernel_inner
def _corners_in(box: Floats) -> Corners:
    """Return the corners in an array, shape (4, 2)."""
    return (box[0, 0], box[1, 0], box[2, 0], box[3, 0]), (box[0, 1], box[1, 1], box[2, 1], box[3, 1])


@kernel_inner
def _between_boxes(a: Corners, b: Corners) -> float:
    """Return the distance between two boxes [m]."""
    return 0.0 if boxes_touch(a, b) else min(_corners_to_edges(a, b), _corners_to_edges(b, a))


@kernel_inner
def _corners_to_edges(a: Corners, b: Corners) -> float:
    """Return the least distance of the corners of one box from the edges of the other one [m]."""
    xs, ys = a
    least = math.inf
    for k in range(4):
        least = min(least, _to_edges(xs[k], ys[k], b))
    return least


@kernel_inner
def _is_still(position: Floats, before: Floats, heading: Floats, heading_before: Floats) -> bool:
    """Return whether no vehicle has moved or turned."""
    for i in range(len(heading)):
        if heading[i] != heading_before[i] or position[i, 0] != before[i, 0] or position[i, 1] != before[i, 1]:
            return False
    return True


@kernel_inner
def _to_edges(x: float, y: float, box: Corners) -> float:
    """Return the least distance of a point from the edges of a box."""
    xs, ys = box
    least = math.inf
    for k in range(4):
        after = (k + 1) % 4
        least = min(least, line_distance(x, y, xs[k], ys[k], xs[after], ys[after]))
    return least


@kernel_inner
def _to_segment(point: Floats, segment: Floats) -> float:
    return line_distance(point[0], point[1], segment[0, 0], segment[0, 1], segment[1, 0], segment[1, 1])


@kernel_in_place
def fill_stations(points: Floats, vertices: Floats, pieces: Floats, ends: Floats, stations: Floats) -> None:
    """Fill in the station of each point's nearest place, on the segments around its nearest vertex [m].

    Points have the shape (T, 2) [m], their stations (T,), the polyline's vertices (P, 2) [m]. Pieces are the direction
    and length [m] of each segment, shape (P - 1, 3), and `ends` the stations of the vertices, shape (P,) [m].
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

    `vertices` has the shape (P, 2) [m]. `guess`, an index, changes only the time that this takes. `longest` is the
    greatest distance between neighboring vertices [m].
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
