"""The kinematic bicycle model: motion of a vehicle in a frame."""

import math

from behavexplor.envs.engine.state import Traits, Vehicle
from behavexplor.jit import kernel_inner


@kernel_inner
def move(vehicle: Vehicle, traits: Traits, dt: float) -> float:
    """Advance a vehicle by `dt` [s]: `Vehicle.step`, but its lane is not updated. Return the slip angle [rad]."""
    _limit_commands(vehicle, traits)
    speed, heading, slip = vehicle.speed, vehicle.heading, 0.0
    if vehicle.steering == 0.0:  # most vehicles go straight on; the formulas below give the same
        vehicle.x += speed * vehicle.cos * dt
        vehicle.y += speed * vehicle.sin * dt
    else:
        slip = math.atan(0.5 * math.tan(vehicle.steering))
        vehicle.x += speed * math.cos(heading + slip) * dt
        vehicle.y += speed * math.sin(heading + slip) * dt
        heading += speed * math.sin(slip) / (traits.length / 2) * dt
        vehicle.heading = heading
        vehicle.cos, vehicle.sin = math.cos(heading), math.sin(heading)
    if vehicle.has_impact:
        vehicle.x += vehicle.impact_x
        vehicle.y += vehicle.impact_y
        vehicle.crashed = True
        vehicle.has_impact = False
    vehicle.speed += vehicle.acceleration * dt
    return slip


@kernel_inner
def _limit_commands(vehicle: Vehicle, traits: Traits) -> None:
    """Keep the vehicle within its speed range, and stop it after a crash: `Vehicle.clip_actions`."""
    if vehicle.crashed:
        vehicle.steering = 0.0
        vehicle.acceleration = -1.0 * vehicle.speed
    if vehicle.speed > traits.max_speed:
        vehicle.acceleration = min(vehicle.acceleration, 1.0 * (traits.max_speed - vehicle.speed))
    elif vehicle.speed < traits.min_speed:
        vehicle.acceleration = max(vehicle.acceleration, 1.0 * (traits.min_speed - vehicle.speed))
