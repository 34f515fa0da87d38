"""Configuration of the environments: highway-env's keys and some of this package, with every value checked.

In highway-env's own environments, which ignore unknown keys, the keys of `observation` and `action` are checked.
"""

import inspect
from collections.abc import Collection, Iterator, Mapping
from dataclasses import fields, replace
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import highway_env.envs.common.action as actions
import highway_env.envs.common.observation as observations
from highway_env.envs.common.abstract import AbstractEnv

from behavexplor.data.conventions import EPISODE_TIME
from behavexplor.data.scripted_logical import ScriptedLogicalScenario
from behavexplor.envs import values as kinds
from behavexplor.envs.observation_types import FEATURES, ORDERS
from behavexplor.envs.tasks.scripted_outcome import WEIGHTS
from behavexplor.errors import InputError, unknown_name

OBSERVATIONS = MappingProxyType(  # highway-env's types that suit a single vehicle with a destination
    {
        "GrayscaleObservation": observations.GrayscaleObservation,
        "Kinematics": observations.KinematicObservation,
        "LidarObservation": observations.LidarObservation,
        "OccupancyGrid": observations.OccupancyGridObservation,
        "Scene": None,  # the type added by this package
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
MAX_PARTS = 16  # parts of a TupleObservation
UNREAD_KEYS: Mapping[str, frozenset[str]] = MappingProxyType(
    {  # highway-env's own configurations have these keys, although nothing reads them
        "observation": frozenset({"flatten"}),
        "action": frozenset({"target_speeds"}),
    }
)
_KINDS: Mapping[str, kinds.Kind] = {  # keys of the configuration itself
    "simulation_frequency": kinds.COUNT,
    "policy_frequency": kinds.COUNT,
    "duration": kinds.POSITIVE,
    "screen_width": kinds.COUNT,
    "screen_height": kinds.COUNT,
    "centering_position": kinds.TWO_NUMBERS,
    "scaling": kinds.POSITIVE,
    "offscreen_rendering": kinds.optional(kinds.FLAG),
    "real_time_rendering": kinds.FLAG,
}
_TYPE_KINDS: Mapping[str, kinds.Kind] = {  # keys of observations and actions
    "absolute": kinds.FLAG,
    "acceleration_range": kinds.optional(kinds.RANGE),
    "actions_per_axis": kinds.COUNT,
    "align_to_vehicle_axes": kinds.FLAG,
    "as_image": kinds.FLAG,
    "cells": kinds.COUNT,
    "centering_position": kinds.optional(kinds.TWO_NUMBERS),
    "clip": kinds.FLAG,
    "dynamical": kinds.FLAG,
    "features": kinds.optional(kinds.names(FEATURES)),
    "features_range": kinds.optional(kinds.NUMBER_RANGES),
    "flatten": kinds.FLAG,
    "grid_size": kinds.optional(kinds.TWO_RANGES),
    "grid_step": kinds.optional(kinds.TWO_POSITIVE),
    "horizon": kinds.COUNT,
    "include_obstacles": kinds.FLAG,
    "lateral": kinds.FLAG,
    "longitudinal": kinds.FLAG,
    "maximum_range": kinds.POSITIVE,
    "normalize": kinds.FLAG,
    "observation_shape": kinds.IMAGE_SHAPE,
    "observe_intentions": kinds.FLAG,
    "order": kinds.one_of(ORDERS),
    "scaling": kinds.optional(kinds.POSITIVE),
    "see_behind": kinds.FLAG,
    "speed_range": kinds.optional(kinds.RANGE),
    "stack_size": kinds.COUNT,
    "steering_range": kinds.optional(kinds.RANGE),
    "target_speeds": kinds.optional(kinds.EVEN_NUMBERS),
    "vehicles_count": kinds.COUNT,
    "weights": kinds.THREE_NUMBERS,
    "OccupancyGrid.features": kinds.optional(kinds.names((*FEATURES, "on_road"))),
}
_WITHOUT_EFFECT = {  # highway-env's keys; they stay in the `config`, since highway-env's code reads some of them
    "manual_control",
    "neighbour_vehicles_connected_lanes",
    "render_agent",
    "show_trajectories",
}
_LOGICAL_KEYS = {entry.name for entry in fields(ScriptedLogicalScenario)} - {"name", "roadmap"}
HIGHWAY_OBSERVATIONS: Final = MappingProxyType(  # all types, for highway-env's own environments
    {
        **{name: kind for name, kind in OBSERVATIONS.items() if kind is not None},
        "AttributesObservation": observations.AttributesObservation,
        "ExitObservation": observations.ExitObservation,
        "KinematicsGoal": observations.KinematicsGoalObservation,
        "MultiAgentObservation": observations.MultiAgentObservation,
    }
)
HIGHWAY_ACTIONS: Final = MappingProxyType({**ACTIONS, "MultiAgentAction": actions.MultiAgentAction})
_OF_HIGHWAY_ENV: Final = "highway_env."  # how the names of its modules begin


def default_config(simulator: Mapping[str, Any], logical: ScriptedLogicalScenario) -> dict[str, Any]:
    """Return the default configuration of an environment; `simulator` is highway-env's own."""
    config = dict(simulator) | {
        "observation": default_observation(logical),
        "action": {"type": "ContinuousAction"},
        "simulation_frequency": 20,  # [Hz]
        "policy_frequency": 10,  # [Hz]
        "duration": EPISODE_TIME,
        "reward": dict(WEIGHTS),
        "logical": {},
        "screen_width": 800,
        "screen_height": 800,
        "centering_position": [0.5, 0.6],
        "scaling": 5.5,
    }
    del config["other_vehicles_type"]
    return config


def default_observation(logical: ScriptedLogicalScenario) -> dict[str, Any]:
    """Return the configuration of a Kinematics observation with one row for every possible vehicle."""
    return {"type": "Kinematics", "vehicles_count": 1 + logical.n_npcs}


def changed_config(config: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return a configuration with some values changed.

    `reward` and `logical` may be given in part: their other keys keep their values.

    Raises:
        InputError: if a key is unknown (the message names the nearest match), or a value is out of range.
    """
    changes = _mapping("config", changes)
    for key in changes:
        if key not in config:
            raise unknown_name("key of the environment's config", str(key), config)
    changed = dict(config) | dict(changes)
    for key in ("reward", "logical"):
        changed[key] = {**config[key], **_mapping(key, changes.get(key, {}))}
    _check_keys("reward", changed["reward"], WEIGHTS)
    _check_keys("logical", changed["logical"], _LOGICAL_KEYS)
    _check_observation("observation", changed["observation"], OBSERVATIONS)
    _check_action(changed["action"])
    if "TimeToCollision" in _types(changed["observation"]) and changed["action"]["type"] != "DiscreteMetaAction":
        raise InputError("The observation type TimeToCollision needs the action type DiscreteMetaAction")
    for name, weight in changed["reward"].items():
        kinds.NUMBER.check(f"reward.{name}", weight)
    for key, kind in _KINDS.items():
        kind.check(key, changed[key])
    for key in _WITHOUT_EFFECT:
        if changed[key] is not config[key]:
            raise InputError(f"{key}: {kinds.shown(changed[key])} has no effect in these environments; leave it out")
    simulation, policy = changed["simulation_frequency"], changed["policy_frequency"]
    if simulation % policy:
        raise InputError(
            f"simulation_frequency {simulation} must be a multiple of policy_frequency {policy}: "
            f"each decision lasts a whole number of simulation steps"
        )
    return changed


def changed_logical(logical: ScriptedLogicalScenario, changes: Mapping[str, Any]) -> ScriptedLogicalScenario:
    """Return a logical scenario with some parameters changed, such as the number of NPCs.

    Raises:
        InputError: if a parameter is out of range; the message names it.
    """
    if not changes:
        return logical
    kind_of = {
        "n_npcs": kinds.WHOLE,
        "waypoints_per_lane": kinds.COUNT,
        "vehicle_types": kinds.names(logical.vehicle_types),
    }
    for name, value in changes.items():
        kind_of.get(name, kinds.NOT_NEGATIVE).check(f"logical.{name}", value)
    values: dict[str, Any] = dict(changes)
    if "vehicle_types" in values:
        values["vehicle_types"] = tuple(values["vehicle_types"])
    other = replace(logical, **values)
    if other.min_speed > other.roadmap.speed_limit:
        raise InputError(f"logical.min_speed: {other.min_speed} exceeds the speed limit {other.roadmap.speed_limit}")
    shortest = min(route.lanes[0].length for route in other.roadmap.npc_routes)
    if 2 * other.end_gap > shortest:
        raise InputError(f"logical.end_gap: {other.end_gap} leaves no room to start in a lane of {shortest:g} m")
    return other


def _check_observation(what: str, config: object, types: Mapping[str, type | None]) -> None:
    settings = check_type(what, config, types)
    if settings["type"] == "OccupancyGrid" and settings.get("absolute"):
        raise InputError(f"{what}.absolute: an OccupancyGrid is always relative to the ego")
    if settings["type"] == "TupleObservation":
        parts = settings["observation_configs"]
        if not isinstance(parts, list | tuple) or not 1 <= len(parts) <= MAX_PARTS:
            wanted = f"a list of 1 to {MAX_PARTS} observations"
            raise InputError(f"{what}.observation_configs: expected {wanted}, got {kinds.shown(parts)}")
        inner = {name: kind for name, kind in types.items() if kind and name != "TupleObservation"}
        for i, part in enumerate(parts):
            _check_observation(f"{what}.observation_configs[{i}]", part, inner)


def _check_action(config: object) -> None:
    settings = check_type("action", config, ACTIONS)
    if not (settings.get("longitudinal", True) or settings.get("lateral", True)):
        raise InputError("action: at least one of longitudinal and lateral must be True")


def _types(observation: Mapping[str, Any]) -> list[str]:
    """Return the types of an observation and of its parts."""
    parts = observation.get("observation_configs", ()) if observation["type"] == "TupleObservation" else ()
    return [observation["type"], *(part["type"] for part in parts)]


def check_type(what: str, config: object, types: Mapping[str, type | None]) -> Mapping[str, Any]:
    """Check the configuration of an observation or action: highway-env reads every key, and needs no other.

    `what` names it in messages: "observation" or "action", perhaps with the place of a part. `types` are highway-env's
    classes by the names that the key `type` may have.

    Raises:
        InputError: if a key is unknown or missing, or a value is out of range.
    """
    settings = _mapping(what, config)
    name = settings.get("type")
    if not isinstance(name, str) or name not in types:
        raise unknown_name(f"{what} type", str(name), types)
    kind = types[name]
    parameters = dict(inspect.signature(kind).parameters) if kind else {}
    for unread in ("env", "args", "kwargs"):
        parameters.pop(unread, None)
    _check_keys(what, settings, {"type", *parameters} | UNREAD_KEYS[what.partition(".")[0]])
    for key, parameter in parameters.items():
        if parameter.default is parameter.empty and key not in settings:
            raise InputError(f"{what}: {name} needs {key!r}")
    for key, value in settings.items():
        expected = _TYPE_KINDS.get(f"{name}.{key}", _TYPE_KINDS.get(key))
        if expected is not None:
            expected.check(f"{what}.{key}", value)
    return settings


def _check_keys(what: str, values: Mapping[str, Any], known: object) -> None:
    names = set(known)  # type: ignore[call-overload]
    for key in values:
        if key not in names:
            raise unknown_name(f"key of {what}", str(key), names)


def _mapping(what: str, value: object) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise InputError(f"{what}: expected keys and values, got {kinds.shown(value)}")
    return value


class _Known(NamedTuple):
    """What an environment knows of its observations, or of its actions."""

    types: Mapping[str, Any]  # highway-env's classes by the names that `type` may have
    keys: frozenset[str]  # keys that any of these types takes, or that the environment's own configuration has
    features: frozenset[str]  # features of a vehicle


def check_space_keys(env: AbstractEnv, config: Mapping[str, Any]) -> None:
    """Check types, keys and features of `observation` and `action`, where a highway-env configuration gives them.

    `env` is in its own configuration. A key of another type is not refused: configurations keep such keys when their
    type is changed, and highway-env's own documentation has some. An environment that makes its own observations may
    read any key.

    Raises:
        InputError: if one is unknown; the message names it, and the nearest match.
    """
    if not type(env).define_spaces.__module__.startswith(_OF_HIGHWAY_ENV):
        return
    features = frozenset({*(env.vehicle.to_dict() if env.vehicle is not None else ()), "on_road"})
    for what, types in (("observation", HIGHWAY_OBSERVATIONS), ("action", HIGHWAY_ACTIONS)):
        if what in config:
            keys = UNREAD_KEYS[what].union(env.config[what], *map(_parameters, types.values()))
            _check_known(what, config[what], _Known(types, keys, features))


def _check_known(what: str, config: object, known: _Known) -> None:
    """Check the configuration of an observation or action, and of its parts."""
    settings = _mapping(what, config)
    if "type" not in settings:
        raise InputError(
            f"{what} needs a type, such as {next(iter(known.types))}: highway-env keeps none of its default"
        )
    name = settings["type"]
    if not isinstance(name, str) or name not in known.types:
        raise unknown_name(f"{what} type", str(name), known.types)
    for key in settings:
        if key not in known.keys:
            raise unknown_name(f"key of {what}", str(key), _parameters(known.types[name]))
    for key in ("features", "features_range"):
        for feature in _listed(settings.get(key)):
            if str(feature) not in known.features:
                raise unknown_name(f"feature in {what}.{key}", str(feature), known.features)
    for place, part in _parts(settings):
        _check_known(f"{what}.{place}", part, known)


def _parts(settings: Mapping[str, Any]) -> Iterator[tuple[str, object]]:
    """Yield the observations or actions of which one is made, and their places in its configuration."""
    yield from ((key, settings[key]) for key in ("observation_config", "action_config") if key in settings)
    for i, part in enumerate(_listed(settings.get("observation_configs"))):
        yield f"observation_configs[{i}]", part


def _listed(value: object) -> Collection[Any]:
    """Return the entries of a value; nothing for a value that is no list, which highway-env itself refuses."""
    return value if isinstance(value, list | tuple | Mapping) else ()


def _parameters(kind: type) -> frozenset[str]:
    """Return the keys that a type of observation or action takes, with those of the classes from which it derives."""
    taken = {"type"}
    for base in kind.__mro__:
        own = vars(base).get("__init__")
        if own is not None and base.__module__.startswith(_OF_HIGHWAY_ENV):
            taken.update(inspect.signature(own).parameters)
    return frozenset(taken - {"self", "env", "args", "kwargs"})
