"""highway-env's lanes as rows of an array: coordinates, the closest lane, and the lane that comes next.

Operations stand in highway-env's own order, so that results are the same to the last bits.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from highway_env.road.lane import AbstractLane, CircularLane
from numpy.typing import NDArray

from behavexplor.jit import kernel

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

CURVED, X, Y, A, B, C, LENGTH, WIDTH = range(8)  # columns; X, Y is the start, or the center of a curved lane
# A, B, C: x and y of the direction and the heading; of a curved lane radius, phase at the start and turn (1 right)

ORIGIN, TARGET, FIRST, COUNT = range(4)  # columns of roads: nodes, the first lane, and how many lanes
ROAD, NUMBER = range(2)  # columns of a route: road, and the lane's number on it


class Network(NamedTuple):
    """The road network, and the ego's route through it.

    Attributes:
        lanes: all lanes in highway-env's order, shape (lanes, 8); columns above.
        roads: nodes and lanes of the groups of parallel lanes, shape (roads, 4).
        lane_road: the road of each lane, shape (lanes,).
        route: road and lane number of each lane of the ego's route, shape (steps, 2).
    """

    lanes: Floats
    roads: Ints
    lane_road: Ints
    route: Ints


VEHICLE_LENGTH: Final = float(AbstractLane.VEHICLE_LENGTH)  # by which highway-env extends lanes [m]


def lane_row(lane: AbstractLane) -> list[float]:
    """A straight or circular lane as a row."""
    if isinstance(lane, CircularLane):
        return [1.0, *lane.center, lane.radius, lane.start_phase, lane.direction, lane.length, lane.width]
    return [0.0, *lane.start, *lane.direction, lane.heading, lane.length, lane.width]


@kernel
def wrap_to_pi(angle: float) -> float:
    """The same angle in [-pi, pi)."""
    wrapped: float = ((angle + math.pi) % (2 * math.pi)) - math.pi
    return wrapped


@kernel
def lane_coordinates(lanes: Floats, i: int, x: float, y: float) -> tuple[float, float]:
    """Station and offset of a point on lane i [m]."""
    dx, dy = x - lanes[i, X], y - lanes[i, Y]
    if lanes[i, CURVED] == 0.0:
        return dx * lanes[i, A] + dy * lanes[i, B], dy * lanes[i, A] - dx * lanes[i, B]
    turned = wrap_to_pi(math.atan2(dy, dx) - lanes[i, B])
    phase = lanes[i, B] + turned
    station = lanes[i, C] * (phase - lanes[i, B]) * lanes[i, A]
    return station, lanes[i, C] * (lanes[i, A] - math.sqrt(dx * dx + dy * dy))


@kernel
def lane_heading(lanes: Floats, i: int, station: float) -> float:
    """Direction of lane i at a station [rad]."""
    if lanes[i, CURVED] == 0.0:
        return float(lanes[i, C])
    phase = lanes[i, C] * station / lanes[i, A] + lanes[i, B]
    return float(phase + math.pi / 2 * lanes[i, C])


@kernel
def lane_point(lanes: Floats, i: int, station: float) -> tuple[float, float]:
    """The point of lane i's center line at a station [m]."""
    if lanes[i, CURVED] == 0.0:
        return lanes[i, X] + station * lanes[i, A], lanes[i, Y] + station * lanes[i, B]
    phase = lanes[i, C] * station / lanes[i, A] + lanes[i, B]
    return lanes[i, X] + lanes[i, A] * math.cos(phase), lanes[i, Y] + lanes[i, A] * math.sin(phase)


@kernel
def lane_distance(lanes: Floats, i: int, x: float, y: float) -> float:
    """highway-env's distance of a point from lane i: beside it and beyond its ends, added up [m]."""
    station, offset = lane_coordinates(lanes, i, x, y)
    return float(abs(offset) + max(station - lanes[i, LENGTH], 0.0) + max(-station, 0.0))


@kernel
def closest_lane(lanes: Floats, x: float, y: float, heading: float) -> int:
    """The lane that is closest in position and heading."""
    best, nearest = 0, math.inf
    for i in range(len(lanes)):
        if _least_distance(lanes, i, x, y) >= nearest:
            continue
        station, offset = lane_coordinates(lanes, i, x, y)
        distance = abs(offset) + max(station - lanes[i, LENGTH], 0.0) + max(-station, 0.0)
        distance += abs(wrap_to_pi(heading - lane_heading(lanes, i, station)))
        if distance < nearest:
            best, nearest = i, distance
    return best


@kernel
def _least_distance(lanes: Floats, i: int, x: float, y: float) -> float:
    """A part of the distance from lane i that is cheap to compute [m]."""
    dx, dy = x - lanes[i, X], y - lanes[i, Y]
    if lanes[i, CURVED] == 0.0:
        return float(abs(dy * lanes[i, A] - dx * lanes[i, B]))
    return float(abs(lanes[i, A] - math.sqrt(dx * dx + dy * dy)))


@kernel
def is_reachable(lanes: Floats, i: int, x: float, y: float) -> bool:
    """Whether highway-env lets a vehicle change to lane i."""
    station, offset = lane_coordinates(lanes, i, x, y)
    return bool(abs(offset) <= 2 * lanes[i, WIDTH] and 0 <= station < lanes[i, LENGTH] + VEHICLE_LENGTH)


@kernel
def is_after_end(lanes: Floats, i: int, x: float, y: float) -> bool:
    """Whether a vehicle is so near the end of lane i that highway-env looks for the next."""
    station, _ = lane_coordinates(lanes, i, x, y)
    return bool(station > lanes[i, LENGTH] - VEHICLE_LENGTH / 2)


@kernel
def next_lane(network: Network, position: int, lane: int, x: float, y: float) -> tuple[int, int]:
    """The lane after the given one, along the route where that goes on from there, else the closest.

    Args:
        network: see `Network`.
        position: how many steps of the route are done.
        lane: the present lane.
        x: of the vehicle [m].
        y: of the vehicle [m].

    Returns:
        The next lane, and how many steps of the route are done then.
    """
    lanes, roads, route = network.lanes, network.roads, network.route
    road = network.lane_road[lane]
    number = lane - roads[road, FIRST]
    if position < len(route) and route[position, ROAD] == road:
        position += 1
    station, _ = lane_coordinates(lanes, lane, x, y)
    x, y = lane_point(lanes, lane, station)
    if position < len(route) and roads[route[position, ROAD], ORIGIN] == roads[road, TARGET]:
        following, _ = _lane_on(lanes, roads, road, number, route[position, ROAD], route[position, NUMBER], x, y)
        return following, position
    best, nearest = lane, math.inf
    for other in range(len(roads)):
        if roads[other, ORIGIN] != roads[road, TARGET]:
            continue
        following, distance = _lane_on(lanes, roads, road, number, other, -1, x, y)
        if distance < nearest:
            best, nearest = following, distance
    return best, position


@kernel
def _lane_on(
    lanes: Floats, roads: Ints, road: int, number: int, following: int, wanted: int, x: float, y: float
) -> tuple[int, float]:
    """The lane to take on the following road, and the distance of a point from it."""
    first, count = roads[following, FIRST], roads[following, COUNT]
    if roads[road, COUNT] == count:
        lane = first + (number if wanted < 0 else wanted)
        return lane, lane_distance(lanes, lane, x, y)
    best, nearest = first, math.inf
    for lane in range(first, first + count):
        distance = lane_distance(lanes, lane, x, y)
        if distance < nearest:
            best, nearest = lane, distance
    return best, nearest
