"""Convert actions to the commands of the kernels: acceleration and steering, or the code of a maneuver."""

from collections.abc import Callable
from functools import partial
from types import SimpleNamespace
from typing import Any, TypeAlias

import numpy as np
from highway_env.envs.common.action import ActionType, DiscreteAction, DiscreteMetaAction
from numpy.typing import NDArray

from behavexplor.data.conventions import MANEUVERS

Floats = NDArray[np.float64]
Commands: TypeAlias = Callable[[NDArray[Any]], Floats]  # converts actions, shape (B, ...), to commands, shape (B, 2)


def make_commands(action_type: ActionType) -> Commands:
    """Return the function that converts an environment's actions to commands."""
    table = command_table(action_type)
    if table is not None:
        return partial(_looked_up, table)
    steered, driven = action_type.lateral, action_type.longitudinal
    ranges = [action_type.acceleration_range] * driven + [action_type.steering_range] * steered
    scales = np.array([(low, high - low) for low, high in ranges], dtype=np.float64).T
    columns = slice(0 if driven else 1, 2 if steered else 1)
    return partial(_continuous_commands, scales, columns, action_type.clip)


def command_table(action_type: ActionType) -> Floats | None:
    """Return the command of each discrete action, shape (actions, 2); None if the actions are continuous."""
    if isinstance(action_type, DiscreteMetaAction):
        return np.array([[MANEUVERS.index(name), 0.0] for _, name in sorted(action_type.actions.items())])
    if isinstance(action_type, DiscreteAction):
        return _discrete_commands(action_type)
    return None


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


def _continuous_commands(scales: Floats, columns: slice, clip: bool, actions: NDArray[Any]) -> Floats:
    """Compute `ContinuousAction.get_action` for a batch, in the precision of the actions, as highway-env does."""
    if clip:
        actions = np.minimum(np.maximum(actions, -1), 1)
    low, span = scales.astype(actions.dtype) if actions.dtype.kind == "f" else scales
    commands = np.zeros((len(actions), 2))
    commands[:, columns] = low + (actions + 1) * span / 2
    return commands
