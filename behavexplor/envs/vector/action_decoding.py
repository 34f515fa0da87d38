"""Convert actions to the commands of the kernels: acceleration and steering, or the code of a maneuver."""

from collections.abc import Callable
from functools import partial
from types import SimpleNamespace
from typing import Any, TypeAlias

import numpy as np
from highway_env.envs.common.action import ActionType, DiscreteAction, DiscreteMetaAction
from highway_env.utils import lmap
from numpy.typing import NDArray

from behavexplor.data.conventions import MANEUVERS

Floats = NDArray[np.float64]
Commands: TypeAlias = Callable[[NDArray[Any]], Floats]  # converts actions, shape (B, ...), to commands, shape (B, 2)


def make_commands(action_type: ActionType) -> Commands:
    """Return the function that converts an environment's actions to commands."""
    if isinstance(action_type, DiscreteMetaAction):
        codes = [[MANEUVERS.index(name), 0.0] for _, name in sorted(action_type.actions.items())]
        return partial(_looked_up, np.array(codes))
    if isinstance(action_type, DiscreteAction):
        return partial(_looked_up, _discrete_commands(action_type))
    return partial(
        _continuous_commands,
        clip=action_type.clip,
        acceleration_range=action_type.acceleration_range if action_type.longitudinal else None,
        steering_range=action_type.steering_range if action_type.lateral else None,
    )


def _looked_up(table: Floats, actions: NDArray[Any]) -> Floats:
    return np.asarray(table[np.asarray(actions, dtype=np.int64)])


def _discrete_commands(action_type: DiscreteAction) -> Floats:
    """Return the command that highway-env gives its vehicle for each action, shape (actions, 2)."""
    given: list[dict[str, float]] = []
    action_type.controlled_vehicle = SimpleNamespace(act=given.append)
    for action in range(action_type.space().n):
        action_type.act(action)
    action_type.controlled_vehicle = None
    return np.array([(float(command["acceleration"]), float(command["steering"])) for command in given])


def _continuous_commands(
    actions: NDArray[Any],
    *,
    clip: bool,
    acceleration_range: tuple[float, float] | None,
    steering_range: tuple[float, float] | None,
) -> Floats:
    """Compute `ContinuousAction.get_action` for a batch, in the precision of the actions, as highway-env does."""
    commands = np.zeros((len(actions), 2))
    if clip:
        actions = np.clip(actions, -1, 1)
    if acceleration_range is not None:
        commands[:, 0] = lmap(actions[:, 0], [-1, 1], acceleration_range)
    if steering_range is not None:
        commands[:, 1] = lmap(actions[:, -1], [-1, 1], steering_range)
    return commands
