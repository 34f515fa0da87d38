"""Recovery of the commands at every simulation step from a trace, and their playback."""

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behavexplor.data.array_types import Floats
from behavexplor.data.trace import Trace

MAX_ACCELERATION: Final = 10.0  # greatest commanded acceleration and deceleration [m/s2]
MAX_STEERING: Final = math.pi / 3  # greatest commanded steering angle to either side [rad]
MOVING: Final = 1e-3  # below this speed, the steering has no effect and cannot be recovered [m/s]

OBSERVATION: Final[Mapping[str, Any]] = MappingProxyType({"type": "Scene"})
ACTION: Final[Mapping[str, Any]] = MappingProxyType(
    {
        "type": "ContinuousAction",
        "acceleration_range": [-MAX_ACCELERATION, MAX_ACCELERATION],
        "steering_range": [-MAX_STEERING, MAX_STEERING],
    }
)


def frequency(trace: Trace) -> int:
    """Return the frequency of the recorded simulation steps [Hz]."""
    return round((len(trace.time) - 1) / trace.duration)


def recorded_commands(trace: Trace) -> Floats:
    """Recover the commands to highway-env's bicycle model at every step, for any ADS.

    This inverts `Vehicle.step` of highway-env.

    Returns:
        Accelerations [m/s2] and steering angles [rad] from each frame to the next, shape (T - 1, 2).
    """
    heading, velocity = trace.heading[:, 0], trace.velocity[:, 0]
    forward = velocity[:, 0] * np.cos(heading) + velocity[:, 1] * np.sin(heading)
    speed = np.copysign(np.hypot(velocity[:, 0], velocity[:, 1]), forward)
    direction = np.copysign(1.0, forward)
    course = np.arctan2(velocity[:, 1] * direction, velocity[:, 0] * direction)
    slip = np.remainder(course - heading + np.pi, 2 * np.pi) - np.pi
    step = np.diff(trace.time)
    moves = np.abs(speed) > MOVING
    turn = np.diff(heading) * trace.size[0, 0] / 2 / np.where(moves[:-1], speed[:-1] * step, np.inf)
    # An ego that has just stopped has no direction of motion. There, the change of its heading shows the steering.
    stopping = np.arcsin(np.clip(turn, -1.0, 1.0))
    used = np.where(moves[1:], slip[1:], stopping)
    return np.stack([np.diff(speed) / step, np.arctan(2 * np.tan(used))], axis=-1)


def as_actions(commands: Floats) -> Floats:
    """Scale accelerations [m/s2] and steering angles [rad], shape (..., 2), to values of `ACTION`."""
    return np.asarray(commands / (MAX_ACCELERATION, MAX_STEERING))


class Playback:
    """An ADS that gives recorded commands, one at each step, and then repeats the last one.

    Args:
        commands: accelerations [m/s2] and steering angles [rad], shape (T, 2).
    """

    def __init__(self, commands: Floats) -> None:
        self._actions = as_actions(commands)

    def predict(
        self,
        observation: Floats,
        state: int | None = None,
        episode_start: NDArray[np.bool_] | None = None,  # noqa: ARG002 - all egos begin together
        deterministic: bool = True,  # noqa: ARG002 - playback is always deterministic
    ) -> tuple[Floats, int]:
        """Return the command of this step for every ego. The state counts the steps."""
        step = 0 if state is None else state
        action = self._actions[min(step, len(self._actions) - 1)]
        return np.repeat(action[None], len(observation), axis=0), step + 1
