"""Check that the vector environment supports an environment, before it would silently behave differently."""

from typing import Any

from highway_env.envs.common.action import ContinuousAction, DiscreteAction, DiscreteMetaAction

from behavexplor.envs.driving import DrivingEnv
from behavexplor.envs.kinematics import Kinematics
from behavexplor.envs.scene_observation import SceneObservation
from behavexplor.envs.source_gate import replaced
from behavexplor.errors import InputError


def check_supported(env: DrivingEnv) -> None:
    """Check that the vector environment can replace an environment.

    Raises:
        InputError: if it cannot. The message names what is not supported.
    """
    rule = replaced(type(env), DrivingEnv, {"logical"})
    obstacle = f"the method {rule}" if rule else _odd_observation(env.observation_type) or _odd_action(env.action_type)
    if obstacle:
        raise InputError(
            f"The vector environment does not support {obstacle}; use gymnasium.make, or gymnasium.make_vec with "
            f"vectorization_mode='sync'"
        )


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
