"""The logical scenarios S1 to S4 and their maps. They can be used without importing the simulator.

The four situations are those of the paper's section 4, on its two places: an intersection of two roads, and a straight
road with four lanes. The dimensions follow the maps that the paper tested on: lanes of 3.5 m, a speed limit of 25 mph,
stop lines about 15 m from the center of the intersection, double yellow lines between the directions, and curbs along
the edges.
"""

import math
from collections.abc import Iterator, Mapping
from itertools import pairwise
from types import MappingProxyType
from typing import Final

import numpy as np

from behavexplor.data.array_types import Floats
from behavexplor.data.conventions import wrapped
from behavexplor.data.roadmap import CURB, DOUBLE_YELLOW, Lane, RoadMap, Route
from behavexplor.data.scripted_logical import ScriptedLogicalScenario

LANE_WIDTH = 3.5  # [m]
SPEED_LIMIT = 11.176  # 25 mph [m/s]

STOP_LINE = 15.0  # distance of the stop lines from the center of the intersection [m]
EGO_APPROACH = 90.0  # length of the approach lanes on the ego's leg [m]
APPROACH = 120.0  # length of the approach lanes on the other legs [m]
EXIT = 75.0  # length of the lanes that leave the intersection; the ego's destination lies 60 m into one [m]
ONWARD = 80.0  # length of the lanes after those, where NPCs park out of the ego's way [m]
EGO_LEG = "south"

ROAD = 244.0  # length of the straight road's lanes [m]
ROAD_ONWARD = 100.0  # length of the lanes after those, where NPCs park out of the ego's way [m]
ROAD_LANES = 4
OPPOSITE_LANES = 2  # lanes of the opposite direction beyond the double yellow line; the ego can stray onto them

# outward heading of each leg [rad]; x points to the east and y to the south
LEGS = {"south": math.pi / 2, "west": math.pi, "north": -math.pi / 2, "east": 0.0}
OFFSETS = {"inner": 0.5 * LANE_WIDTH, "outer": 1.5 * LANE_WIDTH}  # lane center from the middle of the road [m]
# what a vehicle on each approach lane may do
MOVEMENTS = {"inner": ("left", "straight"), "outer": ("straight", "right")}
TURNS = {"left": -math.pi / 2, "straight": 0.0, "right": math.pi / 2}  # change of heading [rad]


def crossing(movement: str, ego_start: float, destination: float) -> RoadMap:
    """Build an unsignalized intersection of two four-lane roads; the ego comes from the south, on the inner lane.

    `movement` is the ego's, "straight" or "left". `ego_start` is the distance into its approach lane [m], and
    `destination` the distance into its exit lane [m].
    """
    lanes = {lane.name: lane for lane in _crossing_lanes()}
    routes = [
        Route(f"{leg}-{side}-{turn}", tuple(lanes[name] for name in _lane_names(leg, side, turn)))
        for leg in LEGS
        for side in OFFSETS
        for turn in MOVEMENTS[side]
    ]
    ego_route = next(route for route in routes if route.name == f"{EGO_LEG}-inner-{movement}")
    lines, kinds = _crossing_lines()
    return RoadMap(
        lanes=tuple(lanes.values()),
        npc_routes=tuple(routes),
        ego_route=ego_route,
        ego_start=ego_start,
        destination=float(ego_route.bounds[2]) + destination,
        illegal_lines=lines,
        line_kinds=kinds,
        speed_limit=SPEED_LIMIT,
    )


def straight_road(start_lane: int, target_lane: int, ego_start: float, destination: float) -> RoadMap:
    """Build a straight road with four lanes in one direction, beside the lanes of the opposite direction.

    `start_lane` and `target_lane` are the ego's, counted from the left and from 0. `ego_start` and `destination` are
    the distances of its start and its destination from the beginning of the road [m].
    """
    lanes = {lane.name: lane for lane in _road_lanes()}
    routes = [Route(f"lane-{i + 1}", (lanes[f"road-{i + 1}"], lanes[f"onward-{i + 1}"])) for i in range(ROAD_LANES)]
    length = ROAD + ROAD_ONWARD
    edges = {DOUBLE_YELLOW: [0.0], CURB: [ROAD_LANES * LANE_WIDTH, -OPPOSITE_LANES * LANE_WIDTH]}
    lines = [(kind, [(0.0, y), (length, y)]) for kind, offsets in edges.items() for y in offsets]
    return RoadMap(
        lanes=tuple(lanes.values()),
        npc_routes=tuple(routes),
        ego_route=routes[target_lane],  # the ego starts in it, or beside it
        ego_start=ego_start,
        destination=destination,
        illegal_lines=np.array([ends for _, ends in lines]),
        line_kinds=tuple(kind for kind, _ in lines),
        speed_limit=SPEED_LIMIT,
        ego_offset=(start_lane - target_lane) * LANE_WIDTH,
    )


def _road_lanes() -> Iterator[Lane]:
    """Yield the eastbound lanes along the x axis, then the westbound lanes."""
    for name, start, length, origin, target in (
        ("road", 0.0, ROAD, "begin", "onward"),
        ("onward", ROAD, ROAD_ONWARD, "onward", "end"),
    ):
        for i in range(ROAD_LANES):
            yield Lane(f"{name}-{i + 1}", origin, target, start, (i + 0.5) * LANE_WIDTH, 0.0, length, LANE_WIDTH)
    length = ROAD + ROAD_ONWARD
    for i in range(OPPOSITE_LANES):
        y = -(i + 0.5) * LANE_WIDTH
        yield Lane(f"opposite-{i + 1}", "end-opposite", "begin-opposite", length, y, math.pi, length, LANE_WIDTH)


