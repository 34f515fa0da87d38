"""The ego's path: its route as a reference line, with the lanes beside it, and steering along it by pure pursuit."""

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from behavexplor.ads.road import lane_arrays
from behavexplor.ads.scene_io import STEERING_RANGE
from behavexplor.data.array_types import Floats
from behavexplor.data.conventions import wrapped
from behavexplor.data.roadmap import Lane, RoadMap
from behavexplor.data.scene import EGO, HEADING, LENGTH, SPEED, X, Y
from behavexplor.jit import kernel_inner

SPACING: Final = 1.0  # distance between the stations of the tables of limits and neighboring lanes [m]
LATERAL_ACCELERATION: Final = 2.5  # greatest lateral acceleration in curves [m/s2]
APPROACH_BRAKING: Final = 2.0  # deceleration before curves [m/s2]
LOOK_AHEAD: Final = 4.0  # distance of the pursued point at standstill [m]
LOOK_AHEAD_TIME: Final = 0.3  # growth of that distance with speed [s]


class Path(NamedTuple):
    """The ego's route as plain arrays."""

    # lanes of the route, with successive lanes of equal curvature joined, shape (lanes, 7), see
    # `behavexplor.ads.road.lane_arrays`
    lanes: Floats
    bounds: Floats  # stations where the lanes begin, and the station where the last one ends [m], shape (lanes + 1,)
    limits: Floats  # greatest allowed speed every `SPACING` meters [m/s], shape (stations,)
    left: Floats  # number of lanes in the ego's direction to the left of the route, shape (stations,)
    right: Floats  # number of lanes in the ego's direction to the right of the route, shape (stations,)
    oncoming: Floats  # 1 where a lane of the opposite direction lies left of all these lanes, else 0, shape (stations,)
    junction_start: float  # station of the stop line [m]; infinity without a junction
    junction_end: float  # station at which the junction ends [m]; minus infinity without a junction
    destination: float  # station of the destination [m]
    lane_width: float  # width of a lane [m]
    speed_limit: float  # speed limit of the map [m/s]


def ego_path(
    roadmap: RoadMap, lateral_acceleration: float = LATERAL_ACCELERATION, approach_braking: float = APPROACH_BRAKING
) -> Path:
    """Make the ego's path from its route and the lanes beside it.

    Its limits keep the lateral acceleration in curves, and the deceleration before them, within the given ones [m/s2].
    """
    route = roadmap.ego_route
    inside = [i for i, lane in enumerate(route.lanes) if lane.junction]
    lanes = _joined(route.lanes)
    beside = np.array([_beside(roadmap, lane) for lane in route.lanes], dtype=np.float64)
    stations = np.arange(0.0, route.length + SPACING, SPACING)
    left, right, oncoming = beside[np.searchsorted(route.bounds[1:-1], stations, side="right")].T
    return Path(
        lanes=lane_arrays.lane_array(lanes),
        bounds=np.concatenate([[0.0], np.cumsum([lane.length for lane in lanes])]),
        limits=_speed_limits(roadmap, stations, lateral_acceleration, approach_braking),
        left=np.ascontiguousarray(left),
        right=np.ascontiguousarray(right),
        oncoming=np.ascontiguousarray(oncoming),
        junction_start=float(route.bounds[inside[0]]) if inside else math.inf,
        junction_end=float(route.bounds[inside[-1] + 1]) if inside else -math.inf,
        destination=float(roadmap.destination),
        lane_width=float(route.lanes[0].width),
        speed_limit=float(roadmap.speed_limit),
    )


def _beside(roadmap: RoadMap, lane: Lane) -> tuple[int, int, bool]:
    """Count the lanes left and right of a lane in its direction, and tell whether an oncoming lane is next to them."""
    group = [other for other in roadmap.lanes if (other.origin, other.target) == (lane.origin, lane.target)]
    left = group.index(lane)
    x, y, heading = lane.pose(lane.length / 2)
    aside = -(left + 1) * lane.width
    x, y = x - aside * math.sin(heading), y + aside * math.cos(heading)
    oncoming = any(_runs_against(other, x, y, heading) for other in roadmap.lanes if not other.junction)
    return left, len(group) - 1 - left, oncoming and not lane.junction


def _runs_against(lane: Lane, x: float, y: float, heading: float) -> bool:
    """Return whether a lane's center line runs through a point in the opposite direction."""
    station, offset = lane.project(x, y)
    turned = wrapped(lane.heading - heading)
    return abs(offset) < 0.1 and 0 <= station <= lane.length and abs(turned) > math.pi / 2


def _joined(lanes: Iterable[Lane]) -> list[Lane]:
    """Join successive lanes of equal curvature, which makes the path quicker to search."""
    joined: list[Lane] = []
    for lane in lanes:
        if joined and joined[-1].curvature == lane.curvature:
            joined[-1] = replace(joined[-1], length=joined[-1].length + lane.length)
        else:
            joined.append(lane)
    return joined


