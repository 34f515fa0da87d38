"""Check that the vector environment supports an environment, before it would silently behave differently."""

from types import FunctionType
from typing import Any

from highway_env.envs.common.action import ContinuousAction, DiscreteAction, DiscreteMetaAction

from behavexplor.envs.driving import DrivingEnv
from behavexplor.envs.kinematics import Kinematics
from behavexplor.envs.scene_observation import SceneObservation
from behavexplor.errors import InputError

_CHANGEABLE = {"logical", "default_config"}  # a subclass may redefine these without changing any rule


def check_supported(env: DrivingEnv) -> None:
    """Check that the vector environment can replace an environment.

    Raises:
        InputError: if it cannot; the message names what is not supported.
    """
    obstacle = _changed_rule(type(env)) or _odd_observation(env.observation_type) or _odd_action(env.action_type)
    if obstacle:
        raise InputError(
            f"The vector environment does not support {obstacle}; use gymnasium.make, or gymnasium.make_vec with "
            f"vectorization_mode='sync'"
        )


def _changed_rule(env_class: type[DrivingEnv]) -> str | None:
    for base in env_class.__mro__[: env_class.__mro__.index(DrivingEnv)]:
        for name, value in vars(base).items():
            is_method = isinstance(value, FunctionType | classmethod | staticmethod | property)
            if is_method and hasattr(DrivingEnv, name) and name not in _CHANGEABLE:
                return f"the method {base.__name__}.{name}"
    return None


def _odd_observation(observation: Any) -> str | None:
    if type(observation) is SceneObservation:
        return None
    if type(observation) is not Kinematics:
        return f"the observation {type(observation).__name__}"
    return "the order 'shuffled' of the Kinematics observation" if observation.order == "shuffled" else None


def _odd_action(action: Any) -> str | None:
    if type(action) is DiscreteMetaAction:
        return None
    if type(action) not in (ContinuousAction, DiscreteAction):
        return f"the action {type(action).__name__}"
    return f"dynamical vehicles in {type(action).__name__}" if action.dynamical else None
