"""Check that the compiled engine can replace an environment of highway-env, or a subclass with another road or starts.

Each key of a configuration is reproduced, without effect on results, or refused by name.
"""

import warnings
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import highway_env.envs.common.observation as observations
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.utils import class_from_path
from pydantic import StrictStr

from behavexplor.envs import values
from behavexplor.envs.engine.state import IDM, LINEAR
from behavexplor.envs.engine.vehicle_parameters import kind_of
from behavexplor.envs.env_config import ACTIONS, check_type
from behavexplor.envs.source_gate import REWARDS, replaced
from behavexplor.envs.tasks.highway_tasks import KINDS, NUMBERS
from behavexplor.envs.tasks.task import TaskKind
from behavexplor.errors import InputError, ignored_key

OTHER_WAY = "use gymnasium.make_vec with vectorization_mode='sync' for highway-env's own"
DRAWING = frozenset(  # keys that change pictures only
    {
        "screen_width",
        "screen_height",
        "centering_position",
        "scaling",
        "show_trajectories",
        "render_agent",
        "offscreen_rendering",
        "real_time_rendering",
    }
)
ONLY = MappingProxyType({"manual_control": False, "controlled_vehicles": 1})  # keys with one supported value
READ: Mapping[str, values.Kind] = MappingProxyType(  # keys that are reproduced, besides observation, action and rewards
    {
        "simulation_frequency": values.COUNT,
        "policy_frequency": values.POSITIVE,
        "neighbour_vehicles_connected_lanes": values.FLAG,
        "other_vehicles_type": values.Kind("the path of a class of vehicles", StrictStr),
        "lanes_count": values.COUNT,
        "vehicles_count": values.WHOLE,
        "initial_lane_id": values.optional(values.WHOLE),
        "duration": values.POSITIVE,
        "ego_spacing": values.NOT_NEGATIVE,
        "vehicles_density": values.POSITIVE,
        "reward_speed_range": values.RANGE,
        "normalize_reward": values.FLAG,
        "offroad_terminal": values.FLAG,
    }
)
OBSERVATIONS = MappingProxyType(
    {
        "ExitObservation": observations.ExitObservation,
        "Kinematics": observations.KinematicObservation,
        "TimeToCollision": observations.TimeToCollisionObservation,
    }
)
# Methods that make the road and the first vehicles, which a subclass may replace.
STARTS = frozenset({"_reset", "_make_road", "_create_road", "_make_vehicles", "_create_vehicles"})
_CHANGEABLE = STARTS | {"__init__"}


def check_config(env_class: type[AbstractEnv], known_class: type[AbstractEnv], changes: object) -> None:
    """Check that the compiled engine reproduces a configuration, and warn of keys that highway-env ignores.

    `changes` are keys of the default configuration with other values. `known_class` is the class of highway-env whose
    rules the environment follows; only its own roads and starts read the keys that this class does not have.

    Raises:
        InputError: if a key is not supported, or a value is out of range. The message names the key.
    """
    if changes is not None and not isinstance(changes, Mapping):
        raise InputError(f"config: expected keys and values, got {values.shown(changes)}")
    default, kind = env_class.default_config(), KINDS[NUMBERS[known_class]]
    config = default | dict(changes or {})
    known = {*default, *kind.terms}
    own = set(default) - set(known_class.default_config())
    for key, value in config.items():
        if key not in known:
            warnings.warn(ignored_key(env_class.__name__, str(key), known), stacklevel=3)
        elif key not in own:
            _check_key(key, value, kind)
    _check_observation(config["observation"], kind, config["action"])
    _check_action(config["action"])
    _check_together(config, kind)


def _check_key(key: str, value: object, kind: TaskKind) -> None:
    if key in DRAWING or key in kind.unread or key in ("observation", "action"):
        return
    read = {**READ, **kind.keys}
    if key in ONLY:
        if value != ONLY[key]:
            raise InputError(
                f"{key}: the compiled engine supports {ONLY[key]} only, not {values.shown(value)}; {OTHER_WAY}"
            )
    elif key in read:
        read[key].check(key, value)
    elif key in kind.terms:
        values.NUMBER.check(key, value)
    else:
        raise InputError(f"{key}: the compiled engine does not know this key; {OTHER_WAY}")


