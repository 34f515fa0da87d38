"""What the compiled engine supports of an environment with scripted vehicles."""

from typing import Any

from highway_env.envs.common.action import ContinuousAction, DiscreteAction, DiscreteMetaAction

from behavexplor.envs.kinematics import Kinematics
from behavexplor.envs.scene_observation import SceneObservation
from behavexplor.envs.source_gate import replaced


def odd_method(env: Any, known: type) -> str | None:
    """Return a method that an environment's class overrides; None if there is none.

    Args:
        env: the environment.
        known: the class whose methods the engine stands for.
    """
    rule = replaced(type(env), known, {"logical"})
    return rule and f"the method {rule}"


def odd_observation(observation: Any) -> str | None:
    """Return what the engine does not support of an observation; None if there is nothing."""
    if type(observation) is SceneObservation:
        return None
    if type(observation) is not Kinematics:
        return f"the observation {type(observation).__name__}"
    return "the order 'shuffled' of the Kinematics observation" if observation.order == "shuffled" else None


def odd_action(action: Any) -> str | None:
    """Return what the engine does not support of an action; None if there is nothing."""
    if type(action) is DiscreteMetaAction:
        return None
    if type(action) not in (ContinuousAction, DiscreteAction):
        return f"the action {type(action).__name__}"
    return f"dynamical vehicles in {type(action).__name__}" if action.dynamical else None
