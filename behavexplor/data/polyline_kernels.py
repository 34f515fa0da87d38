"""Compiled projection on polylines, see `behavexplor.data.geometry.project_on_polyline`, which calls it."""

import math
from typing import Final

from behavexplor.data.array_types import Floats
from behavexplor.jit import kernel_in_place, kernel_inner

_SLACK: Final = 1e-6  # more than rounding changes a distance [m]


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
