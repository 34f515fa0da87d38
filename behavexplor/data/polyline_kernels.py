"""Compiled projection on polylines, see `behavexplor.data.geometry.project_on_polyline`, which calls it."""

import math

import numpy as np
from numpy.typing import NDArray

from behavexplor.jit import kernel_in_place, kernel_inner

Floats = NDArray[np.float64]


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
    for t in range(len(points)):
        x, y = points[t, 0], points[t, 1]
        vertex, least = _nearest(vertices, x, y), math.inf
        for near in range(vertex - 2, vertex + 2):
            i = min(max(near, 0), len(pieces) - 1)
            dx, dy = pieces[i, 0], pieces[i, 1]
            ahead = min(max((x - vertices[i, 0]) * dx + (y - vertices[i, 1]) * dy, 0.0), pieces[i, 2])
            aside_x, aside_y = x - vertices[i, 0] - ahead * dx, y - vertices[i, 1] - ahead * dy
            gap = aside_x * aside_x + aside_y * aside_y
            if gap < least:
                stations[t], least = ends[i] + ahead, gap


@kernel_inner
def _nearest(vertices: Floats, x: float, y: float) -> int:
    nearest, least = 0, math.inf
    for i in range(len(vertices)):
        dx, dy = vertices[i, 0] - x, vertices[i, 1] - y
        gap = dx * dx + dy * dy
        if gap < least:
            nearest, least = i, gap
    return nearest