def _lane_names(leg: str, side: str, movement: str) -> tuple[str, str, str, str]:
    """Return the names of a route's lanes: approach, connector, exit and the one after it."""
    target = _leg_towards(LEGS[leg] + math.pi + TURNS[movement])
    return f"{leg}-in-{side}", f"{leg}-{side}-{movement}", f"{target}-out-{side}", f"{target}-onward-{side}"


def _leg_towards(heading: float) -> str:
    """Return the leg with the given outward heading."""
    return min(LEGS, key=lambda leg: abs(wrapped(LEGS[leg] - heading)))


def _crossing_lanes() -> Iterator[Lane]:
    """Yield the lanes leg by leg. Parallel lanes are ordered from left to right."""
    end = STOP_LINE + EXIT + ONWARD
    for leg, outward in LEGS.items():
        approach = EGO_APPROACH if leg == EGO_LEG else APPROACH
        begin = STOP_LINE + approach
        inward = wrapped(outward + math.pi)
        for name, start, length, nodes, heading in (
            ("behind", end, end - begin, ("begin", "far"), inward),  # the road begins here, although no route does
            ("in", begin, approach, ("far", "in"), inward),
            ("out", STOP_LINE, EXIT, ("out", "onward"), outward),
            ("onward", STOP_LINE + EXIT, ONWARD, ("onward", "end"), outward),
        ):
            for side, offset in OFFSETS.items():
                x, y = _beside(outward, start, offset if heading == outward else -offset)
                origin, target = (f"{leg}-{node}" for node in nodes)
                yield Lane(f"{leg}-{name}-{side}", origin, target, x, y, heading, length, LANE_WIDTH)
        for side, offset in OFFSETS.items():
            for movement in MOVEMENTS[side]:
                yield _connector(leg, side, offset, movement)


def _connector(leg: str, side: str, offset: float, movement: str) -> Lane:
    """Return the lane across the intersection from the approach lane at an `offset` from the middle of its road [m]."""
    heading = LEGS[leg] + math.pi
    x, y = _beside(LEGS[leg], STOP_LINE, -offset)
    target = _leg_towards(heading + TURNS[movement])
    if movement == "straight":
        length, curvature = 2 * STOP_LINE, 0.0
    else:
        radius = STOP_LINE + (offset if movement == "left" else -offset)
        length, curvature = radius * math.pi / 2, math.copysign(1 / radius, TURNS[movement])
    return Lane(
        name=f"{leg}-{side}-{movement}",
        origin=f"{leg}-in",
        target=f"{target}-out",
        x=x,
        y=y,
        heading=wrapped(heading),
        length=length,
        width=LANE_WIDTH,
        curvature=curvature,
        junction=True,
    )


def _crossing_lines() -> tuple[Floats, tuple[str, ...]]:
    """Return the illegal lines, shape (segments, 2, 2) [m], and their kinds.

    They are each leg's double yellow line and curbs, then the curbs around the corners as chords.
    """
    near, far = STOP_LINE, STOP_LINE + EXIT + ONWARD
    edge = 2 * LANE_WIDTH
    segments, kinds = [], []
    for outward in LEGS.values():
        for offset, kind in ((0.0, DOUBLE_YELLOW), (-edge, CURB), (edge, CURB)):
            segments.append([_beside(outward, near, offset), _beside(outward, far, offset)])
            kinds.append(kind)
    for outward in LEGS.values():
        angles = np.linspace(0, math.pi / 2, 7)
        alongs, acrosses = near - (near - edge) * np.sin(angles), near - (near - edge) * np.cos(angles)
        corner = [_beside(outward, float(along), float(across)) for along, across in zip(alongs, acrosses, strict=True)]
        segments += [[start, end] for start, end in pairwise(corner)]
        kinds += [CURB] * (len(corner) - 1)
    return np.array(segments), tuple(kinds)


def _beside(heading: float, along: float, across: float) -> tuple[float, float]:
    """Return the point `along` meters from the origin in a direction and `across` meters to the right of it."""
    cos, sin = round(math.cos(heading)), round(math.sin(heading))  # legs run along the axes
    return along * cos - across * sin, along * sin + across * cos


INTERSECTION_STRAIGHT: Final = ScriptedLogicalScenario(
    name="intersection-straight",
    roadmap=crossing("straight", ego_start=20.0, destination=60.0),
    n_npcs=5,
    waypoints_per_lane=2,
)
INTERSECTION_LEFT: Final = ScriptedLogicalScenario(
    name="intersection-left",
    roadmap=crossing("left", ego_start=10.0, destination=60.0),  # across the oncoming lane
    n_npcs=5,
    waypoints_per_lane=2,
)
LANE_FOLLOW: Final = ScriptedLogicalScenario(
    name="lane-follow",
    roadmap=straight_road(start_lane=2, target_lane=2, ego_start=10.0, destination=230.0),
    n_npcs=6,
    waypoints_per_lane=4,
)
LANE_CHANGE: Final = ScriptedLogicalScenario(
    name="lane-change",
    roadmap=straight_road(start_lane=1, target_lane=3, ego_start=10.0, destination=230.0),
    n_npcs=6,
    waypoints_per_lane=4,
)

LOGICAL_SCENARIOS: Final[Mapping[str, ScriptedLogicalScenario]] = MappingProxyType(
    {logical.name: logical for logical in (INTERSECTION_STRAIGHT, INTERSECTION_LEFT, LANE_FOLLOW, LANE_CHANGE)}
)
