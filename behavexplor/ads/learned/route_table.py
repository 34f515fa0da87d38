"""Route table: facts about the ego's route and the lanes that meet it, computed before the drive."""

import math
from functools import cache
from typing import Final, NamedTuple

import numpy as np

from behavexplor.ads.road.lane_arrays import LENGTH, lane_array, pose_on_lane
from behavexplor.ads.road.path import SPACING, Path, ego_path, pose_on_path, project_on_path
from behavexplor.data.array_types import Bools, Floats, Ints
from behavexplor.data.conventions import EGO_SIZE
from behavexplor.data.roadmap import Lane, RoadMap
from behavexplor.jit import kernel_in_place

SIDE_GAP: Final = 0.3  # greatest gap between two vehicles side by side that are still in conflict [m]
CAR: Final = (4.6, 2.1)  # length and width of the vehicle whose conflicts are computed [m]

IN, OUT, START, END = 0, 1, 2, 3  # columns of `Course.zones`


class Course(NamedTuple):
    """The route table of one ego route. Its columns along the path have a row every `SPACING` meters."""

    path: Path  # path of the ego, see `behavexplor.ads.road.path`
    curvature: Floats  # curvature of the route [1/m], positive to the right, shape (S,)
    side_by_side: Floats  # distance to the end of the lanes beside the route's [m], shape (S,)
    lanes: Floats  # all lanes of NPC routes, shape (L, 7), see `behavexplor.ads.road.lane_arrays`
    tails: Ints  # row of `zones` at which the ways on from each lane begin, shape (L + 1,)
    # one row for each way on from a lane, shape (Z, 4) [m]: the distances from the start of the lane at which a vehicle
    # enters and leaves the ego's path, and the stations of that path between which it is then. Infinite if the vehicle
    # never enters the ego's path.
    zones: Floats
    own: Bools  # True for each lane of the ego's route, shape (L,)


@cache
def make_course(roadmap: RoadMap) -> Course:
    """Make the route table of a map."""
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
    """Return the station where the lanes beside each lane of the route end [m]: at a junction or the route's end."""
    route = roadmap.ego_route
    ends = route.bounds[1:].copy()
    for i in range(len(ends) - 2, -1, -1):
        if not route.lanes[i].junction and not route.lanes[i + 1].junction:
            ends[i] = ends[i + 1]
    return ends


def _zones(roadmap: RoadMap, lanes: tuple[Lane, ...], path: Path) -> tuple[Ints, Floats]:
    """Find the ways on from each lane, and where they meet the ego's path."""
    index = {lane.name: i for i, lane in enumerate(lanes)}
    sequences = {tuple(index[lane.name] for lane in route.lanes) for route in roadmap.npc_routes}
    tails = sorted({sequence[i:] for sequence in sequences for i in range(len(sequence))})
    array = lane_array(lanes)
    zones = [_zone(array, np.array(tail), path) for tail in tails]
    firsts = [tail[0] for tail in tails]
    return np.searchsorted(firsts, range(len(lanes) + 1)).astype(np.int64), np.array(zones)


@kernel_in_place
def _zone(lanes: Floats, tail: Ints, path: Path) -> tuple[float, float, float, float]:
    """Return where a vehicle on a sequence of lanes enters and leaves the ego's path, and the stretch of it between."""
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
