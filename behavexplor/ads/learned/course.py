"""The ego's course as tables: what can be known of it before anyone drives."""

import math
from functools import cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from behavexplor.ads.rule.lanes import lane_array, pose_on_lane, project_on_lane
from behavexplor.compiled import kernel
from behavexplor.logical import EGO_SIZE
from behavexplor.roadmap import Lane, RoadMap

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SPACING: Final = 1.0  # of the stations at which the tables have a row [m]
LATERAL_ACCELERATION: Final = 2.5  # in curves [m/s2]
BRAKING: Final = 2.0  # before curves [m/s2]
SIDE_GAP: Final = 0.3  # between two vehicles side by side that are in conflict nevertheless [m]
CAR: Final = (4.6, 2.1)  # length and width of a vehicle whose conflicts are worked out beforehand [m]

IN, OUT, START, END = 0, 1, 2, 3  # columns of `Course.zones`


class Course(NamedTuple):
    """Tables of a map for one ego route.

    Attributes:
        path: the lanes of the ego's route, shape (P, 7), see `behavexplor.ads.rule.lanes`.
        bounds: stations where they begin, and where the last one ends [m], shape (P + 1,).
        limit: greatest speed [m/s] every `SPACING` metres, lower in curves and before them, shape (S,).
        curvature: [1/m], positive to the right, shape (S,).
        left: how many lanes of the same direction lie to the left, shape (S,).
        right: how many lie to the right, shape (S,).
        side_by_side: distance to where these lanes end [m], shape (S,).
        lanes: all lanes on which others drive, shape (L, 7).
        tails: for each lane where its ways on begin in `zones`, shape (L + 1,).
        zones: for each way on, measured from the start of its first lane, where a vehicle enters the ego's path and
            where it leaves it, and the stretch of the ego's path between, shape (Z, 4) [m]; infinite if it never does.
        own: whether a lane is one of the ego's route, shape (L,).
        junction_start: station where the junction begins [m], infinite without one.
        junction_end: station where it ends [m], minus infinity without one.
        destination: station [m].
        width: of a lane [m].
        speed_limit: [m/s].
    """

    path: Floats
    bounds: Floats
    limit: Floats
    curvature: Floats
    left: Ints
    right: Ints
    side_by_side: Floats
    lanes: Floats
    tails: Ints
    zones: Floats
    own: NDArray[np.bool_]
    junction_start: float
    junction_end: float
    destination: float
    width: float
    speed_limit: float


@cache
def make_course(roadmap: RoadMap) -> Course:
    """The tables of a map."""
    route = roadmap.ego_route
    stations = np.arange(0.0, route.length + SPACING, SPACING)
    index = np.searchsorted(route.bounds[1:-1], stations, side="right")
    curvature = np.array([lane.curvature for lane in route.lanes])[index]
    beside = [_beside(roadmap, lane) for lane in route.lanes]
    inside = [i for i, lane in enumerate(route.lanes) if lane.junction]
    path, bounds = lane_array(route.lanes), route.bounds.astype(np.float64)
    lanes = tuple({lane.name: lane for other in roadmap.npc_routes for lane in other.lanes}.values())
    tails, zones = _zones(roadmap, lanes, path, bounds)
    return Course(
        path=path,
        bounds=bounds,
        limit=_limits(curvature, float(roadmap.speed_limit)),
        curvature=curvature,
        left=np.array([left for left, _ in beside], dtype=np.int64)[index],
        right=np.array([right for _, right in beside], dtype=np.int64)[index],
        side_by_side=_ends(roadmap)[index] - stations,
        lanes=lane_array(lanes),
        tails=tails,
        zones=zones,
        own=np.array([lane in route.lanes for lane in lanes]),
        junction_start=float(route.bounds[inside[0]]) if inside else math.inf,
        junction_end=float(route.bounds[inside[-1] + 1]) if inside else -math.inf,
        destination=float(roadmap.destination),
        width=float(route.lanes[0].width),
        speed_limit=float(roadmap.speed_limit),
    )


