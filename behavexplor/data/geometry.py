"""Oriented boxes and line segments in the plane: corners, overlap and exact distances; and projection on polylines.

The world frame is highway-env's: x points to the right, y points down, and headings turn from x toward y. A positive
lateral offset therefore lies to the right of the direction of travel. Lengths are in meters, angles in radians.
"""

import math
from functools import lru_cache

import numpy as np

from behavexplor.data import box_kernels
from behavexplor.data.array_types import Bools, Floats, Ints

_UNIT_BOX = np.array([[0.5, 0.5], [0.5, -0.5], [-0.5, -0.5], [-0.5, 0.5]])


def box_corners(position: Floats, heading: Floats, size: Floats) -> Floats:
    """Compute the corners of oriented boxes in order around each box, shape (..., 4, 2).

    Centers have the shape (..., 2) [m], headings (...) [rad]; length and width, shape (..., 2) [m], are broadcast
    against the centers.
    """
    local = _UNIT_BOX * np.asarray(size)[..., None, :]
    cos, sin = np.cos(heading)[..., None], np.sin(heading)[..., None]
    center = np.asarray(position)[..., None, :]
    x = local[..., 0] * cos - local[..., 1] * sin + center[..., 0]
    y = local[..., 0] * sin + local[..., 1] * cos + center[..., 1]
    corners = np.empty((*x.shape, 2))
    corners[..., 0], corners[..., 1] = x, y
    return corners


def boxes_overlap(a: Floats, b: Floats) -> Bools:
    """Return whether boxes touch or overlap, shape (...), by the separating axis theorem.

    They are given by their corners, shape (..., 4, 2).
    """
    separated = np.zeros(np.broadcast_shapes(a.shape[:-2], b.shape[:-2]), dtype=bool)
    for box in (a, b):
        for edge in (box[..., 1, :] - box[..., 0, :], box[..., 2, :] - box[..., 1, :]):
            along_a = np.einsum("...ij,...j->...i", a, edge)
            along_b = np.einsum("...ij,...j->...i", b, edge)
            separated |= along_a.max(-1) < along_b.min(-1)
            separated |= along_b.max(-1) < along_a.min(-1)
    return ~separated


def point_segment_distances(points: Floats, segments: Floats) -> Floats:
    """Compute the distances of points, shape (n, 2), from segments, shape (m, 2, 2); distances of shape (n, m)."""
    gaps = np.empty((len(points), len(segments)))
    box_kernels.fill_point_segment_distances(np.array(points, order="C"), np.array(segments, order="C"), gaps)
    return gaps


def point_box_distance(point: Floats, position: Floats, heading: Floats, size: Floats) -> Floats:
    """Compute the distance from a point, shape (2,), to boxes, 0 within them; shape (...) [m].

    Centers have the shape (..., 2) [m], headings (...) [rad]; all boxes have one length and width, shape (2,) [m].
    """
    gap = point - position
    cos, sin = np.cos(heading), np.sin(heading)
    ahead = np.abs(gap[..., 0] * cos + gap[..., 1] * sin) - size[0] / 2
    across = np.abs(gap[..., 1] * cos - gap[..., 0] * sin) - size[1] / 2
    return np.asarray(np.hypot(np.maximum(ahead, 0.0), np.maximum(across, 0.0)))


def box_distance(a: Floats, b: Floats) -> Floats:
    """Compute the shortest distances between boxes, shape (...) [m]; 0 if they touch or overlap.

    Boxes are given by their corners, shape (..., 4, 2) [m].
    """
    if a.shape != b.shape:
        a, b = np.broadcast_arrays(a, b)
    gaps = np.empty(a.shape[:-2])
    box_kernels.fill_box_distances(_flat(a, 4), _flat(b, 4), gaps.reshape(-1))
    return gaps


def gap_bounds(position: Floats, heading: Floats, outer: Floats, inner: Floats) -> tuple[Floats, float]:
    """Bound the distances between the first vehicle and the others by circles, in each frame.

    Centers have the shape (T, N, 2) [m], headings (T, N) [rad]. The circles around and inside the vehicles have the
    radii `outer` and `inner`, shape (N,) [m]. Return lower bounds, shape (T, N - 1) [m], which are infinite in a frame
    that equals the one before; and an upper bound of the least distance of all [m].
    """
    lower = np.empty((len(position), len(outer) - 1))
    upper = box_kernels.fill_gap_bounds(
        np.ascontiguousarray(position), np.ascontiguousarray(heading), outer, inner, lower
    )
    return lower, upper


def changed_frames(position: Floats, heading: Floats) -> Ints:
    """Return the frames in which the first vehicle differs from the frame before, and the first frame.

    Centers have the shape (T, N, 2) [m], headings (T, N) [rad].
    """
    frames = np.empty(len(heading), dtype=np.intp)
    count = box_kernels.fill_changed_frames(np.ascontiguousarray(position), np.ascontiguousarray(heading), frames)
    return frames[:count]


def distances_from_first(position: Floats, heading: Floats, size: Floats, frame: Ints, vehicle: Ints) -> Floats:
    """Compute the shortest distances between the first vehicle's box and those of others, shape (n,) [m].

    They are 0 if the boxes touch. Centers have the shape (T, N, 2) [m], headings (T, N) [rad], sizes (N, 2) [m].
    Distance k is that from vehicle `vehicle[k]` in frame `frame[k]`; both have the shape (n,).
    """
    turned = np.stack([heading[frame, 0], heading[frame, vehicle]])
    gaps = np.empty(len(frame))
    directions = np.cos(turned), np.sin(turned)  # numpy's own functions, whose last bits differ from C's
    box_kernels.fill_distances_from_first(np.ascontiguousarray(position), *directions, size, frame, vehicle, gaps)
    return gaps


