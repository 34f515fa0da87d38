"""What a driver of this package observes and commands: scenes, and an acceleration and a steering angle."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

ACCELERATION_RANGE: Final = (-8.0, 4.0)  # [m/s2]
STEERING_RANGE: Final = (-0.6, 0.6)  # [rad], positive to the right

OBSERVATION: Final[Mapping[str, Any]] = MappingProxyType({"type": "Scene"})  # see `behavexplor.scene`
ACTION: Final[Mapping[str, Any]] = MappingProxyType(
    {
        "type": "ContinuousAction",
        "acceleration_range": list(ACCELERATION_RANGE),
        "steering_range": list(STEERING_RANGE),
    }
)


def as_actions(commands: Floats) -> Floats:
    """Accelerations [m/s2] and steering angles [rad], shape (B, 2), as actions in [-1, 1] over their ranges."""
    low, high = np.array([ACCELERATION_RANGE, STEERING_RANGE]).T
    actions: Floats = 2 * (commands - low) / (high - low) - 1
    return actions