@kernel
def project_on_course(path: Floats, bounds: Floats, x: float, y: float) -> tuple[float, float]:
    """Station and offset (positive to the right) of a point [m]; the outer lanes are continued."""
    last = len(path) - 1
    nearest, best_station, best_offset = math.inf, 0.0, 0.0
    for i in range(last + 1):
        station, offset = project_on_lane(path, i, x, y)
        outside = 0.0
        if i > 0:
            outside = max(outside, -station)
        if i < last:
            outside = max(outside, station - (bounds[i + 1] - bounds[i]))
        gap = math.hypot(offset, outside)
        if gap < nearest:
            nearest, best_station, best_offset = gap, bounds[i] + station, offset
    return best_station, best_offset


@kernel
def pose_on_course(path: Floats, bounds: Floats, station: float) -> tuple[float, float, float]:
    """Position and heading at a station; the outer lanes are continued."""
    i = 0
    while i < len(path) - 1 and station > bounds[i + 1]:
        i += 1
    return pose_on_lane(path, i, station - bounds[i])


def _beside(roadmap: RoadMap, lane: Lane) -> tuple[int, int]:
    """How many lanes lie to the left and to the right of a lane; none inside a junction."""
    if lane.junction:
        return 0, 0
    names = [other.name for other in roadmap.lanes if (other.origin, other.target) == (lane.origin, lane.target)]
    left = names.index(lane.name)
    return left, len(names) - 1 - left


def _ends(roadmap: RoadMap) -> Floats:
    """For each lane of the ego's route the station where the lanes beside it end [m]: at the next junction."""
    route = roadmap.ego_route
    ends = route.bounds[1:].copy()
    for i in range(len(ends) - 2, -1, -1):
        if not route.lanes[i].junction and not route.lanes[i + 1].junction:
            ends[i] = ends[i + 1]
    return ends


def _limits(curvature: Floats, speed_limit: float) -> Floats:
    limits = np.full(len(curvature), speed_limit)
    curved = curvature != 0
    limits[curved] = np.minimum(speed_limit, np.sqrt(LATERAL_ACCELERATION / np.abs(curvature[curved])))
    for i in range(len(limits) - 2, -1, -1):
        limits[i] = min(limits[i], math.sqrt(limits[i + 1] ** 2 + 2 * BRAKING * SPACING))
    return limits


def _zones(roadmap: RoadMap, lanes: tuple[Lane, ...], path: Floats, bounds: Floats) -> tuple[Ints, Floats]:
    """The ways on from each lane, and where they meet the ego's path."""
    index = {lane.name: i for i, lane in enumerate(lanes)}
    sequences = {tuple(index[lane.name] for lane in route.lanes) for route in roadmap.npc_routes}
    tails = sorted({sequence[i:] for sequence in sequences for i in range(len(sequence))})
    array = lane_array(lanes)
    zones = [_zone(array, np.array(tail), path, bounds) for tail in tails]
    firsts = [tail[0] for tail in tails]
    return np.searchsorted(firsts, range(len(lanes) + 1)).astype(np.int64), np.array(zones)


@kernel
def _zone(lanes: Floats, tail: Ints, path: Floats, bounds: Floats) -> tuple[float, float, float, float]:
    """Where a vehicle on a sequence of lanes enters and leaves the ego's path, and the stretch of it between."""
    length, width = CAR
    reach = EGO_SIZE[1] / 2 + SIDE_GAP
    enters, leaves, start, end = math.inf, math.inf, math.inf, -math.inf
    begin = 0.0
    for lane in tail:
        for step in range(math.ceil(lanes[lane, 3] / SPACING)):
            x, y, heading = pose_on_lane(lanes, lane, step * SPACING)
            station, offset = project_on_course(path, bounds, x, y)
            along = pose_on_course(path, bounds, station)[2]
            cos, sin = abs(math.cos(heading - along)), abs(math.sin(heading - along))
            if abs(offset) > reach + (sin * length + cos * width) / 2:
                continue
            enters, leaves = min(enters, begin + step * SPACING), begin + step * SPACING
            half = (cos * length + sin * width) / 2
            start, end = min(start, station - half), max(end, station + half)
        begin += lanes[lane, 3]
    return enters, leaves, start, end
