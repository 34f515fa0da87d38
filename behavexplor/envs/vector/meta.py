"""Meta-actions: highway-env's `MDPVehicle`, which follows target lanes and target speeds.

Operations follow highway-env's own order, so that results are equal to the last bits.
"""

import math
from typing import Final

import numpy as np
from highway_env.vehicle.controller import ControlledVehicle
from numpy.typing import NDArray

from behavexplor.data.vehicle_sizes import EGO_SIZE
from behavexplor.envs.vector.lanes import (
    COUNT,
    FIRST,
    LaneNetwork,
    is_after_end,
    is_reachable,
    lane_coordinates,
    lane_heading,
    next_lane,
    wrap_to_pi,
)
from behavexplor.jit import kernel_inner

Floats = NDArray[np.float64]

LANE_LEFT, IDLE, LANE_RIGHT, FASTER, SLOWER = range(5)

KP_SPEED: Final = float(ControlledVehicle.KP_A)  # [1/s]
KP_HEADING: Final = float(ControlledVehicle.KP_HEADING)  # [1/s]
KP_LATERAL: Final = float(ControlledVehicle.KP_LATERAL)  # [1/s]
PURSUIT_TIME: Final = float(ControlledVehicle.TAU_PURSUIT)  # [s]
MAX_STEERING: Final = float(ControlledVehicle.MAX_STEERING_ANGLE)  # [rad]
LENGTH: Final = float(EGO_SIZE[0])  # [m]
SLOWEST: Final = 1e-2  # least speed in a denominator [m/s]


@kernel_inner
def changed_speed(speeds: Floats, index: int, maneuver: int, speed: float) -> int:
    """Return the index of the target speed after a maneuver: `MDPVehicle.act`."""
    if maneuver not in (FASTER, SLOWER):
        return index
    index = nearest_speed(speeds, speed) + (1 if maneuver == FASTER else -1)
    return min(max(index, 0), len(speeds) - 1)


@kernel_inner
def nearest_speed(speeds: Floats, speed: float) -> int:
    """Return the index of the nearest of evenly spaced speeds."""
    last = len(speeds) - 1
    share = (speed - speeds[0]) / (speeds[last] - speeds[0])
    return int(min(max(np.rint(share * last), 0.0), float(last)))


@kernel_inner
def changed_lane(network: LaneNetwork, lane: int, maneuver: int, x: float, y: float) -> int:
    """Return the target lane after a maneuver: `ControlledVehicle.act` with a meta-action."""
    if maneuver not in (LANE_LEFT, LANE_RIGHT):
        return lane
    road = network.lane_road[lane]
    first, count = network.roads[road, FIRST], network.roads[road, COUNT]
    wanted = min(max(lane + (1 if maneuver == LANE_RIGHT else -1), first), first + count - 1)
    return wanted if is_reachable(network.lanes, wanted, x, y) else lane


@kernel_inner
def follow_road(network: LaneNetwork, position: int, lane: int, x: float, y: float) -> tuple[int, int]:
    """Return the target lane and the completed steps of the route: `ControlledVehicle.follow_road`.

    Near the end of a lane, the target is the next lane.
    """
    if is_after_end(network.lanes, lane, x, y):
        return next_lane(network, position, lane, x, y)
    return lane, position


@kernel_inner
def throttle(target_speed: float, speed: float) -> float:
    """Compute the acceleration toward a target speed [m/s2]: `ControlledVehicle.speed_control`."""
    return KP_SPEED * (target_speed - speed)


@kernel_inner
def steering(lanes: Floats, lane: int, x: float, y: float, heading: float, speed: float) -> float:
    """Compute the steering angle toward a target lane [rad]: `ControlledVehicle.steering_control`."""
    station, offset = lane_coordinates(lanes, lane, x, y)
    ahead = station + speed * PURSUIT_TIME
    future_heading = lane_heading(lanes, lane, ahead)
    divisor = _not_zero(speed)
    heading_command = math.asin(_clip(-KP_LATERAL * offset / divisor, 1.0))
    wanted = future_heading + _clip(heading_command, math.pi / 4)
    rate = KP_HEADING * wrap_to_pi(wanted - heading)
    slip = math.asin(_clip(LENGTH / 2 / divisor * rate, 1.0))
    return _clip(math.atan(2 * math.tan(slip)), MAX_STEERING)


@kernel_inner
def _not_zero(speed: float) -> float:
    if abs(speed) > SLOWEST:
        return speed
    return SLOWEST if speed >= 0 else -SLOWEST


@kernel_inner
def _clip(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)
