"""Check actions, and convert them to the commands of the kernels: acceleration and steering, or a maneuver.

What a maneuver does is in `lane_keeping.take_maneuver`.
"""

from collections.abc import Callable
from functools import partial
from types import SimpleNamespace
from typing import Any, TypeAlias

import numpy as np
from gymnasium import Space, spaces
from highway_env.envs.common.action import ActionType, ContinuousAction, DiscreteAction, DiscreteMetaAction
from numpy.typing import NDArray

from behavexplor.data.array_types import Array, Floats
from behavexplor.data.conventions import MANEUVERS
from behavexplor.envs.values import shown
from behavexplor.errors import InputError
from behavexplor.jit import compiled_for, kernel_in_place

Commands: TypeAlias = Callable[[Array], Floats]  # converts actions, shape (B, ...), to commands, shape (B, 2)


def make_commands(action_type: ActionType) -> Commands:
    """Return the function that converts an environment's actions to commands."""
    table = command_table(action_type)
    if table is not None:
        return partial(_looked_up, table)
    return _ContinuousCommands(action_type)


def command_table(action_type: ActionType) -> Floats | None:
    """Return the command of each discrete action, shape (actions, 2); None if the actions are continuous."""
    if isinstance(action_type, DiscreteMetaAction):
        return np.array([[MANEUVERS.index(name), 0.0] for _, name in sorted(action_type.actions.items())])
    if isinstance(action_type, DiscreteAction):
        return _discrete_commands(action_type)
    return None


def _looked_up(table: Floats, actions: Array) -> Floats:
    return np.asarray(table[np.asarray(actions, dtype=np.int64)])


def _discrete_commands(action_type: DiscreteAction) -> Floats:
    """Return the command that highway-env gives its vehicle for each action, shape (actions, 2)."""
    given: list[dict[str, float]] = []
    action_type.controlled_vehicle = SimpleNamespace(act=given.append)
    for action in range(action_type.space().n):
        action_type.act(action)
    action_type.controlled_vehicle = None
    return np.array([(float(command["acceleration"]), float(command["steering"])) for command in given])


class _ContinuousCommands:
    """Commands of continuous actions, as `ContinuousAction.get_action` computes them, in the actions' precision."""

    def __init__(self, action_type: ContinuousAction) -> None:
        steered, driven = action_type.lateral, action_type.longitudinal
        ranges = [action_type.acceleration_range] * driven + [action_type.steering_range] * steered
        self._scales = np.array([(low, high - low) for low, high in ranges], dtype=np.float64).T.copy()
        self._first = 0 if driven else 1  # column of the commands that the first number of an action determines
        self._clip = bool(action_type.clip)
        commands = np.zeros((1, 2))
        self._fill: Any = compiled_for(_fill_commands, commands, self._scales, self._clip, False, 0, commands)

    def __call__(self, actions: Array) -> Floats:
        if actions.dtype.kind == "f" and actions.dtype not in (np.float32, np.float64):
            return self._in_rare_precision(actions)
        commands = np.zeros((len(actions), 2))
        values = np.ascontiguousarray(actions, dtype=np.float64)
        self._fill(values, self._scales, self._clip, actions.dtype == np.float32, self._first, commands)
        return commands

    def _in_rare_precision(self, actions: NDArray[np.floating[Any]]) -> Floats:
        """Return the commands for actions in a precision that compiled functions do not know, such as half."""
        low, span = self._scales.astype(actions.dtype)
        commands = np.zeros((len(actions), 2))
        columns = slice(self._first, self._first + len(low))
        commands[:, columns] = low + ((actions.clip(-1, 1) if self._clip else actions) + 1) * span / 2
        return commands


@kernel_in_place
def _fill_commands(actions: Floats, scales: Floats, clip: bool, is_single: bool, first: int, commands: Floats) -> None:
    """Fill in the commands of actions, shape (B, numbers), computed in single precision if `is_single`.

    The rows of `scales` are the least command of each number and the width of its range. Number i determines the column
    `first + i` of the commands.
    """
    for b in range(len(actions)):
        for i in range(actions.shape[1]):
            action = actions[b, i]
            if clip:
                action = min(max(action, -1.0), 1.0)
            low, span = scales[0, i], scales[1, i]
            if is_single:
                one, two = np.float32(1.0), np.float32(2.0)
                commands[b, first + i] = np.float32(low) + (np.float32(action) + one) * np.float32(span) / two
            else:
                commands[b, first + i] = low + (action + 1.0) * span / 2.0


def check_actions(space: Space[Any], actions: Any) -> None:
    """Check that an action, or a batch of them, has the shape of its space and can be carried out.

    The space is a Discrete, MultiDiscrete or Box. Any finite number is accepted for a Box, even beyond its bounds.

    Raises:
        InputError: if the actions do not fit the space; the message says what was expected.
    """
    values = np.asarray(actions)
    fits = values.shape == space.shape
    if isinstance(space, spaces.Box):
        fits = fits and values.dtype.kind in "iuf" and bool(np.isfinite(values).all())
    elif isinstance(space, spaces.MultiDiscrete):  # `contains` takes as long as the decision of a vector environment
        fits = fits and values.dtype.kind in "iu"
        fits = fits and bool(((values >= space.start) & (values < space.start + space.nvec)).all())
    else:
        fits = fits and values.dtype.kind in "iu" and space.contains(values.astype(space.dtype))
    if not fits:
        raise InputError(f"actions: expected finite numbers of {space}, got {shown(actions)}")
