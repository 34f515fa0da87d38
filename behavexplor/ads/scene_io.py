"""Observations, memory and actions of this package's drivers: scenes in, acceleration and steering angle out."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from behavexplor.data.array_types import Array, Bools, Floats
from behavexplor.data.scene import N_COLUMNS
from behavexplor.errors import InputError
from behavexplor.jit import kernel_in_place, kernel_inner

ACCELERATION_RANGE: Final = (-8.0, 4.0)  # [m/s2]
STEERING_RANGE: Final = (-0.6, 0.6)  # [rad], positive to the right
_LOW = np.array([ACCELERATION_RANGE[0], STEERING_RANGE[0]])
_SPAN = np.array([ACCELERATION_RANGE[1], STEERING_RANGE[1]]) - _LOW
RESOLUTION: Final = 1e-9  # step to which observations are rounded: last bits of a simulator do not matter

OBSERVATION: Final[Mapping[str, Any]] = MappingProxyType({"type": "Scene"})  # see `behavexplor.data.scene`
ACTION: Final[Mapping[str, Any]] = MappingProxyType(
    {"type": "ContinuousAction", "acceleration_range": list(ACCELERATION_RANGE), "steering_range": list(STEERING_RANGE)}
)


def as_scenes(observation: Array) -> Floats:
    """Return an observation as scenes, shape (B, 1 + n, 8), rounded to `RESOLUTION`.

    Raises:
        InputError: if the observation has another shape.
    """
    scenes = np.array(observation, dtype=np.float64, order="C")
    if scenes.ndim != 3 or scenes.shape[1] == 0 or scenes.shape[2] != N_COLUMNS:
        raise InputError(f"observation: expected shape (B, 1 + n, {N_COLUMNS}), got {scenes.shape}")
    _round(scenes.reshape(-1))
    return scenes


@kernel_in_place
def _round(numbers: Floats) -> None:
    for i in range(len(numbers)):
        numbers[i] = np.rint(numbers[i] / RESOLUTION) * RESOLUTION


def as_memory(state: Floats | None, episode_start: Bools | None, shape: tuple[int, int]) -> Floats:
    """Return the memory as a new, writable array of a shape (B, n): zeros at first, and in rows that begin an episode.

    `state` is None at first. `episode_start`, shape (B,), is True for rows that begin an episode; None if no row does.

    Raises:
        InputError: if an array has another shape.
    """
    memory = np.zeros(shape) if state is None else np.array(state, dtype=np.float64, order="C")
    if memory.shape != shape:
        raise InputError(f"state: expected shape {shape}, got {memory.shape}")
    if episode_start is not None:
        begins = np.asarray(episode_start, dtype=bool)
        if begins.shape != shape[:1]:
            raise InputError(f"episode_start: expected shape {shape[:1]}, got {begins.shape}")
        if np.count_nonzero(begins):  # faster than to set no row
            memory[begins] = 0.0
    return memory


def as_actions(commands: Floats) -> Floats:
    """Convert accelerations [m/s2] and steering angles [rad], shape (B, 2), to actions in [-1, 1] over their ranges."""
    actions: Floats = 2 * (commands - _LOW) / _SPAN - 1
    return actions


@kernel_inner
def fill_action(acceleration: float, steering: float, action: Floats) -> None:
    """Fill in the action of an acceleration [m/s2] and a steering angle [rad], as `as_actions` does."""
    action[0] = _as_share(acceleration, ACCELERATION_RANGE[0], ACCELERATION_RANGE[1])
    action[1] = _as_share(steering, STEERING_RANGE[0], STEERING_RANGE[1])


@kernel_inner
def _as_share(command: float, low: float, high: float) -> float:
    return 2 * (command - low) / (high - low) - 1
