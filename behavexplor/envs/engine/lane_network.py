"""A highway-env road network as tables: every lane, every road, and how they are connected.

A road is the list of lanes from one node to another. Lanes and roads are numbered in highway-env's own order, the order
of `RoadNetwork.graph`. Ties between lanes are decided by that order.
"""

import math
from collections.abc import Callable, Collection, Iterator
from functools import lru_cache
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from highway_env.road.lane import AbstractLane, CircularLane, SineLane, StraightLane
from highway_env.road.road import LaneIndex, RoadNetwork

from behavexplor.data.array_types import Floats, Ints
from behavexplor.envs.engine.state import Records, record_type
from behavexplor.envs.source_gate import replaced
from behavexplor.errors import InputError

Lane: TypeAlias = np.record

STRAIGHT, SINE, CIRCULAR = range(3)  # `kind` of a lane

LANE: Final = record_type(
    kind=np.int64,
    x=np.float64,  # start, or center of the circle [m]
    y=np.float64,
    cos=np.float64,  # direction of a straight lane or of a sine's axis, or of an arc's middle as seen from its center
    sin=np.float64,
    heading=np.float64,  # of a straight lane or of a sine's axis [rad]
    length=np.float64,  # [m]
    width=np.float64,  # [m]
    amplitude=np.float64,  # of a sine [m]
    pulsation=np.float64,  # of a sine [rad/m]
    phase=np.float64,  # of a sine, or start phase of a circle [rad]
    radius=np.float64,  # [m]
    cos_half_arc=np.float64,  # cosine of half an arc's angle; -1: a full circle
    turn=np.float64,  # 1 if a circle runs clockwise on the screen, else -1
    speed_limit=np.float64,  # [m/s]; NaN: none
    priority=np.int64,
    is_forbidden=np.bool_,  # to vehicles on the lanes beside it
    is_goal=np.bool_,  # see `make_network`
    road=np.int64,
    number=np.int64,  # on its road
    first_link=np.int64,  # the lane's rows in `Network.links`
    n_links=np.int64,
    near=np.int64,  # bit i is set if lane i may be as close as this one, see `NEAR_LIMIT`; or ALL_NEAR
)

ROAD: Final = record_type(
    first_lane=np.int64,
    n_lanes=np.int64,
    origin=np.int64,  # number of the node
    target=np.int64,
    first_exit=np.int64,  # the road's rows in `Network.exits`
    n_exits=np.int64,
)

LINK: Final = record_type(
    lane=np.int64,
    offset=np.float64,  # the station along the lane whose link it is, less that on the linked lane [m]
)

# If a point is at most this far from a lane [m], it is farther from each lane not `near` this one, at any heading.
NEAR_LIMIT: Final = 2.0
ALL_NEAR: Final = -1  # every bit is set
MOST_BITS: Final = 62  # greatest number of lanes that have a bit each; with more, all count as near
_SAMPLES: Final = 64  # points of a lane's center line
_ROUNDING: Final = 1e-3  # more than the rounding errors of a distance between center lines [m]

_CLASSES: Final = {STRAIGHT: StraightLane, SINE: SineLane, CIRCULAR: CircularLane}
# what a subclass may replace, because the geometry is read from the attributes of its lanes
_CHANGEABLE: Final = frozenset({"__init__", "from_config", "to_config"})


class Network(NamedTuple):
    """A road network as tables."""

    lanes: Records  # all lanes, shape (lanes,) of `LANE`
    roads: Records  # all roads, shape (roads,) of `ROAD`
    exits: Ints  # for each road in turn, the numbers of the roads that begin where it ends, shape (exits,)
    # for each lane in turn, the lane itself, then the others on which `Road.neighbour_vehicles` looks for vehicles,
    # shape (links,) of `LINK`
    links: Records


def lane_indexes(network: RoadNetwork) -> list[LaneIndex]:
    """Return highway-env's index of every lane, in the order of the tables."""
    return list(network.lanes_dict())


def road_numbers(network: RoadNetwork) -> dict[tuple[str, str], int]:
    """Return the number of the road between two nodes."""
    return {ends: road for road, (ends, _) in enumerate(_roads(network))}


def make_network(
    network: RoadNetwork,
    *,
    connected_lanes: bool = False,
    is_goal: Callable[[LaneIndex], bool] = lambda _: False,
    same_geometry: Collection[type[AbstractLane]] = (),
) -> Network:
    """Convert a road network of highway-env to tables.

    `connected_lanes` is highway-env's option `neighbour_vehicles_connected_lanes`: neighbors are looked for on
    preceding and following lanes, too. `is_goal` says which lanes are marked; what the mark means is up to the
    environment. Lanes of the classes `same_geometry` are accepted although they replace methods, because their
    geometry is the same.

    Raises:
        InputError: if a lane is neither straight nor a sine nor an arc, or its class replaces methods of these.
    """
    roads = list(_roads(network))
    numbers = road_numbers(network)
    nodes: dict[str, int] = {}
    lanes = np.zeros(sum(len(group) for _, group in roads), LANE).view(np.recarray)
    table = np.zeros(len(roads), ROAD).view(np.recarray)
    exits: list[int] = []
    first = 0  # number of the road's first lane
    for road, ((origin, target), group) in enumerate(roads):
        ends = [nodes.setdefault(node, len(nodes)) for node in (origin, target)]
        following = [numbers[target, node] for node in network.graph.get(target, {})]
        table[road] = (first, len(group), *ends, len(exits), len(following))
        exits += following
        for number, lane in enumerate(group):
            row = lanes[first + number]
            row.kind = _kind(lane, (origin, target, number), same_geometry)
            _describe(row, lane)
            row.road, row.number, row.is_goal = road, number, is_goal((origin, target, number))
        first += len(group)
    links = _link(network, lanes, connected_lanes=connected_lanes)
    lanes["near"] = _near_lanes(lanes)
    return Network(
        lanes=lanes.view(np.ndarray), roads=table.view(np.ndarray), exits=np.array(exits, np.int64), links=links
    )


