"""Traits of highway-env's vehicles and obstacles: how they drive, as far as it does not change in an episode."""

import math
from collections.abc import Iterable
from typing import Any, Final

import numpy as np
from highway_env.vehicle.behavior import IDMVehicle, LinearVehicle
from highway_env.vehicle.controller import ControlledVehicle, MDPVehicle
from highway_env.vehicle.kinematics import Vehicle
from highway_env.vehicle.objects import Obstacle, RoadObject

from behavexplor.envs.stock.state import IDM, LINEAR, MDP, OBSTACLE, PLAIN, TRAITS, Traits
from behavexplor.errors import InputError

_CLASSES: Final[dict[int, type[RoadObject]]] = {
    PLAIN: Vehicle,
    MDP: MDPVehicle,
    IDM: IDMVehicle,
    LINEAR: LinearVehicle,
    OBSTACLE: Obstacle,
}
_BEHAVIOR: Final = (
    *("act", "step", "clip_actions", "on_state_update", "predict_trajectory_constant_speed", "velocity", "direction"),
    *("handle_collisions", "_is_colliding", "polygon", "lane_distance_to", "front_distance_to", "follow_road"),
    *("steering_control", "speed_control", "acceleration", "desired_gap", "change_lane_policy", "mobil"),
    *("acceleration_features", "steering_features", "index_to_speed", "speed_to_index"),
)
_PARAMETERS: Final = {  # fields of `TRAITS`, and their names in highway-env
    "max_acceleration": "ACC_MAX",
    "comfort_acceleration": "COMFORT_ACC_MAX",
    "comfort_braking": "COMFORT_ACC_MIN",
    "distance_wanted": "DISTANCE_WANTED",
    "time_wanted": "TIME_WANTED",
    "delta": "DELTA",
    "politeness": "POLITENESS",
    "min_gain": "LANE_CHANGE_MIN_ACC_GAIN",
    "max_braking": "LANE_CHANGE_MAX_BRAKING_IMPOSED",
    "lane_change_delay": "LANE_CHANGE_DELAY",
}
_ACCELERATION_GAINS: Final = ("speed_gain", "front_speed_gain", "front_gap_gain")
_STEERING_GAINS: Final = ("heading_gain", "offset_gain")
_CONTROL: Final = ("TAU_PURSUIT", "KP_A", "KP_HEADING", "KP_LATERAL", "MAX_STEERING_ANGLE")


def kind_of(cls: type[RoadObject]) -> int:
    """Return the kind of a highway-env class. A subclass is of its parent's kind if it changes parameters only.

    Raises:
        InputError: if the class behaves differently from all those that the engine knows.
    """
    for kind, known in _CLASSES.items():
        same_behavior = all(getattr(cls, name, None) is getattr(known, name, None) for name in _BEHAVIOR)
        if issubclass(cls, known) and same_behavior:
            return kind
    names = ", ".join(known.__name__ for known in _CLASSES.values())
    raise InputError(
        f"The compiled engine does not know how a {cls.__name__} drives; it knows {names} and their subclasses with "
        f"other parameters; use gymnasium.make_vec with vectorization_mode='sync'"
    )


def traits_of(source: Any, kind: int) -> Traits:
    """Return the traits of a vehicle or an obstacle, or of a highway-env class for those that are still to be made.

    Raises:
        InputError: if it has parameters that the engine does not read.
    """
    traits: Traits = np.zeros(1, TRAITS)[0]
    traits.kind, traits.length, traits.width = kind, source.LENGTH, source.WIDTH
    traits.diameter = math.sqrt(source.LENGTH**2 + source.WIDTH**2)
    traits.checks_collisions = getattr(source, "check_collisions", True)
    if not (getattr(source, "collidable", True) and getattr(source, "solid", True)):
        raise InputError("The compiled engine knows only vehicles and obstacles that are collidable and solid")
    if kind == OBSTACLE:
        return traits
    traits.min_speed, traits.max_speed = source.MIN_SPEED, source.MAX_SPEED
    if kind != PLAIN:
        _check_control(source)
    if kind in (IDM, LINEAR):
        _read_driver(traits, source)
    if kind == LINEAR:
        _put(traits, _ACCELERATION_GAINS, source.ACCELERATION_PARAMETERS)
        _put(traits, _STEERING_GAINS, source.STEERING_PARAMETERS)
        traits.speed_exponent = 2.0
    return traits


def give_traits(vehicle: Any, traits: Traits) -> None:
    """Give a new highway-env vehicle its traits: the inverse of `traits_of`."""
    vehicle.check_collisions = bool(traits.checks_collisions)
    if traits.kind not in (IDM, LINEAR):
        return
    vehicle.enable_lane_change = bool(traits.changes_lanes)
    for field, name in _PARAMETERS.items():
        if getattr(vehicle, name) != traits[field]:
            setattr(vehicle, name, float(traits[field]))
    if traits.kind == LINEAR:
        vehicle.ACCELERATION_PARAMETERS = np.array([traits[field] for field in _ACCELERATION_GAINS])
        vehicle.STEERING_PARAMETERS = np.array([traits[field] for field in _STEERING_GAINS])


def _check_control(source: Any) -> None:
    for name in _CONTROL:
        if getattr(source, name) != getattr(ControlledVehicle, name):
            raise InputError(f"The compiled engine does not support vehicles with another {name} than highway-env's")


def _read_driver(traits: Traits, source: Any) -> None:
    """Read the parameters of the reactive traffic."""
    _put(traits, tuple(_PARAMETERS), [getattr(source, name) for name in _PARAMETERS.values()])
    traits.gap_divisor = 2 * math.sqrt(-source.COMFORT_ACC_MAX * source.COMFORT_ACC_MIN)
    traits.changes_lanes = getattr(source, "enable_lane_change", True)


def _put(traits: Traits, fields: tuple[str, ...], values: Iterable[float]) -> None:
    for field, value in zip(fields, values, strict=True):
        traits[field] = value
