"""Configurations of highway-env, and which of them fits the spaces of a policy."""

from collections.abc import Mapping
from math import isqrt
from types import MappingProxyType
from typing import Any, Final

import gymnasium
import yaml

# Source: highway-env 1.12, `default_config` of its environments.
_FEATURES = {axis: [-100, 100] for axis in ("x", "y")} | {axis: [-20, 20] for axis in ("vx", "vy")}
_POSE = ["presence", "x", "y", "vx", "vy"]
_CROSSING = {"type": "Kinematics", "features_range": _FEATURES, "absolute": True}
_SPEEDS = [0, 4.5, 9]
_ANGLE = 1.0471975511965976  # 60 degrees

HIGHWAY_ENVIRONMENTS: Final[Mapping[str, Mapping[str, Any]]] = MappingProxyType(
    {
        "highway-v0": {
            "observation": {"type": "Kinematics", "vehicles_count": 5},
            "action": {"type": "DiscreteMetaAction"},
            "policy_frequency": 1,
            "simulation_frequency": 15,
        },
        "intersection-v0": {
            "observation": {**_CROSSING, "vehicles_count": 15, "features": [*_POSE, "cos_h", "sin_h"]},
            "action": {"type": "DiscreteMetaAction", "lateral": False, "target_speeds": _SPEEDS},
            "policy_frequency": 1,
            "simulation_frequency": 15,
        },
        "intersection-v1": {
            "observation": {**_CROSSING, "vehicles_count": 5, "features": [*_POSE, "long_off", "lat_off", "ang_off"]},
            "action": {"type": "ContinuousAction", "steering_range": [-_ANGLE, _ANGLE], "dynamical": True},
            "policy_frequency": 1,
            "simulation_frequency": 15,
        },
        "parking-v0": {
            "observation": {
                "type": "KinematicsGoal",
                "features": ["x", "y", "vx", "vy", "cos_h", "sin_h"],
                "scales": [100, 100, 5, 5, 1, 1],
                "normalize": False,
            },
            "action": {"type": "ContinuousAction"},
            "policy_frequency": 5,
            "simulation_frequency": 15,
        },
        "lane-keeping-v0": {
            "observation": {"type": "AttributesObservation", "attributes": ["state", "derivative", "reference_state"]},
            "action": {
                "type": "ContinuousAction",
                "steering_range": [-_ANGLE, _ANGLE],
                "longitudinal": False,
                "lateral": True,
                "dynamical": True,
            },
            "policy_frequency": 10,
            "simulation_frequency": 10,
        },
    }
)
_SPACES: dict[str, tuple[Any, Any]] = {  # of each environment, as told by `_form` and `_commands`
    "highway-v0": ((5, 5), 5),
    "intersection-v0": ((15, 7), 3),
    "intersection-v1": ((5, 8), (2,)),
    "parking-v0": (dict.fromkeys(("achieved_goal", "desired_goal", "observation"), (6,)), (2,)),
    "lane-keeping-v0": (dict.fromkeys(("derivative", "reference_state", "state"), (4, 1)), (1,)),
}
_OTHER_AXIS: dict[Any, str] = {  # what has the same spaces as the guess in `_action`
    3: " (or with `longitudinal: false` instead of `lateral: false`, if it only changes lanes)",
    (1,): " (or with `lateral: false` instead of `longitudinal: false`, if it only accelerates)",
}
_KINEMATICS = {5: _POSE, 7: [*_POSE, "cos_h", "sin_h"]}  # features by their number


def how_to_fit(observation_space: gymnasium.Space[Any], action_space: gymnasium.Space[Any]) -> str:
    """Return a sentence that tells the user how to give an environment the spaces of a policy."""
    name, config = fitting_config(observation_space, action_space)
    if isinstance(observation_space, gymnasium.spaces.Dict):  # other environments have no goals or references
        example = f", as those of highway-env's {name} are" if name else ""
        return f"The policy needs an environment whose observations are such dictionaries{example}"
    where = "in a YAML file beside the policy (model.yaml beside model.zip), or as attributes of your driver"
    flow = yaml.safe_dump(config, default_flow_style=True, sort_keys=False, width=10_000).strip()
    if unknown := [f"`{key}`" for key in ("observation", "action") if key not in config]:
        known = f"; the other one can be {flow}" if config else ""
        return f"Give highway-env's {' and '.join(unknown)} configuration of the training {where}{known}"
    hint = f" (highway-env's {name})" if name else ""
    other = "" if name else _OTHER_AXIS.get(_commands(action_space), "")
    if len(observation_space.shape or ()) == 1:
        other += " (or, if observations were stacked, fewer vehicles, and how many were stacked as `frame_stack`)"
    return f"A configuration that fits{hint} can be given {where}: {flow}{other}"


def fitting_config(
    observation_space: gymnasium.Space[Any], action_space: gymnasium.Space[Any]
) -> tuple[str, dict[str, Any]]:
    """Return the environment of highway-env that has a policy's spaces by default, and a configuration with them.

    The name is "" if there is no such environment. The configuration has the keys `observation` and
    `action`, as far as the spaces determine them, and, if there is a name, the frequencies.
    """
    commands = _commands(action_space)
    for name, spaces in _SPACES.items():
        if spaces == (_form(observation_space), commands):
            return name, dict(HIGHWAY_ENVIRONMENTS[name])
    guesses = {"observation": _observation(observation_space.shape or ()), "action": _action(commands)}
    return "", {key: guess for key, guess in guesses.items() if guess}


def _commands(space: gymnasium.Space[Any]) -> Any:
    """Return the number of actions to choose from, or the shape of an action."""
    return int(space.n) if isinstance(space, gymnasium.spaces.Discrete) else space.shape


def _form(space: gymnasium.Space[Any]) -> Any:
    """Return the shape of a space's values, or the shapes of their arrays by key."""
    if isinstance(space, gymnasium.spaces.Dict):
        return {key: part.shape for key, part in space.items()}
    return space.shape


def _observation(shape: tuple[int, ...]) -> dict[str, Any]:
    """Return a configuration of observations of this shape; empty if none is known."""
    if len(shape) == 1:  # the rows of vehicles one after the other, with the least number of features that is possible
        widths = [width for width in _KINEMATICS if shape[0] % width == 0]
        return _observation((shape[0] // widths[0], widths[0])) if widths else {}
    if len(shape) == 2 and shape[1] in _KINEMATICS:
        return {"type": "Kinematics", "vehicles_count": shape[0], "features": _KINEMATICS[shape[1]]}
    if len(shape) == 2 and shape[1] == 2:
        return {"type": "LidarObservation", "cells": shape[0]}
    if shape == (3, 3, 10):
        return {"type": "TimeToCollision"}
    return {}


def _action(commands: int | tuple[int, ...] | None) -> dict[str, Any]:
    """Return a configuration of actions, by their number or shape; empty if none is known."""
    known: dict[Any, dict[str, Any]] = {
        5: {"type": "DiscreteMetaAction"},
        3: {"type": "DiscreteMetaAction", "lateral": False},
        (2,): {"type": "ContinuousAction"},
        (1,): {"type": "ContinuousAction", "longitudinal": False},
    }
    per_axis = isqrt(commands) if isinstance(commands, int) else 0
    if commands not in known and per_axis > 1 and per_axis**2 == commands:
        return {"type": "DiscreteAction", "actions_per_axis": per_axis}
    return known.get(commands, {})