def _roads(network: RoadNetwork) -> Iterator[tuple[tuple[str, str], list[AbstractLane]]]:
    for origin, to in network.graph.items():
        for target, lanes in to.items():
            yield (origin, target), lanes


def _describe(row: Lane, lane: AbstractLane) -> None:
    """Fill in the geometry and the rules of a lane whose row already has its kind."""
    if row.kind == CIRCULAR:
        (row.x, row.y), row.radius, row.turn = lane.center, lane.radius, lane.direction
        half = lane.length / lane.radius / 2
        middle = lane.start_phase + lane.direction * half
        row.phase, row.cos_half_arc = lane.start_phase, math.cos(min(abs(half), math.pi))
        row.cos, row.sin = math.cos(middle), math.sin(middle)
    else:
        (row.x, row.y), (row.cos, row.sin), row.heading = lane.start, lane.direction, lane.heading
    if row.kind == SINE:
        row.amplitude, row.pulsation, row.phase = lane.amplitude, lane.pulsation, lane.phase
    row.length, row.width, row.priority, row.is_forbidden = lane.length, lane.width, lane.priority, lane.forbidden
    row.speed_limit = math.nan if lane.speed_limit is None else lane.speed_limit


def _kind(lane: AbstractLane, index: LaneIndex, same_geometry: Collection[type[AbstractLane]]) -> int:
    """Return the kind of a lane. A subclass is of its parent's kind if it changes none of the geometry."""
    for kind, known in _CLASSES.items():
        if not isinstance(lane, known):
            continue
        if type(lane) in same_geometry or replaced(type(lane), known, _CHANGEABLE) is None:
            return kind
    raise InputError(
        f"The lane {index} is a {type(lane).__name__}, which the compiled engine does not know; use straight, sine "
        f"or circular lanes, or gymnasium.make_vec with vectorization_mode='sync'"
    )


def _link(network: RoadNetwork, lanes: Records, *, connected_lanes: bool) -> Records:
    """Fill in the lanes' `first_link` and `n_links`, and return all links, see `Network.links`."""
    indexes = {index: row for row, index in enumerate(lane_indexes(network))}
    links: list[tuple[int, float]] = []
    for (origin, target, number), row in indexes.items():
        own = [(row, 0.0)]
        if connected_lanes:
            for node, group in network.graph.get(target, {}).items():
                own.append((indexes[target, node, _same_or_first(number, group)], lanes[row].length))
            for node, to in network.graph.items():
                if origin in to:
                    before = indexes[node, origin, _same_or_first(number, to[origin])]
                    own.append((before, -lanes[before].length))
        lanes[row].first_link, lanes[row].n_links = len(links), len(own)
        links += own
    return np.array(links, dtype=LINK)


def _near_lanes(lanes: Records) -> list[int]:
    """Return the bits `near` of each lane.

    A point's distance from a lane, in highway-env's measure, is at least that from its center line. So if a point is r
    from one lane, and the center lines are d apart, it is at least d - r from the other. If d is more than 2 r + pi,
    that is more than r + pi: the distance from the first lane plus the greatest difference of headings.
    """
    if len(lanes) > MOST_BITS:
        return [ALL_NEAR] * len(lanes)
    return [sum(1 << i for i in found) for found in _lanes_within(lanes.tobytes(), 2 * NEAR_LIMIT + math.pi)]


@lru_cache(maxsize=16)  # it takes milliseconds, and environments that make their own roads make them in every episode
def _lanes_within(lanes: bytes, reach: float) -> list[list[int]]:
    """Return for each lane the numbers of the others whose center lines may come within `reach` of its own [m].

    `lanes` has the bytes of the table, because arguments of a cached function are hashed.
    """
    rows = np.frombuffer(lanes, LANE)
    lines = np.array([_center_line(row) for row in rows])
    # A point of a line is at most half the greatest step away from a sample. The factor leaves room for curves, which
    # are longer than the straight step between two samples.
    slack = 1.1 * np.linalg.norm(np.diff(lines, axis=1), axis=2).max(axis=1, initial=0.0) / 2
    found = []
    for i, line in enumerate(lines):
        points, others = line - lines[i, 0], lines - lines[i, 0]  # from its start, so that less is rounded
        # squared distances of all samples, shape (lanes, samples of the other, samples of this one)
        square = (points**2).sum(1) + (others**2).sum(2)[:, :, None] - 2 * others @ points.T
        apart = np.sqrt(square.min(axis=(1, 2)).clip(0.0)) - slack - slack[i]
        found.append([j for j in np.flatnonzero(apart <= reach + _ROUNDING).tolist() if j != i])
    return found


def _center_line(lane: Lane) -> Floats:
    """Return points of a lane's center line from its start to its end, shape (`_SAMPLES`, 2) [m]."""
    station = np.linspace(0.0, lane.length, _SAMPLES)
    if lane.kind == CIRCULAR:
        angle = lane.turn * station / lane.radius + lane.phase
        return np.stack([lane.x + lane.radius * np.cos(angle), lane.y + lane.radius * np.sin(angle)], axis=1)
    offset = lane.amplitude * np.sin(lane.pulsation * station + lane.phase)
    return np.stack(
        [lane.x + station * lane.cos - offset * lane.sin, lane.y + station * lane.sin + offset * lane.cos], axis=1
    )


def _same_or_first(number: int, lanes: list[AbstractLane]) -> int:
    """Return a lane's number if another road has a lane with it, or else 0, as highway-env does."""
    return number if number < len(lanes) else 0
