"""Lanes as plain arrays, with the conversion of stations to points and of points to stations."""

import math
from collections.abc import Iterable
from typing import Final

import numpy as np

from behavexplor.data.array_types import Floats
from behavexplor.data.roadmap import Lane
from behavexplor.jit import kernel_inner

X: Final = 0  # start of the center line, x and y [m]
Y: Final = 1
HEADING: Final = 2  # heading at the start [rad]
LENGTH: Final = 3  # along the center line [m]
CURVATURE: Final = 4  # [1/m], positive to the right
COS: Final = 5  # cosine of the heading
SIN: Final = 6  # sine of the heading
N_COLUMNS: Final = 7

ROUNDING: Final = 1e-6  # much more than roundings change a distance [m]


def lane_array(lanes: Iterable[Lane]) -> Floats:
    """Return lanes as an array of shape (lanes, 7), with the columns above."""
    rows = [(lane.x, lane.y, lane.heading, lane.length, lane.curvature) for lane in lanes]
    return np.array([(*row, math.cos(row[HEADING]), math.sin(row[HEADING])) for row in rows])


@kernel_inner
def pose_on_lane(lanes: Floats, lane: int, station: float) -> tuple[float, float, float]:
    """Return position and heading at a station of a lane, which may lie beyond its ends."""
    x, y, start, curvature = lanes[lane, X], lanes[lane, Y], lanes[lane, HEADING], lanes[lane, CURVATURE]
    if curvature == 0.0:
        return x + station * lanes[lane, COS], y + station * lanes[lane, SIN], start
    heading = start + curvature * station
    x += (math.sin(heading) - lanes[lane, SIN]) / curvature
    y -= (math.cos(heading) - lanes[lane, COS]) / curvature
    return x, y, heading


@kernel_inner
def direction_on_lane(lanes: Floats, lane: int, station: float) -> tuple[float, float, float, float]:
    """Return position, and cosine and sine of the heading, at a station of a lane, which may lie beyond its ends."""
    x, y, start_cos, start_sin = lanes[lane, X], lanes[lane, Y], lanes[lane, COS], lanes[lane, SIN]
    curvature = lanes[lane, CURVATURE]
    if curvature == 0.0:
        return x + station * start_cos, y + station * start_sin, start_cos, start_sin
    heading = lanes[lane, HEADING] + curvature * station
    cos, sin = math.cos(heading), math.sin(heading)
    return x + (sin - start_sin) / curvature, y - (cos - start_cos) / curvature, cos, sin


@kernel_inner
def offset_on_lane(lanes: Floats, lane: int, x: float, y: float) -> float:
    """Return the offset of a point [m], positive to the right. On curves this is faster than `project_on_lane`."""
    cos, sin = lanes[lane, COS], lanes[lane, SIN]
    dx, dy = x - lanes[lane, X], y - lanes[lane, Y]
    aside: float = dy * cos - dx * sin
    if lanes[lane, CURVATURE] == 0.0:
        return aside
    radius: float = 1 / lanes[lane, CURVATURE]
    return radius - math.copysign(1.0, radius) * math.hypot(radius - aside, dx * cos + dy * sin)


@kernel_inner
def is_far_from_arc(lanes: Floats, lane: int, x: float, y: float, gap: float) -> bool:
    """Return whether a point is surely farther than a gap [m] from the circle of a curved lane.

    This is faster than `offset_on_lane`, and wrong about points that are farther by less than `ROUNDING`.
    """
    cos, sin = lanes[lane, COS], lanes[lane, SIN]
    dx, dy = x - lanes[lane, X], y - lanes[lane, Y]
    radius = 1 / lanes[lane, CURVATURE]
    right, ahead = radius - (dy * cos - dx * sin), dx * cos + dy * sin
    return bool(abs(abs(radius) - math.sqrt(right * right + ahead * ahead)) > gap + ROUNDING)


@kernel_inner
def is_near_center_line(lanes: Floats, lane: int, x: float, y: float, gap: float) -> bool:
    """Return whether a point is at most a gap [m] from the center line of a lane, continued beyond its ends."""
    if lanes[lane, CURVATURE] != 0.0 and is_far_from_arc(lanes, lane, x, y, gap):
        return False
    return abs(offset_on_lane(lanes, lane, x, y)) <= gap


@kernel_inner
def project_on_lane(lanes: Floats, lane: int, x: float, y: float) -> tuple[float, float]:
    """Return station and offset (positive to the right) of a point [m]."""
    cos, sin = lanes[lane, COS], lanes[lane, SIN]
    dx, dy = x - lanes[lane, X], y - lanes[lane, Y]
    ahead, aside = dx * cos + dy * sin, dy * cos - dx * sin
    if lanes[lane, CURVATURE] == 0.0:
        return ahead, aside
    radius = 1 / lanes[lane, CURVATURE]
    right = radius - aside  # lateral distance from the point to the center of the arc [m]
    side = math.copysign(1.0, radius)
    station = math.atan2(side * ahead, side * right) * radius
    return station, radius - side * math.hypot(right, ahead)