def distances_from_segments(position: Floats, heading: Floats, size: Floats, segments: Floats, segment: Ints) -> Floats:
    """Compute the shortest distance of each of n equal boxes from one of m segments, shape (n,) [m].

    It is 0 if they touch or the segment enters the box.

    Args:
        position: centers of the boxes, shape (n, 2) [m].
        heading: headings of the boxes, shape (n,) [rad].
        size: length and width of every box, shape (2,) [m].
        segments: shape (m, 2, 2) [m].
        segment: index of the segment for each box, shape (n,).
    """
    gaps = np.empty(len(position))
    directions = np.cos(heading), np.sin(heading)  # numpy's own functions, whose last bits differ from C's
    box_kernels.fill_distances_from_segments(np.ascontiguousarray(position), *directions, size, segments, segment, gaps)
    return gaps


def near_segments(points: Floats, segments: Floats, reach: float, within: float) -> tuple[Ints, Ints, float]:
    """Find the pairs of boxes and segments that may have the least distance.

    Return the indices of the points and of the segments, and an upper bound of the least distance [m].

    Args:
        points: centers of the boxes, one after the other along their way, shape (n, 2) [m].
        segments: shape (m, 2, 2) [m].
        reach: radius of a circle around each box [m].
        within: radius of a circle inside each box [m].
    """
    blocks = math.ceil(len(points) / box_kernels.BLOCK)
    gaps = np.empty((blocks, len(segments)))
    point, segment = np.empty((2, blocks * box_kernels.BLOCK * len(segments)), dtype=np.intp)
    count, upper = box_kernels.fill_near_segments(
        np.ascontiguousarray(points), segments, reach, within, gaps, point, segment
    )
    return point[:count], segment[:count], upper


def gaps_from_lines(position: Floats, heading: Floats, size: Floats, segments: Floats, segment: Ints) -> Floats:
    """Compute the gaps between equal boxes and the infinite lines through segments, negative where they meet [m].

    They are never greater than the distances that `distances_from_segments` computes from the same arguments.
    """
    along = segments[:, 1] - segments[:, 0]
    angle = np.arctan2(along[:, 1], along[:, 0])
    turned, gaps = heading - angle[segment], np.empty(len(heading))
    lines = np.column_stack([segments[:, 0], np.cos(angle), np.sin(angle)])
    box_kernels.fill_gaps_from_lines(
        np.ascontiguousarray(position), np.cos(turned), np.sin(turned), size, lines, segment, gaps
    )
    return gaps


def _flat(points: Floats, count: int) -> Floats:
    """Return figures of some points each, shape (..., count, 2), as one writable array of shape (n, count, 2)."""
    return np.array(points, dtype=np.float64, order="C").reshape(-1, count, 2)


def segment_meets_box(box: Floats, segment: Floats) -> Bools:
    """Return whether segments (..., 2, 2) touch or enter boxes (..., 4, 2), by the separating axis theorem."""
    start, end = segment[..., 0, :], segment[..., 1, :]
    along = end - start
    normal = np.stack([-along[..., 1], along[..., 0]], axis=-1)
    ends = np.stack(np.broadcast_arrays(start, end), axis=-2)
    separated = np.zeros(np.broadcast_shapes(box.shape[:-2], start.shape[:-1]), dtype=bool)
    for axis in (box[..., 1, :] - box[..., 0, :], box[..., 2, :] - box[..., 1, :], normal):
        along_box = np.einsum("...ij,...j->...i", box, axis)
        along_ends = np.einsum("...ij,...j->...i", ends, axis)
        separated |= along_box.max(-1) < along_ends.min(-1)
        separated |= along_ends.max(-1) < along_box.min(-1)
    return ~separated


def project_on_polyline(points: Floats, polyline: Floats) -> tuple[Floats, Floats]:
    """Project points, shape (T, 2) [m], on a polyline, shape (P, 2), P >= 2 [m].

    Its segments must be about equally long, as only those around a point's nearest vertex are considered.

    Return the station of each projected point [m] and the polyline's heading there [rad], each of shape (T,). The
    heading is interpolated between those at the middles of the segments.
    """
    vertices = np.array(polyline, dtype=np.float64, order="C")
    pieces, ends, heading = _pieces(vertices.tobytes())
    station = np.empty(len(points))
    box_kernels.fill_stations(np.array(points, dtype=np.float64, order="C"), vertices, pieces, ends, station)
    return station, np.interp(station, (ends[:-1] + ends[1:]) / 2, heading)


@lru_cache(maxsize=8)  # all traces of a scene have the same route
def _pieces(vertices: bytes) -> tuple[Floats, Floats, Floats]:
    """Return a polyline's segments, the stations of the vertices, shape (P,) [m], and the headings of the segments.

    A segment is its direction, as a unit vector, and its length, shape (P - 1, 3) [m]. Headings, shape (P - 1,) [rad],
    have no jumps by a whole turn. `vertices` are the bytes of floats of shape (P, 2), because the cache needs a key.
    """
    along = np.diff(np.frombuffer(vertices).reshape(-1, 2), axis=0)
    length = np.hypot(along[:, 0], along[:, 1])
    ends = np.concatenate([[0.0], np.cumsum(length)])
    heading = np.unwrap(np.arctan2(along[:, 1], along[:, 0]))
    return np.column_stack([along / length[:, None], length]), ends, heading
