"""The ego's course as tables: what can be known of it before anyone drives."""

import math
from functools import cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from behavexplor.ads.road.lane_arrays import LENGTH, lane_array, pose_on_lane
from behavexplor.ads.road.path import SPACING, Path, ego_path, pose_on_path, project_on_path
from behavexplor.data.logical import EGO_SIZE
from behavexplor.data.roadmap import Lane, RoadMap
from behavexplor.jit import kernel_in_place

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SIDE_GAP: Final = 0.3  # between two vehicles side by side that are in conflict nevertheless [m]
CAR: Final = (4.6, 2.1)  # length and width of a vehicle whose conflicts are worked out beforehand [m]

IN, OUT, START, END = 0, 1, 2, 3  # columns of `Course.zones`


class Course(NamedTuple):
    """What is known of a map for one ego route, beside its path; tables have a row every `SPACING` meters.

    Attributes:
        path: the ego's route, see `behavexplor.ads.road.path`.
        curvature: [1/m], positive to the right, shape (S,).
        side_by_side: distance to where the lanes beside end [m], shape (S,).
        lanes: all lanes on which others drive, shape (L, 7), see `behavexplor.ads.road.lane_arrays`.
        tails: for each lane where its ways on begin in `zones`, shape (L + 1,).
        zones: for each way on, measured from the start of its first lane, where a vehicle enters the ego's path and
            where it leaves it, and the stretch of the ego's path between, shape (Z, 4) [m]; infinite if it never does.
        own: whether a lane is one of the ego's route, shape (L,).
    """

    path: Path
    curvature: Floats
    side_by_side: Floats
    lanes: Floats
    tails: Ints
    zones: Floats
    own: NDArray[np.bool_]


@cache
def make_course(roadmap: RoadMap) -> Course:
    """What is known of a map."""
    route, path = roadmap.ego_route, ego_path(roadmap)
    stations = SPACING * np.arange(len(path.limits))
    index = np.searchsorted(route.bounds[1:-1], stations, side="right")
    lanes = tuple({lane.name: lane for other in roadmap.npc_routes for lane in other.lanes}.values())
    tails, zones = _zones(roadmap, lanes, path)
    return Course(
        path=path,
        curvature=np.array([lane.curvature for lane in route.lanes])[index],
        side_by_side=_ends(roadmap)[index] - stations,
        lanes=lane_array(lanes),
        tails=tails,
        zones=zones,
        own=np.array([lane in route.lanes for lane in lanes]),
    )


def _ends(roadmap: RoadMap) -> Floats:
    """For each lane of the ego's route the station where the lanes beside it end [m]: at the next junction."""
    route = roadmap.ego_route
    ends = route.bounds[1:].copy()
    for i in range(len(ends) - 2, -1, -1):
        if not route.lanes[i].junction and not route.lanes[i + 1].junction:
            ends[i] = ends[i + 1]
    return ends


def _zones(roadmap: RoadMap, lanes: tuple[Lane, ...], path: Path) -> tuple[Ints, Floats]:
    """The ways on from each lane, and where they meet the ego's path."""
    index = {lane.name: i for i, lane in enumerate(lanes)}
    sequences = {tuple(index[lane.name] for lane in route.lanes) for route in roadmap.npc_routes}
    tails = sorted({sequence[i:] for sequence in sequences for i in range(len(sequence))})
    array = lane_array(lanes)
    zones = [_zone(array, np.array(tail), path) for tail in tails]
    firsts = [tail[0] for tail in tails]
    return np.searchsorted(firsts, range(len(lanes) + 1)).astype(np.int64), np.array(zones)


@kernel_in_place
def _zone(lanes: Floats, tail: Ints, path: Path) -> tuple[float, float, float, float]:
    """Where a vehicle on a sequence of lanes enters and leaves the ego's path, and the stretch of it between."""
    length, width = CAR
    reach = EGO_SIZE[1] / 2 + SIDE_GAP
    enters, leaves, start, end = math.inf, math.inf, math.inf, -math.inf
    begin = 0.0
    for lane in tail:
        for step in range(math.ceil(lanes[lane, LENGTH] / SPACING)):
            x, y, heading = pose_on_lane(lanes, lane, step * SPACING)
            station, offset = project_on_path(path, x, y)
            along = pose_on_path(path, station)[2]
            cos, sin = abs(math.cos(heading - along)), abs(math.sin(heading - along))
            if abs(offset) > reach + (sin * length + cos * width) / 2:
                continue
            enters, leaves = min(enters, begin + step * SPACING), begin + step * SPACING
            half = (cos * length + sin * width) / 2
            start, end = min(start, station - half), max(end, station + half)
        begin += lanes[lane, LENGTH]
    return enters, leaves, start, end
