"""The ego's route in an environment of highway-env: the lanes along which it drove."""

from collections.abc import Sequence
from typing import Final, TypeAlias

import numpy as np
from highway_env.road.lane import AbstractLane
from highway_env.road.road import RoadNetwork
from numpy.typing import NDArray

Floats = NDArray[np.float64]
LaneIndex: TypeAlias = tuple[str, str, int]

_STEP: Final = 2.0  # greatest distance of two points of a route [m]


def driven_route(network: RoadNetwork, lanes: Sequence[LaneIndex], first: Floats, last: Floats) -> Floats:
    """Return the center line of the lanes along which the ego drove, without its changes of lane.

    On each road, the route stays in the lane with the number of the first lane, as far as the road has it. A lane
    change therefore shows as an offset from the route, and a turn as a turn of the route.

    Args:
        network: the road network.
        lanes: the ego's lane in every frame.
        first: the ego's first position, shape (2,) [m].
        last: the ego's last position, shape (2,) [m].

    Returns:
        Points, shape (P, 2), P >= 2 [m]. A network without a lane for the ego gives the straight line from its first to
        its last position.
    """
    roads = [road for i, road in enumerate(lane[:2] for lane in lanes) if i == 0 or road != lanes[i - 1][:2]]
    number = lanes[0][2]
    pieces = []
    for i, (origin, target) in enumerate(roads):
        beside = network.graph[origin][target]
        lane = beside[min(number if number is not None else 0, len(beside) - 1)]
        start = max(lane.local_coordinates(first)[0], 0.0) if i == 0 else 0.0
        end = lane.local_coordinates(last)[0] if i == len(roads) - 1 else lane.length
        pieces.append(_center(lane, start, end))
    points: Floats = np.concatenate(pieces)
    apart = np.hypot(*np.diff(points, axis=0).T) > 1e-6
    points = points[np.concatenate([[True], apart])]
    if len(points) > 1:
        return np.asarray(points)
    return np.stack([first, last if np.hypot(*(last - first)) > 1e-6 else first + np.array([1.0, 0.0])])


def _center(lane: AbstractLane, start: float, end: float) -> Floats:
    """Return points of a lane's center line between two stations [m], shape (n, 2)."""
    count = max(int(abs(end - start) / _STEP) + 2, 2)
    return np.array([lane.position(station, 0.0) for station in np.linspace(start, end, count)])
