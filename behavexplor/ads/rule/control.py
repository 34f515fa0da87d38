"""Control: steering and acceleration for highway-env's bicycle model, within limits of their change."""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behavexplor.ads.rule.parameters import Numbers
from behavexplor.ads.rule.path import Path, pose_on_path
from behavexplor.compiled import kernel
from behavexplor.scene import EGO, HEADING, LENGTH, SPEED, X, Y

Floats = NDArray[np.float64]

ACCELERATION_RANGE: Final = (-8.0, 4.0)  # [m/s2]
STEERING_RANGE: Final = (-0.6, 0.6)  # [rad]
PERIOD: Final = 0.1  # between two decisions [s]


@kernel
def steer(path: Path, scene: Floats, station: float, last: float, p: Numbers) -> float:
    """Steering angle [rad] by pure pursuit: the circle that leads through a point ahead on the path.

    The bicycle model turns about its centre with sin(slip) = length / (2 radius) and tan(steering) = 2 tan(slip),
    and moves along heading + slip. Solved for the slip, the circle through the point is exact.
    """
    x, y, _ = pose_on_path(path, station + p.look_ahead + p.look_ahead_time * scene[EGO, SPEED])
    ahead, aside = x - scene[EGO, X], y - scene[EGO, Y]
    bearing = math.atan2(aside, ahead) - scene[EGO, HEADING]
    share = scene[EGO, LENGTH] / math.hypot(ahead, aside)
    wanted = math.atan(2 * share * math.sin(bearing) / (1 + share * math.cos(bearing)))
    change = p.steering_rate * PERIOD
    wanted = min(max(wanted, last - change), last + change)
    return min(max(wanted, STEERING_RANGE[0]), STEERING_RANGE[1])


@kernel
def accelerate(wanted: float, last: float, speed: float, at_once: bool, p: Numbers) -> float:
    """Acceleration [m/s2] within the limits of its change and of the vehicle; never into reverse."""
    change = (p.emergency_jerk if at_once else p.jerk) * PERIOD
    wanted = min(max(wanted, last - change), last + change)
    wanted = min(max(wanted, ACCELERATION_RANGE[0]), ACCELERATION_RANGE[1])
    return max(wanted, -speed / PERIOD)
