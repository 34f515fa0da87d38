"""A driver that looks at nothing: the control that any other must beat."""

import re
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behavexplor.ads.scene_io import ACCELERATION_RANGE, ACTION, OBSERVATION, STEERING_RANGE, as_actions
from behavexplor.data.roadmap import RoadMap
from behavexplor.errors import InputError

Floats = NDArray[np.float64]

DEFAULT: Final = "2,0"


class ConstantDriver:
    """Always commands the same.

    Attributes:
        observation: `{"type": "Scene"}`, see `behavexplor.data.scene`; it is not looked at.
        action: acceleration and steering, each in [-1, 1] over its range.
        policy_frequency: 10 Hz.

    Args:
        acceleration: [m/s2].
        steering: [rad], positive to the right.

    Raises:
        InputError: if a value is out of its range.
    """

    observation: Mapping[str, Any] = OBSERVATION
    action: Mapping[str, Any] = ACTION
    policy_frequency: int = 10
    vectorized: bool = True

    def __init__(self, acceleration: float, steering: float) -> None:
        for name, value, (low, high) in (
            ("accelerates", acceleration, ACCELERATION_RANGE),
            ("steers", steering, STEERING_RANGE),
        ):
            if not low <= value <= high:
                raise InputError(f"A constant driver {name} between {low:g} and {high:g}, got {value:g}")
        self._action = as_actions(np.array([[acceleration, steering]]))

    def predict(
        self,
        observation: NDArray[Any],
        state: Any = None,
        episode_start: NDArray[np.bool_] | None = None,  # noqa: ARG002
        deterministic: bool = True,  # noqa: ARG002
    ) -> tuple[Floats, Any]:
        """The same command for each ego, shape (B, 2); see `behavexplor.ads.interface.ADS`."""
        return np.repeat(self._action, len(observation), axis=0), state


def constant_driver(roadmap: RoadMap, variant: str = "") -> ConstantDriver:  # noqa: ARG001
    """The driver of a variant.

    Args:
        roadmap: not looked at.
        variant: acceleration [m/s2], or acceleration and steering [rad]: "2" or "0,0.1"; `DEFAULT` if empty.

    Raises:
        InputError: if it is no such numbers.
    """
    number = r"[-+]?\d*\.?\d+"
    if not re.fullmatch(rf"{number}(,{number})?", variant or DEFAULT):
        raise InputError(
            f"constant:{variant} must be an acceleration, or an acceleration and a steering angle: constant:2,0.1"
        )
    acceleration, _, steering = (variant or DEFAULT).partition(",")
    return ConstantDriver(float(acceleration), float(steering or 0))
