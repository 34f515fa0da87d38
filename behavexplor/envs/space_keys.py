"""Check the keys of `observation` and `action` in highway-env's configurations, which ignore unknown ones."""

import inspect
from collections.abc import Collection, Iterator, Mapping
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import highway_env.envs.common.action as actions
import highway_env.envs.common.observation as observations
from highway_env.envs.common.abstract import AbstractEnv

from behavexplor.envs.env_config import ACTIONS, OBSERVATIONS, UNREAD_KEYS
from behavexplor.envs.values import shown
from behavexplor.errors import InputError, unknown_name

STOCK_OBSERVATIONS: Final = MappingProxyType(
    {
        **{name: kind for name, kind in OBSERVATIONS.items() if kind is not None},
        "AttributesObservation": observations.AttributesObservation,
        "ExitObservation": observations.ExitObservation,
        "KinematicsGoal": observations.KinematicsGoalObservation,
        "MultiAgentObservation": observations.MultiAgentObservation,
    }
)
STOCK_ACTIONS: Final = MappingProxyType({**ACTIONS, "MultiAgentAction": actions.MultiAgentAction})
_OF_HIGHWAY_ENV: Final = "highway_env."


class _Known(NamedTuple):
    """What an environment knows of its observations, or of its actions.

    Attributes:
        types: highway-env's classes by the names that `type` may have.
        keys: keys that any of these types takes, or that the environment's own configuration has.
        features: features of a vehicle.
    """

    types: Mapping[str, Any]
    keys: frozenset[str]
    features: frozenset[str]


def check_space_keys(env: AbstractEnv, config: Mapping[str, Any]) -> None:
    """Check the types, keys and features of a configuration's `observation` and `action`, where they are given.

    A key of another type is not refused: configurations keep such keys when their type is changed, and highway-env's
    own documentation has some. An environment that makes its own observations may read any key.

    Args:
        env: the environment in its own configuration.
        config: the configuration.

    Raises:
        InputError: if one is unknown; the message names it, and the nearest match.
    """
    if not type(env).define_spaces.__module__.startswith(_OF_HIGHWAY_ENV):
        return
    features = frozenset({*(env.vehicle.to_dict() if env.vehicle is not None else ()), "on_road"})
    for what, types in (("observation", STOCK_OBSERVATIONS), ("action", STOCK_ACTIONS)):
        if what in config:
            keys = UNREAD_KEYS[what].union(env.config[what], *map(_parameters, types.values()))
            _check(what, config[what], _Known(types, keys, features))


def _check(what: str, settings: object, known: _Known) -> None:
    """Check the configuration of an observation or action, and of its parts."""
    if not isinstance(settings, Mapping):
        raise InputError(f"{what}: expected keys and values, got {shown(settings)}")
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
        _check(f"{what}.{place}", part, known)


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
