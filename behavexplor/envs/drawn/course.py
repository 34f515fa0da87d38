"""The ego's route in an environment of highway-env: the lanes that were planned, or those along which it drove."""

from collections.abc import Sequence
from typing import Final, TypeAlias

import numpy as np
from highway_env.road.lane import AbstractLane, StraightLane
from highway_env.road.road import RoadNetwork
from numpy.typing import NDArray

Floats = NDArray[np.float64]
LaneIndex: TypeAlias = tuple[str, str, int | None]

_STEP: Final = 2.0  # greatest distance of two points of a route where it is not straight [m]
_SAME: Final = 1e-6  # points nearer to each other are one [m]


def ego_route(
    network: RoadNetwork, planned: Sequence[LaneIndex], driven: Sequence[LaneIndex], positions: Floats
) -> Floats:
    """Return the center line of the ego's way, without its changes of lane.

    On each road, the route stays in the lane with the number of the first lane, as far as the road has it. A lane
    change therefore shows as an offset from the route, and a turn as a turn of the route.

    Args:
        network: the road network.
        planned: the lanes of the ego's route at the start; empty if the environment plans none. Then the route is made
            of the roads along which the ego drove, as far as they are connected.
        driven: the ego's lane in every frame.
        positions: the ego's positions, shape (T, 2) [m].

    Returns:
        Points, shape (P, 2), P >= 2 [m].
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


def _center(lane: AbstractLane, start: float, end: float) -> Floats:
    """Return points of a lane's center line between two stations [m], shape (n, 2)."""
    count = 2 if type(lane) is StraightLane else max(int(abs(end - start) / _STEP) + 2, 2)
    return np.array([lane.position(station, 0.0) for station in np.linspace(start, end, count)])