def _speed_limits(roadmap: RoadMap, stations: Floats, lateral_acceleration: float, approach_braking: float) -> Floats:
    """Compute the greatest allowed speeds: the map's limit, lower in curves and on the braking distance before them."""
    route = roadmap.ego_route
    lane = np.searchsorted(route.bounds[1:-1], stations, side="right")
    curvature = np.abs([route.lanes[i].curvature for i in lane])
    limits = np.full(len(stations), float(roadmap.speed_limit))
    curved = curvature > 0
    limits[curved] = np.minimum(limits[curved], np.sqrt(lateral_acceleration / curvature[curved]))
    for i in range(len(limits) - 2, -1, -1):
        limits[i] = min(limits[i], math.sqrt(limits[i + 1] ** 2 + 2 * approach_braking * SPACING))
    return limits


@kernel_inner
def row_at(path: Path, station: float) -> int:
    """Return the row of the path's tables, such as `limits`, for a station [m]."""
    return min(max(int(station / SPACING), 0), len(path.limits) - 1)


@kernel_inner
def limit_at(path: Path, station: float) -> float:
    """Return the greatest allowed speed [m/s] at a station [m]."""
    limit: float = path.limits[row_at(path, station)]
    return limit


@kernel_inner
def has_lane(path: Path, lane: int, station: float) -> bool:
    """Return whether a lane (0 is the route's, 1 the next to the right) runs in the ego's direction at a station."""
    i = row_at(path, station)
    return bool(-path.left[i] <= lane <= path.right[i])


@kernel_inner
def oncoming_lane(path: Path, station: float) -> int:
    """Return the oncoming lane next to the lanes in the ego's direction, 0 if there is none."""
    i = row_at(path, station)
    return -int(path.left[i]) - 1 if path.oncoming[i] else 0


@kernel_inner
def lane_end(path: Path, lane: int, station: float) -> float:
    """Return the station by which a lane other than the route's must be left: its end, or the destination [m]."""
    end = station
    while end < path.destination and (has_lane(path, lane, end) or oncoming_lane(path, end) == lane):
        end += SPACING
    return min(end, path.destination)


@kernel_inner
def locate_on_path(path: Path, x: float, y: float) -> tuple[int, float, float]:
    """Return the lane of the route nearest to a point, and the point's station and offset on the route [m]."""
    last = len(path.lanes) - 1
    nearest, best, best_station, best_offset = math.inf, 0, 0.0, 0.0
    for curved in (False, True):  # straight lanes first: they are cheaper, and usually nearer
        for i in range(last + 1):
            if (path.lanes[i, lane_arrays.CURVATURE] != 0.0) != curved:
                continue
            if curved and lane_arrays.is_far_from_arc(path.lanes, i, x, y, math.sqrt(nearest)):
                continue
            station, offset = lane_arrays.project_on_lane(path.lanes, i, x, y)
            gap = offset * offset + _outside(path, i, station) ** 2
            if gap < nearest or (gap == nearest and i < best):
                nearest, best, best_station, best_offset = gap, i, path.bounds[i] + station, offset
    return best, best_station, best_offset


@kernel_inner
def _outside(path: Path, lane: int, station: float) -> float:
    """Return how far a station lies beyond a lane's ends [m]; the first and last lane continue beyond the route."""
    if station < 0.0:
        return -station if lane > 0 else 0.0
    return max(station - path.lanes[lane, lane_arrays.LENGTH], 0.0) if lane < len(path.lanes) - 1 else 0.0


@kernel_inner
def project_on_path(path: Path, x: float, y: float) -> tuple[float, float]:
    """Return station and offset (positive to the right) of a point [m]; the route continues beyond its ends."""
    _, station, offset = locate_on_path(path, x, y)
    return station, offset


@kernel_inner
def is_straight(path: Path, lane: int, low: float, high: float) -> bool:
    """Return whether the route is straight between two stations around a lane; the route continues beyond its ends."""
    if path.lanes[lane, lane_arrays.CURVATURE] != 0.0:
        return False
    starts = lane == 0 or low >= path.bounds[lane]
    return bool(starts and (lane == len(path.lanes) - 1 or high <= path.bounds[lane + 1]))


@kernel_inner
def pose_on_path(path: Path, station: float) -> tuple[float, float, float]:
    """Return position and heading at a station; the route continues beyond its ends."""
    i = 0
    while i < len(path.lanes) - 1 and station > path.bounds[i + 1]:
        i += 1
    return lane_arrays.pose_on_lane(path.lanes, i, station - path.bounds[i])


@kernel_inner
def point_beside(path: Path, station: float, offset: float) -> tuple[float, float]:
    """Return the point at a station and an offset."""
    x, y, heading = pose_on_path(path, station)
    return x - offset * math.sin(heading), y + offset * math.cos(heading)


@kernel_inner
def steer(path: Path, scene: Floats, station: float, offset: float) -> float:
    """Return the steering angle [rad] by pure pursuit of a point ahead, at an offset from the path.

    The circle through that point is exact for highway-env's bicycle model.
    """
    x, y, along = pose_on_path(path, station + LOOK_AHEAD + LOOK_AHEAD_TIME * scene[EGO, SPEED])
    dx = x - math.sin(along) * offset - scene[EGO, X]
    dy = y + math.cos(along) * offset - scene[EGO, Y]
    bearing = math.atan2(dy, dx) - scene[EGO, HEADING]
    share = scene[EGO, LENGTH] / math.hypot(dx, dy)
    wanted = math.atan(2 * share * math.sin(bearing) / (1 + share * math.cos(bearing)))
    return min(max(wanted, STEERING_RANGE[0]), STEERING_RANGE[1])
