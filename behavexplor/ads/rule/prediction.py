"""Prediction: the ways that an NPC may go, and its possible positions along them at a later time."""

import math
from typing import Final, NamedTuple

import numpy as np

from behavexplor.ads.road.lane_arrays import (
    COS,
    CURVATURE,
    HEADING,
    LENGTH,
    N_COLUMNS,
    SIN,
    X,
    Y,
    lane_array,
    offset_on_lane,
    project_on_lane,
)
from behavexplor.ads.road.path import Path
from behavexplor.ads.rule.beside import beside_route
from behavexplor.ads.rule.parameters import Numbers
from behavexplor.data.array_types import Floats, Ints
from behavexplor.data.roadmap import RoadMap
from behavexplor.jit import kernel_in_place, kernel_inner

TWO_PI = 2 * math.pi
SAGITTA: Final = 0.5  # more than the distance between an arc and a chord of 1 m [m]
NEAR: Final = 7.0  # half the longest vehicle's diagonal plus half the ego's width, with some margin [m]


class LaneGraph(NamedTuple):
    """All ways on for vehicles on the map.

    The last lane and the last tail are spare: they lead straight on, for a vehicle that is on no lane.
    """

    lanes: Floats  # lanes of the map, shape (lanes + 1, 7), see `behavexplor.ads.road.lane_arrays`
    tails: Ints  # distinct sequences of lanes that routes end with, shape (tails + 1, depth), -1 after the last lane
    around: Floats  # least x and y and greatest x and y of each lane's center line [m], shape (lanes + 1, 4)
    beside: Floats  # where each meter of each lane is on the ego's route, see `behavexplor.ads.rule.beside`


def lane_graph(roadmap: RoadMap, path: Path) -> LaneGraph:
    """Make the lane graph of all routes, the ego's included: their lanes, and every distinct rest of a route."""
    routes, ego_route = (*roadmap.npc_routes, roadmap.ego_route), roadmap.ego_route
    lanes = tuple({lane.name: lane for route in routes for lane in route.lanes}.values())
    index = {lane.name: i for i, lane in enumerate(lanes)}
    sequences = [tuple(index[lane.name] for lane in route.lanes) for route in routes]
    tails = [*sorted({sequence[i:] for sequence in sequences for i in range(len(sequence))}), (len(lanes),)]
    depth = max(map(len, tails))
    padded = [tail + (-1,) * (depth - len(tail)) for tail in tails]
    way = ego_route.polyline(0.0, ego_route.length)
    near = NEAR + ego_route.lanes[0].width  # the ego may overtake in the next lane; straight roads have no more lanes
    lines = [lane.pose(np.linspace(0.0, lane.length, math.ceil(lane.length) + 1))[:, :2] for lane in lanes]
    rows = np.vstack([lane_array(lanes), np.zeros(N_COLUMNS)])
    return LaneGraph(
        lanes=rows,
        tails=np.array(padded, dtype=np.int64),
        around=np.array([[*line.min(axis=0), *line.max(axis=0)] for line in lines] + [[0.0] * 4]),
        beside=beside_route(path, rows, np.array([*(_distance(line, way) <= near for line in lines), True])),
    )


def _distance(line: Floats, way: Floats) -> float:
    """Return the least distance between the points of two lines [m]."""
    gaps = line[:, None] - way
    return float(np.hypot(gaps[..., 0], gaps[..., 1]).min())


@kernel_inner
def find_tails(
    graph: LaneGraph, x: float, y: float, heading: float, speed: float, p: Numbers, tails: Ints, stations: Floats
) -> tuple[int, int]:
    """Find every way on of a vehicle: all branches at a junction, straight on for a vehicle that is on no lane.

    The spare lane of the graph is overwritten. `tails` and the vehicle's `stations` along them [m] are filled, shape
    (most,).

    Returns:
        The number of ways found, at least 1, and the number of overlooked ones among them (weakness R1-8). The
        overlooked ways come last.
    """
    lanes, spare = graph.lanes, len(graph.tails) - 1
    count, overlooked = 0, 0
    lane, station, fits = -1, 0.0, False
    for tail in range(spare):
        if graph.tails[tail, 0] != lane:
            lane = graph.tails[tail, 0]
            fits, station = _fits(graph, lane, x, y, heading, p)
        if not fits or count + overlooked == len(tails):
            continue
        if p.branch_turn > 0.0 and speed > p.branch_speed and _overlooked(graph, tail, heading, p):
            overlooked += 1
            tails[-overlooked], stations[-overlooked] = tail, station
            continue
        tails[count], stations[count] = tail, station
        count += 1
    for i in range(overlooked):
        tails[count + i], stations[count + i] = tails[i - overlooked], stations[i - overlooked]
    if count == 0:
        lanes[-1, X], lanes[-1, Y], lanes[-1, HEADING] = x, y, heading
        lanes[-1, COS], lanes[-1, SIN] = math.cos(heading), math.sin(heading)
        tails[0], stations[0], count, overlooked = spare, 0.0, 1, 0
    return count + overlooked, overlooked


@kernel_inner
def _fits(graph: LaneGraph, lane: int, x: float, y: float, heading: float, p: Numbers) -> tuple[bool, float]:
    """Return whether a vehicle may be driving on a lane, and its station there [m], 0 if it is far from the lane."""
    lanes, around, margin = graph.lanes, graph.around, p.match_offset + SAGITTA
    if x < around[lane, 0] - margin or x > around[lane, 2] + margin:
        return False, 0.0
    if y < around[lane, 1] - margin or y > around[lane, 3] + margin:
        return False, 0.0
    if abs(offset_on_lane(lanes, lane, x, y)) > p.match_offset:
        return False, 0.0
    station, _ = project_on_lane(lanes, lane, x, y)
    if not 0.0 <= station <= lanes[lane, LENGTH]:
        return False, station
    along = lanes[lane, HEADING] + lanes[lane, CURVATURE] * station
    return abs((heading - along + math.pi) % TWO_PI - math.pi) <= p.match_heading, station


@kernel_inner
def _overlooked(graph: LaneGraph, tail: int, heading: float, p: Numbers) -> bool:
    """Return whether a way on turns off, but the vehicle has not clearly turned yet (weakness R1-8)."""
    lanes, lane, following = graph.lanes, graph.tails[tail, 0], graph.tails[tail, 1]
    if lanes[lane, CURVATURE] == 0.0:
        return bool(following >= 0 and lanes[following, CURVATURE] != 0.0)
    turned = abs((heading - lanes[lane, HEADING] + math.pi) % TWO_PI - math.pi)
    return bool(turned < p.branch_turn)


@kernel_inner
def traveled(speed: float, acceleration: float, duration: float, limit: float, time: float) -> float:
    """Return the distance [m] driven in a time, if an acceleration goes on for a duration.

    The speed stays between standstill and the limit.
    """
    if acceleration > 0.0:
        duration = min(duration, max(limit - speed, 0.0) / acceleration)
    elif acceleration < 0.0:
        duration = min(duration, speed / -acceleration)
    first = min(time, duration)
    after = speed + acceleration * duration
    return speed * first + 0.5 * acceleration * first * first + after * (time - first)


@kernel_in_place
def reach(
    speed: float, acceleration: float, duration: float, limit: float, since: float, until: float
) -> tuple[float, float]:
    """Return the least and greatest distance driven [m] between two times.

    The two distances cover an NPC that keeps its speed and an NPC that keeps its acceleration for the duration.
    """
    near = min(speed * since, traveled(speed, acceleration, duration, limit, since))
    far = max(speed * until, traveled(speed, acceleration, duration, limit, until))
    return near, far
