"""What a driver of this package observes, remembers and commands: scenes, an acceleration and a steering angle."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behavexplor.data.scene import N_COLUMNS
from behavexplor.errors import InputError

Floats = NDArray[np.float64]

ACCELERATION_RANGE: Final = (-8.0, 4.0)  # [m/s2]
STEERING_RANGE: Final = (-0.6, 0.6)  # [rad], positive to the right
RESOLUTION: Final = 1e-9  # of what is observed, so that simulators that differ in the last bits see the same drive

OBSERVATION: Final[Mapping[str, Any]] = MappingProxyType({"type": "Scene"})  # see `behavexplor.data.scene`
ACTION: Final[Mapping[str, Any]] = MappingProxyType(
    {
        "type": "ContinuousAction",
        "acceleration_range": list(ACCELERATION_RANGE),
        "steering_range": list(STEERING_RANGE),
    }
)


def as_scenes(observation: NDArray[Any]) -> Floats:
    """What is observed, to `RESOLUTION`.

    Args:
        observation: scenes, shape (B, 1 + n, 8), see `behavexplor.data.scene`.

    Raises:
        InputError: if it has another shape.
    """
    scenes = np.asarray(observation, dtype=np.float64)
    if scenes.ndim != 3 or scenes.shape[1] == 0 or scenes.shape[2] != N_COLUMNS:
        raise InputError(f"observation: expected shape (B, 1 + n, {N_COLUMNS}), got {scenes.shape}")
    return np.ascontiguousarray(np.rint(scenes / RESOLUTION) * RESOLUTION)


def as_memory(state: Floats | None, episode_start: NDArray[np.bool_] | None, shape: tuple[int, int]) -> Floats:
    """A new array of what is remembered, which may be changed: zeros at first, and where an episode begins.

    Args:
        state: what the last call of `predict` returned; None at first.
        episode_start: whether a row begins an episode, shape (B,); None for no row.
        shape: (B, numbers that are remembered of each ego).

    Raises:
        InputError: if an array has another shape.
    """
    memory = np.zeros(shape) if state is None else np.array(state, dtype=np.float64, order="C")
    if memory.shape != shape:
        raise InputError(f"state: expected shape {shape}, got {memory.shape}")
    begins = np.zeros(len(memory), dtype=bool) if episode_start is None else np.asarray(episode_start, dtype=bool)
    if begins.shape != shape[:1]:
        raise InputError(f"episode_start: expected shape {shape[:1]}, got {begins.shape}")
    memory[begins] = 0.0
    return memory


def as_actions(commands: Floats) -> Floats:
    """Accelerations [m/s2] and steering angles [rad], shape (B, 2), as actions in [-1, 1] over their ranges."""
    low, high = np.array([ACCELERATION_RANGE, STEERING_RANGE]).T
    actions: Floats = 2 * (commands - low) / (high - low) - 1
    return actions
