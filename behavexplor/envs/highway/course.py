"""What the lanes of highway-env's roads tell: the ego's route, the road's plan for export, its shape for pictures."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Final, TypeAlias

import numpy as np
from highway_env.road.lane import AbstractLane, CircularLane, LineType, StraightLane
from highway_env.road.lane import SineLane as HighwaySineLane
from highway_env.road.road import RoadNetwork

from behavexplor.data.array_types import Floats
from behavexplor.data.road_plan import BROKEN, NO_LINE, SOLID, PlannedLane, RoadPlan, SineLane
from behavexplor.data.road_shape import RoadShape
from behavexplor.data.roadmap import Lane
from behavexplor.errors import InputError

LaneIndex: TypeAlias = tuple[str, str, int | None]

_STEP: Final = 2.0  # about the distance of points along a route or a lane's side where it is not straight [m]
_SAME: Final = 1e-6  # points nearer to each other are one [m]
_MARKINGS: Final = {
    LineType.NONE: NO_LINE,
    LineType.STRIPED: BROKEN,
    LineType.CONTINUOUS: SOLID,
    LineType.CONTINUOUS_LINE: SOLID,
}
_COMPARED: Final = 9  # points of a lane at which the plan is compared with the network
_TOLERANCE: Final = 1e-6  # [m]
_MOST_POINTS: Final = 400  # of one line for pictures, besides its end


def ego_route(
    network: RoadNetwork, planned: Sequence[LaneIndex], driven: Sequence[LaneIndex], positions: Floats
) -> Floats:
    """Return the center line of the ego's way, without its changes of lane, shape (P, 2), P >= 2 [m].

    On each road, the route stays in the lane with the number of the first lane, as far as the road has it. A lane
    change therefore shows as an offset from the route, and a turn as a turn of the route.

    `planned` has the lanes of the ego's route at the start. If it is empty, the roads are those along which the ego
    drove, as far as they are connected. `driven` is its lane in each of T frames, and `positions` has shape (T, 2) [m].
    """
    roads = [lane[:2] for lane in planned] if planned else _connected([lane[:2] for lane in driven])
    number = driven[0][2] or 0
    pieces = []
    for i, (origin, target) in enumerate(roads):
        beside = network.graph[origin][target]
        lane = beside[min(number, len(beside) - 1)]
        start = max(lane.local_coordinates(positions[0])[0], 0.0) if i == 0 else 0.0
        is_last = i == len(roads) - 1 and not planned
        pieces.append(_center(lane, start, lane.local_coordinates(positions[-1])[0] if is_last else lane.length))
    points: Floats = np.concatenate(pieces)
    points = points[np.concatenate([[True], np.hypot(*np.diff(points, axis=0).T) > _SAME])]
    if len(points) > 1:
        return np.asarray(points)
    way = positions[-1] - positions[0]
    return np.stack([positions[0], positions[0] + (way if np.hypot(*way) > _SAME else np.array([1.0, 0.0]))])


def _connected(roads: Sequence[tuple[str, str]]) -> list[tuple[str, str]]:
    """Return the roads that follow one another. In a junction, the nearest lane is often one that only crosses."""
    way = [roads[0]]
    for road in roads:
        if road[0] == way[-1][1]:
            way.append(road)
    return way


@lru_cache(maxsize=256)  # most routes consist of whole lanes
def _center(lane: AbstractLane, start: float, end: float) -> Floats:
    """Return points of a lane's center line between two stations [m], shape (n, 2)."""
    count = 2 if type(lane) is StraightLane else max(int(abs(end - start) / _STEP) + 2, 2)
    points = np.array([lane.position(station, 0.0) for station in np.linspace(start, end, count)])
    points.setflags(write=False)
    return points


def road_plan(network: RoadNetwork) -> RoadPlan:
    """Return the lanes of a network, road by road in highway-env's order.

    Raises:
        InputError: if a lane is neither straight nor circular nor a sine, or has a varying width.
    """
    return tuple(_planned(lane, index) for index, lane in network.lanes_dict().items())


def _planned(lane: AbstractLane, index: LaneIndex) -> PlannedLane:
    plain = _plain(lane, index)
    stations = np.linspace(0.0, lane.length, _COMPARED)
    points = [lane.position(station, 0.0) for station in stations] if plain is not None else []
    if plain is None or np.abs(np.array(points) - plain.pose(stations)[:, :2]).max() > _TOLERANCE:
        raise InputError(
            f"The lane {index} is a {type(lane).__name__}, and only straight, sine and circular lanes can be exported"
        )
    if any(abs(lane.width_at(station) - plain.width) > _TOLERANCE for station in stations):
        raise InputError(f"The lane {index} has a varying width, and only constant widths can be exported")
    left, right = (_MARKINGS[kind] for kind in _line_types(lane))
    return PlannedLane(plain, left, right, None if lane.speed_limit is None else float(lane.speed_limit))


def _plain(lane: AbstractLane, index: LaneIndex) -> Lane | None:
    """Return a lane of highway-env as plain data; None if its kind is not known."""
    origin, target, number = index
    ends = (f"{origin}>{target}/{number}", str(origin), str(target))
    length, width = float(lane.length), float(lane.width)
    if isinstance(lane, CircularLane):
        x, y = map(float, lane.position(0.0, 0.0))
        heading = float(lane.heading_at(0.0))
        return Lane(*ends, x, y, heading, length, width, curvature=float(lane.direction / lane.radius))
    if not isinstance(lane, StraightLane):
        return None
    x, y = map(float, lane.start)
    axis = (*ends, x, y, float(lane.heading), length, width)
    if isinstance(lane, HighwaySineLane):
        wave = (float(lane.amplitude), float(lane.pulsation), float(lane.phase))
        return SineLane(*axis, amplitude=wave[0], pulsation=wave[1], phase=wave[2])
    return Lane(*axis)


def road_shape(network: RoadNetwork) -> RoadShape:
    """Return the shape of a road of straight, sine, circular or other lanes."""
    surfaces, striped, borders = [], [], []
    for lane in network.lanes_list():
        left, right = _side(lane, -0.5), _side(lane, 0.5)
        surfaces.append(np.concatenate([left, right[::-1]]))
        for line, kind in zip((left, right), _line_types(lane), strict=True):
            if kind == LineType.STRIPED:
                striped.append(line)
            elif kind != LineType.NONE:
                borders.append(line)
    return RoadShape(tuple(surfaces), tuple(striped), tuple(borders))


def _line_types(lane: AbstractLane) -> Sequence[int]:
    """Return the kinds of the lines to the left and to the right of a lane, which a lane of points may lack."""
    return lane.line_types or (LineType.NONE, LineType.NONE)


def _side(lane: AbstractLane, share: float) -> Floats:
    """Return a line along a lane, at a share of its width to the right of the center, shape (n, 2)."""
    is_straight = type(lane) is StraightLane
    count = 2 if is_straight else int(min(max(lane.length / _STEP, 2), _MOST_POINTS)) + 1
    stations = np.linspace(0.0, lane.length, count)
    return np.array([lane.position(station, share * lane.width_at(station)) for station in stations])
