"""What a vehicle does at the end of its target lane: `ControlledVehicle.follow_road` and `RoadNetwork.next_lane`."""

import math
from typing import Any

import numpy as np

from behavexplor.envs.stock.lane_geometry import is_after_end, lane_distance, lane_point
from behavexplor.envs.stock.lane_network import Network
from behavexplor.envs.stock.record_types import Records
from behavexplor.envs.stock.state import SAME_NUMBER, Vehicle
from behavexplor.jit import kernel_inner

_ANY_NUMBER: Any = np.int64(SAME_NUMBER)  # numba would compile a function once more for a constant of Python's own type


@kernel_inner
def follow_road(network: Network, vehicle: Vehicle, route: Records, station: float) -> None:
    """Give a vehicle near the end of its target lane the next one: `ControlledVehicle.follow_road`.

    Args:
        network: the road network.
        vehicle: the vehicle, changed in place.
        route: its route, shape (steps,) of `ROUTE_STEP`.
        station: its station on the target lane [m].
    """
    if is_after_end(network.lanes[vehicle.target_lane], station):
        vehicle.target_lane = _next_lane(network, vehicle, route, station)


@kernel_inner
def _next_lane(network: Network, vehicle: Vehicle, route: Records, station: float) -> int:
    """Return the lane after the target lane: along the route if it continues there, else the closest one.

    Args:
        network: the road network.
        vehicle: the vehicle, whose position on the route is advanced.
        route: its route.
        station: its station on the target lane [m].
    """
    lane = network.lanes[vehicle.target_lane]
    road = network.roads[lane.road]
    x, y = lane_point(lane, station)
    position: int = vehicle.route_position
    if position < vehicle.route_length and route[position].road == lane.road:
        position += 1
        vehicle.route_position = position
    if position < vehicle.route_length:
        step = route[position]
        if network.roads[step.road].origin == road.target:
            return _lane_on(network, vehicle.target_lane, step.road, step.number, x, y)
    best: int = vehicle.target_lane
    nearest = math.inf
    for k in range(road.first_exit, road.first_exit + road.n_exits):
        following = _lane_on(network, vehicle.target_lane, network.exits[k], _ANY_NUMBER, x, y)
        distance = lane_distance(network.lanes[following], x, y)
        if distance < nearest:
            best, nearest = following, distance
    return best


@kernel_inner
def _lane_on(network: Network, lane: int, next_road: int, number: int, x: float, y: float) -> int:
    """Return the lane to take on the following road: `RoadNetwork.next_lane_given_next_road`."""
    road = network.roads[next_road]
    first: int = road.first_lane
    if network.roads[network.lanes[lane].road].n_lanes == road.n_lanes:
        return first + (network.lanes[lane].number if number == SAME_NUMBER else number)
    best, nearest = first, math.inf
    for i in range(first, first + road.n_lanes):
        distance = lane_distance(network.lanes[i], x, y)
        if distance < nearest:
            best, nearest = i, distance
    return best