def _check_observation(config: object, kind: TaskKind, action: object) -> None:
    name = config.get("type") if isinstance(config, Mapping) else None
    if isinstance(name, str) and name not in OBSERVATIONS:
        raise InputError(f"observation: the compiled engine knows {', '.join(OBSERVATIONS)}, not {name}; {OTHER_WAY}")
    settings = check_type("observation", config, OBSERVATIONS)
    if name == "ExitObservation" and not kind.has_exit:
        raise InputError("observation: an ExitObservation needs the lanes of the exit environment")
    if name == "TimeToCollision":
        if not isinstance(action, Mapping) or action.get("type") != "DiscreteMetaAction":
            raise InputError("The observation type TimeToCollision needs the action type DiscreteMetaAction")
        return
    if settings.get("vehicles_count", 5) < 2:
        raise InputError("observation.vehicles_count: must be at least 2; highway-env's observation of 1 has no shape")
    features = settings.get("features") or ()
    if len(set(features)) < len(features):
        raise InputError("observation.features: highway-env does not support a feature twice")


def _check_action(config: object) -> None:
    name = config.get("type") if isinstance(config, Mapping) else None
    if isinstance(name, str) and name not in ACTIONS:
        raise InputError(f"action: the compiled engine knows {', '.join(ACTIONS)}, not {name}; {OTHER_WAY}")
    settings = check_type("action", config, ACTIONS)
    if settings.get("dynamical"):
        raise InputError(f"action.dynamical: the compiled engine has no tire friction; {OTHER_WAY}")
    if not (settings.get("longitudinal", True) or settings.get("lateral", True)):
        raise InputError("action: at least one of longitudinal and lateral must be True")


def _check_together(config: Mapping[str, Any], kind: TaskKind) -> None:
    """Check what depends on several keys."""
    simulation, policy = config["simulation_frequency"], config["policy_frequency"]
    if simulation < policy:
        raise InputError(f"policy_frequency: {policy} must not exceed simulation_frequency {simulation}")
    kind.check(config)
    if kind.normalizes(config):
        worst, best = kind.reward_range(config)
        if worst == best:
            raise InputError(f"normalize_reward: the least and greatest reward of this config are both {worst:g}")
    _check_traffic(config["other_vehicles_type"])


def _check_traffic(path: str) -> None:
    try:
        found = class_from_path(path)
    except (ValueError, ImportError, AttributeError) as error:
        raise InputError(f"other_vehicles_type: there is no class {values.shown(path)}") from error
    if kind_of(found) not in (IDM, LINEAR):
        raise InputError(f"other_vehicles_type: the compiled engine knows vehicles that drive, not {path}; {OTHER_WAY}")


def known_class(env_class: type[AbstractEnv], *, rewards: bool = True) -> type[AbstractEnv]:
    """Return the class of highway-env whose rules an environment follows: itself, or one of its parents.

    With `rewards`, its rewards must be those of that class, too.

    Raises:
        InputError: if there is none, or the environment changes the rules. The message names the changed method.
    """
    known: type[AbstractEnv] | None = next((known for known in NUMBERS if issubclass(env_class, known)), None)
    if known is None:
        names = ", ".join(sorted(one.__name__ for one in NUMBERS))
        raise InputError(
            f"The compiled engine does not know {env_class.__name__}; it knows {names} and subclasses with other roads "
            f"and starts; use gymnasium.make_vec with vectorization_mode='sync'"
        )
    method = replaced(env_class, known, _CHANGEABLE if rewards else _CHANGEABLE | REWARDS)
    if method is not None:
        raise InputError(
            f"The compiled engine does not know the method {method}; use gymnasium.make_vec with "
            f"vectorization_mode='sync'"
        )
    return known


def has_own_starts(env_class: type[AbstractEnv]) -> bool:
    """Return whether an environment changes the road or the first vehicles of the class whose rules it follows."""
    known = known_class(env_class, rewards=False)
    return any(getattr(env_class, name, None) is not getattr(known, name, None) for name in STARTS)
