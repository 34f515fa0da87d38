"""The configuration of the environments: highway-env's with a few keys of ours, and every value checked."""

import inspect
import math
from collections.abc import Mapping
from dataclasses import fields, replace
from types import MappingProxyType
from typing import Any

import highway_env.envs.common.action as actions
import highway_env.envs.common.observation as observations

from behavexplor.envs.reward import WEIGHTS
from behavexplor.errors import InputError, unknown_name
from behavexplor.logical import LogicalScenario

OBSERVATIONS = MappingProxyType(  # highway-env's types that make sense for one vehicle on its way to a place
    {
        "AttributesObservation": observations.AttributesObservation,
        "GrayscaleObservation": observations.GrayscaleObservation,
        "Kinematics": observations.KinematicObservation,
        "LidarObservation": observations.LidarObservation,
        "OccupancyGrid": observations.OccupancyGridObservation,
        "Scene": None,  # ours
        "TimeToCollision": observations.TimeToCollisionObservation,
        "TupleObservation": observations.TupleObservation,
    }
)
ACTIONS = MappingProxyType(
    {
        "ContinuousAction": actions.ContinuousAction,
        "DiscreteAction": actions.DiscreteAction,
        "DiscreteMetaAction": actions.DiscreteMetaAction,
    }
)
_UNREAD_KEYS = {
    "observation": {"flatten"},
    "action": {"target_speeds"},
}  # in highway-env's own, though nothing reads them
_LOGICAL_KEYS = {entry.name for entry in fields(LogicalScenario)} - {"name", "roadmap"}


def default_config(simulator: Mapping[str, Any], logical: LogicalScenario) -> dict[str, Any]:
    """The configuration of an environment where nothing was changed.

    Args:
        simulator: highway-env's.
        logical: the environment's logical scenario.
    """
    config = dict(simulator) | {
        "observation": {"type": "Kinematics", "vehicles_count": 1 + logical.n_npcs},
        "action": {"type": "ContinuousAction"},
        "simulation_frequency": 20,  # [Hz]
        "policy_frequency": 10,  # [Hz]
        "duration": 200.0,  # [s]
        "reward": dict(WEIGHTS),
        "logical": {},
        "screen_width": 800,
        "screen_height": 800,
        "centering_position": [0.5, 0.6],
        "scaling": 5.5,
    }
    del config["other_vehicles_type"]
    return config


def changed_config(config: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """A configuration with some values changed; of `reward` and `logical` single keys may be given.

    Raises:
        InputError: if a key is unknown, naming the nearest match, or a value is out of range.
    """
    for key in changes:
        if key not in config:
            raise unknown_name("key of the environment's config", str(key), config)
    changed = dict(config) | dict(changes)
    for key in ("reward", "logical"):
        changed[key] = {**config[key], **_mapping(key, changes.get(key, {}))}
    _check_keys("reward", changed["reward"], WEIGHTS)
    _check_keys("logical", changed["logical"], _LOGICAL_KEYS)
    _check_type("observation", changed["observation"], OBSERVATIONS)
    _check_type("action", changed["action"], ACTIONS)
    if changed["observation"]["type"] == "TimeToCollision" and changed["action"]["type"] != "DiscreteMetaAction":
        raise InputError("The observation type TimeToCollision needs the action type DiscreteMetaAction")
    for name, weight in changed["reward"].items():
        if not isinstance(weight, int | float) or isinstance(weight, bool) or not math.isfinite(weight):
            raise InputError(f"reward.{name}: expected a number, got {weight!r:.80}")
    _check_times(changed)
    return changed


def changed_logical(logical: LogicalScenario, changes: Mapping[str, Any]) -> LogicalScenario:
    """A logical scenario with other parameter ranges, such as another number of NPCs.

    Raises:
        InputError: naming what is out of range.
    """
    if not changes:
        return logical
    for name, value in changes.items():
        if name == "vehicle_types":
            if not isinstance(value, list | tuple):
                raise InputError(f"logical.vehicle_types: expected a list of types, got {value!r:.80}")
            _check_keys("logical.vehicle_types", dict.fromkeys(value), logical.vehicle_types)
        elif not isinstance(value, int | float) or isinstance(value, bool) or value < 0:
            raise InputError(f"logical.{name}: expected a number >= 0, got {value!r:.80}")
    values: dict[str, Any] = {
        name: tuple(value) if name == "vehicle_types" else value for name, value in changes.items()
    }
    other = replace(logical, **values)
    if other.min_speed > other.roadmap.speed_limit:
        raise InputError(f"logical.min_speed: {other.min_speed} exceeds the speed limit {other.roadmap.speed_limit}")
    for name in ("n_npcs", "waypoints_per_lane"):
        if not isinstance(getattr(other, name), int):
            raise InputError(f"logical.{name}: expected a whole number, got {getattr(other, name)!r}")
    if other.waypoints_per_lane < 1 or not other.vehicle_types:
        raise InputError("logical: at least one waypoint per lane and one vehicle type are needed")
    return other


def _check_times(config: Mapping[str, Any]) -> None:
    for name in ("simulation_frequency", "policy_frequency", "duration"):
        value = config[name]
        if not isinstance(value, int | float) or isinstance(value, bool) or not 0 < value <= 10_000:
            raise InputError(f"{name}: expected a number above 0 and up to 10000, got {value!r:.80}")
    simulation, policy = config["simulation_frequency"], config["policy_frequency"]
    for name, value in (("simulation_frequency", simulation), ("policy_frequency", policy)):
        if not isinstance(value, int):
            raise InputError(f"{name}: expected a whole number, got {value!r}")
    if simulation % policy:
        raise InputError(
            f"simulation_frequency {simulation} must be a multiple of policy_frequency {policy}, "
            f"or time would run wrong"
        )


def _check_type(what: str, config: object, types: Mapping[str, type | None]) -> None:
    """Whether highway-env will read every key of an observation's or an action's configuration."""
    settings = _mapping(what, config)
    kind = settings.get("type")
    if not isinstance(kind, str) or kind not in types:
        raise unknown_name(f"{what} type", str(kind), types)
    bases = types[kind].__mro__ if types[kind] else ()  # type: ignore[union-attr]
    known = {name for base in bases for name in inspect.signature(base).parameters} if bases else set()
    _check_keys(what, settings, (known - {"env", "args", "kwargs"}) | {"type"} | _UNREAD_KEYS[what])


def _check_keys(what: str, values: Mapping[str, Any], known: object) -> None:
    names = set(known)  # type: ignore[call-overload]
    for key in values:
        if key not in names:
            raise unknown_name(f"key of {what}", str(key), names)


def _mapping(what: str, value: object) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise InputError(f"{what}: expected keys and values, got {value!r:.80}")
    return value
