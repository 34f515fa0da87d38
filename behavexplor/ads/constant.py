"""A driver that ignores its observations: the control that every other driver must beat."""

import re
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from behavexplor.ads.scene_io import ACCELERATION_RANGE, ACTION, OBSERVATION, STEERING_RANGE, as_actions
from behavexplor.data.array_types import Array, Bools, Floats, Ints
from behavexplor.data.conventions import MANEUVERS, with_meta_actions
from behavexplor.data.roadmap import RoadMap
from behavexplor.errors import InputError

DEFAULT: Final = "2,0"


class ConstantDriver:
    """A driver that always gives the same command.

    Args:
        acceleration: constant acceleration [m/s2].
        steering: constant steering angle [rad], positive to the right.

    Raises:
        InputError: if a value is out of range.
    """

    # `{"type": "Scene"}`, see `behavexplor.data.scene`; its content is ignored
    observation: Mapping[str, Any] = OBSERVATION
    action: Mapping[str, Any] = ACTION  # acceleration and steering, each in [-1, 1] over its range
    policy_frequency: int = 10  # decisions per second, 10 Hz
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
        observation: Array,
        state: Any = None,
        episode_start: Bools | None = None,  # noqa: ARG002
        deterministic: bool = True,  # noqa: ARG002
    ) -> tuple[Floats, Any]:
        """Return the same command for each ego, shape (B, 2); see `behavexplor.ads.interface.ADS`."""
        return np.repeat(self._action, len(observation), axis=0), state


class ConstantManeuver:
    """A driver that always chooses the same of highway-env's meta-actions, one of `MANEUVERS`."""

    vectorized: bool = True

    def __init__(self, maneuver: str) -> None:
        self._index = MANEUVERS.index(maneuver)

    def fitted(self, config: Mapping[str, Any]) -> dict[str, Any]:
        """Return an environment's configuration, changed so that this driver can drive in it."""
        return with_meta_actions(config)

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Bools | None = None,
        deterministic: bool = True,  # noqa: ARG002
    ) -> tuple[Ints, Any]:
        """Return the same meta-action for each ego, shape (B,); see `behavexplor.ads.interface.ADS`."""
        count = len(observation) if episode_start is None else len(episode_start)
        return np.full(count, self._index), state


def constant_driver(roadmap: RoadMap | None, variant: str = "") -> ConstantDriver | ConstantManeuver:
    """Make the driver of a variant.

    Args:
        roadmap: None in highway-env's own environments, the only ones in which meta-actions are possible.
        variant: acceleration [m/s2], or acceleration and steering [rad]: "2" or "0,0.1"; or one of highway-env's
            meta-actions, such as "SLOWER"; `DEFAULT` if empty.

    Raises:
        InputError: if the variant is neither one or two such numbers nor a meta-action, or is not possible there.
    """
    in_highway_env = roadmap is None
    if variant in MANEUVERS and not in_highway_env:
        raise InputError(
            f"constant:{variant} drives in highway-env's own environments only: use an acceleration [m/s2] here, such "
            f"as constant:2"
        )
    if variant in MANEUVERS:
        return ConstantManeuver(variant)
    if in_highway_env:
        raise InputError(
            "In an environment of highway-env, the constant driver repeats a meta-action, such as constant:SLOWER: "
            f"name one of {', '.join(MANEUVERS)}"
        )
    number = r"[-+]?\d*\.?\d+"
    if not re.fullmatch(rf"{number}(,{number})?", variant or DEFAULT):
        raise InputError(
            f"constant:{variant}: expected an acceleration [m/s2], or an acceleration and a steering angle [rad], "
            f"such as constant:2,0.1, or one of {', '.join(MANEUVERS)}"
        )
    acceleration, _, steering = (variant or DEFAULT).partition(",")
    return ConstantDriver(float(acceleration), float(steering or 0))
