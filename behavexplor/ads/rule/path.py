"""Path: the ego's way in Frenet coordinates; for now it keeps to the centre line of its route."""

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from behavexplor.ads.rule.lanes import LENGTH, lane_array, pose_on_lane, project_on_lane
from behavexplor.ads.rule.parameters import Parameters
from behavexplor.compiled import kernel
from behavexplor.roadmap import Lane, RoadMap

Floats = NDArray[np.float64]

SPACING = 1.0  # of the stations at which the speed limit is kept [m]


class Path(NamedTuple):
    """The ego's route as plain arrays.

    Attributes:
        lanes: its lanes, those of equal curvature joined, shape (lanes, 7), see `behavexplor.ads.rule.lanes`.
        bounds: stations where they begin, and where the last one ends [m], shape (lanes + 1,).
        limits: greatest speed every `SPACING` metres [m/s], shape (stations,).
        junction_start: station of the stop line [m], infinite without a junction.
        junction_end: station where the junction ends [m], minus infinity without one.
        speed_limit: of the map [m/s].
    """

    lanes: Floats
    bounds: Floats
    limits: Floats
    junction_start: float
    junction_end: float
    speed_limit: float


def ego_path(roadmap: RoadMap, parameters: Parameters) -> Path:
    """The path along the centre line of the ego's route."""
    route = roadmap.ego_route
    inside = [i for i, lane in enumerate(route.lanes) if lane.junction]
    lanes = _joined(route.lanes)
    return Path(
        lanes=lane_array(lanes),
        bounds=np.concatenate([[0.0], np.cumsum([lane.length for lane in lanes])]),
        limits=_speed_limits(roadmap, parameters),
        junction_start=float(route.bounds[inside[0]]) if inside else math.inf,
        junction_end=float(route.bounds[inside[-1] + 1]) if inside else -math.inf,
        speed_limit=float(roadmap.speed_limit),
    )


def _joined(lanes: Iterable[Lane]) -> list[Lane]:
    """The lanes with those of equal curvature joined, which makes them quicker to search."""
    joined: list[Lane] = []
    for lane in lanes:
        if joined and joined[-1].curvature == lane.curvature:
            joined[-1] = replace(joined[-1], length=joined[-1].length + lane.length)
        else:
            joined.append(lane)
    return joined


def _speed_limits(roadmap: RoadMap, parameters: Parameters) -> Floats:
    """The map's limit, lower in curves, and before them as far as braking takes."""
    route = roadmap.ego_route
    stations = np.arange(0.0, route.length + SPACING, SPACING)
    lane = np.searchsorted(route.bounds[1:-1], stations, side="right")
    curvature = np.abs([route.lanes[i].curvature for i in lane])
    limits = np.full(len(stations), float(roadmap.speed_limit))
    curved = curvature > 0
    limits[curved] = np.minimum(limits[curved], np.sqrt(parameters.lateral_acceleration / curvature[curved]))
    for i in range(len(limits) - 2, -1, -1):
        limits[i] = min(limits[i], math.sqrt(limits[i + 1] ** 2 + 2 * parameters.approach_braking * SPACING))
    return limits


@kernel
def limit_at(path: Path, station: float) -> float:
    """Greatest speed [m/s] at a station [m]."""
    limit: float = path.limits[min(max(int(station / SPACING), 0), len(path.limits) - 1)]
    return limit


@kernel
def project_on_path(path: Path, x: float, y: float) -> tuple[float, float]:
    """Station and offset (positive to the right) of a point [m]; the outer lanes are continued."""
    last = len(path.lanes) - 1
    nearest, best_station, best_offset = math.inf, 0.0, 0.0
    for i in range(last + 1):
        station, offset = project_on_lane(path.lanes, i, x, y)
        outside = 0.0
        if i > 0:
            outside = max(outside, -station)
        if i < last:
            outside = max(outside, station - path.lanes[i, LENGTH])
        gap = math.hypot(offset, outside)
        if gap < nearest:
            nearest, best_station, best_offset = gap, path.bounds[i] + station, offset
    return best_station, best_offset


@kernel
def pose_on_path(path: Path, station: float) -> tuple[float, float, float]:
    """Position and heading at a station; the outer lanes are continued."""
    i = 0
    while i < len(path.lanes) - 1 and station > path.bounds[i + 1]:
        i += 1
    return pose_on_lane(path.lanes, i, station - path.bounds[i])
