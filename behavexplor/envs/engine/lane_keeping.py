"""How vehicles steer, keep their speed, follow the road and take meta-actions.

Ported from `ControlledVehicle`, `MDPVehicle`, `LinearVehicle` and `RoadNetwork.next_lane`.
"""

import math
from typing import Final

import numpy as np
from highway_env.vehicle.controller import ControlledVehicle

from behavexplor.data.array_types import Floats
from behavexplor.data.conventions import MANEUVERS
from behavexplor.envs.engine.lane_geometry import (
    is_after_end,
    is_reachable,
    lane_coordinates,
    lane_distance,
    lane_heading,
    lane_point,
    wrap_to_pi,
)
from behavexplor.envs.engine.lane_network import Lane, Network
from behavexplor.envs.engine.state import SAME_NUMBER, Records, Traits, Vehicle
from behavexplor.jit import int64, kernel_inner

LANE_LEFT, IDLE, LANE_RIGHT, FASTER, SLOWER = range(len(MANEUVERS))

KP_SPEED: Final = float(ControlledVehicle.KP_A)  # [1/s]
KP_HEADING: Final = float(ControlledVehicle.KP_HEADING)  # [1/s]
KP_LATERAL: Final = float(ControlledVehicle.KP_LATERAL)  # [1/s]
PURSUIT_TIME: Final = float(ControlledVehicle.TAU_PURSUIT)  # [s]
MAX_STEERING: Final = float(ControlledVehicle.MAX_STEERING_ANGLE)  # [rad]
SLOWEST: Final = 1e-2  # least speed in a denominator [m/s]
_SAME_NUMBER: Final = int64(SAME_NUMBER)  # as an argument of a kernel; see `behavexplor.jit.int64`


@kernel_inner
def clip(value: float, low: float, high: float) -> float:
    """Limit a number to an interval: `numpy.clip`."""
    return min(max(value, low), high)


@kernel_inner
def not_zero(value: float) -> float:
    """Return a number, or the least one of its sign that may be a denominator: `highway_env.utils.not_zero`."""
    if abs(value) > SLOWEST:
        return value
    return SLOWEST if value >= 0 else -SLOWEST


@kernel_inner
def take_maneuver(network: Network, speeds: Floats, vehicle: Vehicle, route: Records, maneuver: int) -> None:
    """Change the target speed and the target lane as a meta-action, an index of `MANEUVERS`, says: `MDPVehicle.act`.

    `speeds` are the target speeds to choose from [m/s].
    """
    if maneuver in (FASTER, SLOWER):
        index = nearest_speed(speeds, vehicle.speed) + (1 if maneuver == FASTER else -1)
        vehicle.speed_index = min(max(index, 0), len(speeds) - 1)
        vehicle.target_speed = speeds[vehicle.speed_index]
    station, _ = lane_coordinates(network.lanes[vehicle.target_lane], vehicle.x, vehicle.y)
    follow_road(network, vehicle, route, station)
    if maneuver in (LANE_LEFT, LANE_RIGHT):
        road = network.roads[network.lanes[vehicle.target_lane].road]
        wanted: int = vehicle.target_lane + (1 if maneuver == LANE_RIGHT else -1)
        wanted = min(max(wanted, road.first_lane), road.first_lane + road.n_lanes - 1)
        if is_reachable(network.lanes[wanted], vehicle.x, vehicle.y):
            vehicle.target_lane = wanted


@kernel_inner
def nearest_speed(speeds: Floats, speed: float) -> int:
    """Return the index of the nearest of evenly spaced speeds."""
    last = len(speeds) - 1
    share = (speed - speeds[0]) / (speeds[last] - speeds[0])
    return int(min(max(np.rint(share * last), 0.0), float(last)))


@kernel_inner
def keep_lane_and_speed(
    network: Network, vehicle: Vehicle, route: Records, length: float, station: float, offset: float
) -> None:
    """Steer toward the target lane and accelerate toward the target speed: `ControlledVehicle.act` without an action.

    `station` and `offset` are those on the target lane, `length` is the vehicle's [m]. The vehicle is changed in place.
    """
    former = vehicle.target_lane
    follow_road(network, vehicle, route, station)
    lane = network.lanes[vehicle.target_lane]
    if vehicle.target_lane != former:
        station, offset = lane_coordinates(lane, vehicle.x, vehicle.y)
    vehicle.steering = steering(lane, vehicle, station, offset, length)
    vehicle.acceleration = throttle(vehicle.target_speed, vehicle.speed)


@kernel_inner
def follow_road(network: Network, vehicle: Vehicle, route: Records, station: float) -> None:
    """Give a vehicle near the end of its target lane the next one: `ControlledVehicle.follow_road`.

    `station` is that on the target lane [m], and `route` is the vehicle's, shape (steps,) of `ROUTE_STEP`.
    """
    if is_after_end(network.lanes[vehicle.target_lane], station):
        vehicle.target_lane = _advance_on_route(network, vehicle, route, station)


@kernel_inner
def _advance_on_route(network: Network, vehicle: Vehicle, route: Records, station: float) -> int:
    """Advance on the route, and return the next lane: the route's if it continues there, else the closest one."""
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
        following = _lane_on(network, vehicle.target_lane, network.exits[k], _SAME_NUMBER, x, y)
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


@kernel_inner
def throttle(target_speed: float, speed: float) -> float:
    """Compute the acceleration toward a target speed [m/s2]: `ControlledVehicle.speed_control`."""
    return KP_SPEED * (target_speed - speed)


@kernel_inner
def steering(lane: Lane, vehicle: Vehicle, station: float, offset: float, length: float) -> float:
    """Compute the steering angle toward a lane [rad]: `ControlledVehicle.steering_control`.

    Station and offset are those on the lane, length is the vehicle's [m].
    """
    divisor = not_zero(vehicle.speed)
    future_heading = lane_heading(lane, station + vehicle.speed * PURSUIT_TIME)
    command = math.asin(clip(-KP_LATERAL * offset / divisor, -1.0, 1.0))
    wanted = future_heading + clip(command, -math.pi / 4, math.pi / 4)
    rate = KP_HEADING * wrap_to_pi(wanted - vehicle.heading)
    if rate == 0.0:  # most vehicles go straight on; the formulas below give the same
        return 0.0
    slip = math.asin(clip(length / 2 / divisor * rate, -1.0, 1.0))
    return clip(math.atan(2 * math.tan(slip)), -MAX_STEERING, MAX_STEERING)


@kernel_inner
def linear_steering(lane: Lane, vehicle: Vehicle, station: float, offset: float, traits: Traits) -> float:
    """Compute the steering angle toward a lane [rad]: `LinearVehicle.steering_control`, within its limits.

    Station and offset are those on the lane [m].
    """
    divisor = not_zero(vehicle.speed)
    future_heading = lane_heading(lane, station + vehicle.speed * PURSUIT_TIME)
    turn = wrap_to_pi(future_heading - vehicle.heading) * traits.length / divisor
    shift = -offset * traits.length / divisor**traits.speed_exponent
    angle = traits.heading_gain * turn + traits.offset_gain * shift
    return clip(angle, -MAX_STEERING, MAX_STEERING)
