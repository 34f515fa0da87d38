"""highway-env's lanes as rows of an array: coordinates, the closest lane, and the next lane.

Operations follow highway-env's own order, so that results are equal to the last bits.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from highway_env.road.lane import AbstractLane, CircularLane
from numpy.typing import NDArray

from behavexplor.jit import kernel_inner

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

CURVED, X, Y, A, B, C, LENGTH, WIDTH = range(8)  # columns of `LaneNetwork.lanes`
# Straight lane: (X, Y) is its start; A and B are the x and y of its direction, and C is its heading.
# Curved lane: (X, Y) is its center; A is its radius, B its phase at the start, and C its turn (1: to the right).

ORIGIN, TARGET, FIRST, COUNT = range(4)  # columns of `LaneNetwork.roads`: nodes, first lane, number of lanes
ROAD, NUMBER = range(2)  # columns of `LaneNetwork.route`: road, and number of the lane on it


class LaneNetwork(NamedTuple):
    """The road network, and the ego's route through it.

    Attributes:
        lanes: all lanes in highway-env's order, with the columns `CURVED` to `WIDTH`, shape (lanes, 8).
        roads: nodes and lanes of the groups of parallel lanes, shape (roads, 4).
        lane_road: road of each lane, shape (lanes,).
        route: road and lane number of each lane of the ego's route, shape (steps, 2).
    """

    lanes: Floats
    roads: Ints
    lane_road: Ints
    route: Ints


VEHICLE_LENGTH: Final = float(AbstractLane.VEHICLE_LENGTH)  # highway-env extends lanes by this length [m]


def lane_row(lane: AbstractLane) -> list[float]:
    """Return a straight or circular lane as a row of `LaneNetwork.lanes`."""
    if isinstance(lane, CircularLane):
        return [1.0, *lane.center, lane.radius, lane.start_phase, lane.direction, lane.length, lane.width]
    return [0.0, *lane.start, *lane.direction, lane.heading, lane.length, lane.width]


@kernel_inner
def wrap_to_pi(angle: float) -> float:
    """Wrap an angle to [-pi, pi)."""
    turned = angle + math.pi
    if 0 <= turned < 2 * math.pi:  # these three cases need no division, and have the same result
        return turned - math.pi
    if -2 * math.pi < turned < 0:
        return turned + 2 * math.pi - math.pi
    if 2 * math.pi <= turned < 4 * math.pi:
        return turned - 2 * math.pi - math.pi
    wrapped: float = (turned % (2 * math.pi)) - math.pi
    return wrapped


@kernel_inner
def lane_coordinates(lanes: Floats, i: int, x: float, y: float) -> tuple[float, float]:
    """Compute the station and offset of a point on lane i [m]."""
    dx, dy = x - lanes[i, X], y - lanes[i, Y]
    if lanes[i, CURVED] == 0.0:
        return dx * lanes[i, A] + dy * lanes[i, B], dy * lanes[i, A] - dx * lanes[i, B]
    turned = wrap_to_pi(math.atan2(dy, dx) - lanes[i, B])
    phase = lanes[i, B] + turned
    station = lanes[i, C] * (phase - lanes[i, B]) * lanes[i, A]
    return station, lanes[i, C] * (lanes[i, A] - math.sqrt(dx * dx + dy * dy))


@kernel_inner
def lane_heading(lanes: Floats, i: int, station: float) -> float:
    """Compute the heading of lane i at a station [rad]."""
    if lanes[i, CURVED] == 0.0:
        return float(lanes[i, C])
    phase = lanes[i, C] * station / lanes[i, A] + lanes[i, B]
    return float(phase + math.pi / 2 * lanes[i, C])


@kernel_inner
def lane_point(lanes: Floats, i: int, station: float) -> tuple[float, float]:
    """Compute the point of lane i's center line at a station [m]."""
    if lanes[i, CURVED] == 0.0:
        return lanes[i, X] + station * lanes[i, A], lanes[i, Y] + station * lanes[i, B]
    phase = lanes[i, C] * station / lanes[i, A] + lanes[i, B]
    return lanes[i, X] + lanes[i, A] * math.cos(phase), lanes[i, Y] + lanes[i, A] * math.sin(phase)


@kernel_inner
def lane_distance(lanes: Floats, i: int, x: float, y: float) -> float:
    """Compute highway-env's distance of a point from lane i: its offset plus its distance beyond either end [m]."""
    station, offset = lane_coordinates(lanes, i, x, y)
    return float(abs(offset) + max(station - lanes[i, LENGTH], 0.0) + max(-station, 0.0))


@kernel_inner
def closest_lane(lanes: Floats, x: float, y: float, heading: float) -> int:
    """Return the lane that is closest in position and heading."""
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


@kernel_inner
def _least_distance(lanes: Floats, i: int, x: float, y: float) -> float:
    """Compute a lower bound of the distance from lane i that is cheap to compute: the offset [m]."""
    dx, dy = x - lanes[i, X], y - lanes[i, Y]
    if lanes[i, CURVED] == 0.0:
        return float(abs(dy * lanes[i, A] - dx * lanes[i, B]))
    return float(abs(lanes[i, A] - math.sqrt(dx * dx + dy * dy)))


@kernel_inner
def is_reachable(lanes: Floats, i: int, x: float, y: float) -> bool:
    """Return whether highway-env lets a vehicle change to lane i."""
    station, offset = lane_coordinates(lanes, i, x, y)
    return bool(abs(offset) <= 2 * lanes[i, WIDTH] and 0 <= station < lanes[i, LENGTH] + VEHICLE_LENGTH)


@kernel_inner
def is_after_end(lanes: Floats, i: int, x: float, y: float) -> bool:
    """Return whether a vehicle is so near the end of lane i that highway-env looks for the next lane."""
    station, _ = lane_coordinates(lanes, i, x, y)
    return bool(station > lanes[i, LENGTH] - VEHICLE_LENGTH / 2)


@kernel_inner
def next_lane(network: LaneNetwork, position: int, lane: int, x: float, y: float) -> tuple[int, int]:
    """Find the lane after the given one: along the route if it continues from there, else the closest lane.

    Args:
        network: the road network and the ego's route.
        position: number of completed steps of the route.
        lane: the current lane.
        x: position of the vehicle [m].
        y: position of the vehicle [m].

    Returns:
        The next lane, and the number of steps of the route that are completed then.
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


@kernel_inner
def _lane_on(
    lanes: Floats, roads: Ints, road: int, number: int, following: int, wanted: int, x: float, y: float
) -> tuple[int, float]:
    """Return the lane to take on the following road, and the distance of a point from it."""
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
