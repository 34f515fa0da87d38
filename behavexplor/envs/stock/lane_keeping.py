"""Steering and speed control, and the meta-actions of the ego: `ControlledVehicle`, `MDPVehicle`, `LinearVehicle`."""

import math

import numpy as np
from numpy.typing import NDArray

from behavexplor.envs.stock.lane_geometry import is_reachable, lane_coordinates, lane_heading
from behavexplor.envs.stock.lane_network import Lane, Network
from behavexplor.envs.stock.places import coordinates_on
from behavexplor.envs.stock.record_types import Records
from behavexplor.envs.stock.routing import follow_road
from behavexplor.envs.stock.state import Scene, Traits, Vehicle
from behavexplor.envs.vector.lanes import wrap_to_pi
from behavexplor.envs.vector.meta import (
    FASTER,
    KP_HEADING,
    KP_LATERAL,
    LANE_LEFT,
    LANE_RIGHT,
    MAX_STEERING,
    PURSUIT_TIME,
    SLOWER,
    SLOWEST,
    nearest_speed,
    throttle,
)
from behavexplor.jit import kernel_inner

Floats = NDArray[np.float64]


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
    """Change the target speed and the target lane as a meta-action says: `MDPVehicle.act`.

    Args:
        network: the road network.
        speeds: the target speeds that the vehicle may have [m/s].
        vehicle: the vehicle, changed in place.
        route: its route.
        maneuver: an index of `behavexplor.data.conventions.MANEUVERS`.
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
def keep_lane_and_speed(network: Network, scene: Scene, i: int) -> None:
    """Steer toward the target lane and accelerate toward the target speed: `ControlledVehicle.act` without an action.

    Args:
        network: the road network.
        scene: the episode. Vehicle i is changed in place.
        i: the vehicle.
    """
    vehicle, former = scene.vehicles[i], scene.vehicles[i].target_lane
    station, offset = coordinates_on(network, scene, i, former)
    follow_road(network, vehicle, scene.routes[i], station)
    if vehicle.target_lane != former:
        station, offset = coordinates_on(network, scene, i, vehicle.target_lane)
    lane = network.lanes[vehicle.target_lane]
    vehicle.steering = steering(lane, vehicle, station, offset, scene.traits[i].length)
    vehicle.acceleration = throttle(vehicle.target_speed, vehicle.speed)


@kernel_inner
def steering(lane: Lane, vehicle: Vehicle, station: float, offset: float, length: float) -> float:
    """Compute the steering angle toward a lane [rad]: `ControlledVehicle.steering_control`.

    Args:
        lane: the lane to follow.
        vehicle: the vehicle.
        station: its station on the lane [m].
        offset: its offset from the lane [m].
        length: its length [m].
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

    The arguments are those of `steering`.
    """
    divisor = not_zero(vehicle.speed)
    future_heading = lane_heading(lane, station + vehicle.speed * PURSUIT_TIME)
    turn = wrap_to_pi(future_heading - vehicle.heading) * traits.length / divisor
    shift = -offset * traits.length / divisor**traits.speed_exponent
    angle = traits.heading_gain * turn + traits.offset_gain * shift
    return clip(angle, -MAX_STEERING, MAX_STEERING)
