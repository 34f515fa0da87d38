"""A driver that ignores its observations: the control that every other driver must beat."""

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
    """A driver that always gives the same command.

    Attributes:
        observation: `{"type": "Scene"}`, see `behavexplor.data.scene`; its content is ignored.
        action: acceleration and steering, each in [-1, 1] over its range.
        policy_frequency: decisions per second, 10 Hz.

    Args:
        acceleration: constant acceleration [m/s2].
        steering: constant steering angle [rad], positive to the right.

    Raises:
        InputError: if a value is out of range.
    """

    observation: Mapping[str, Any] = OBSERVATION
    action: Mapping[str, Any] = ACTION
    policy_frequency: int = 10
    vectorized: bool = True

    def __init__(self, acceleration: float, steering: float) -> None:
        for name, value, (low, high) in (
            ("acceleration [m/s2]", acceleration, ACCELERATION_RANGE),
            ("steering angle [rad]", steering, STEERING_RANGE),
        ):
            if not low <= value <= high:
                raise InputError(f"The constant driver's {name} must be between {low:g} and {high:g}, got {value:g}")
        self._action = as_actions(np.array([[acceleration, steering]]))

    def predict(
        self,
        observation: NDArray[Any],
        state: Any = None,
        episode_start: NDArray[np.bool_] | None = None,  # noqa: ARG002
        deterministic: bool = True,  # noqa: ARG002
    ) -> tuple[Floats, Any]:
        """Return the same command for each ego, shape (B, 2); see `behavexplor.ads.interface.ADS`."""
        return np.repeat(self._action, len(observation), axis=0), state


def constant_driver(roadmap: RoadMap, variant: str = "") -> ConstantDriver:  # noqa: ARG001
    """Make the driver of a variant.

    Args:
        roadmap: ignored.
        variant: acceleration [m/s2], or acceleration and steering [rad]: "2" or "0,0.1"; `DEFAULT` if empty.

    Raises:
        InputError: if the variant is not one or two such numbers.
    """
    number = r"[-+]?\d*\.?\d+"
    if not re.fullmatch(rf"{number}(,{number})?", variant or DEFAULT):
        raise InputError(
            f"constant:{variant}: expected an acceleration [m/s2], or an acceleration and a steering angle [rad], "
            "such as constant:2,0.1"
        )
    acceleration, _, steering = (variant or DEFAULT).partition(",")
    return ConstantDriver(float(acceleration), float(steering or 0))
