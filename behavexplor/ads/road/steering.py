"""Steering along a path by pure pursuit."""

import math
from typing import Final

from behavexplor.ads.road.path import Path, pose_on_path
from behavexplor.ads.scene_io import STEERING_RANGE
from behavexplor.data.array_types import Floats
from behavexplor.data.scene import EGO, HEADING, LENGTH, SPEED, X, Y
from behavexplor.jit import kernel_inner

LOOK_AHEAD: Final = 4.0  # distance of the pursued point at standstill [m]
LOOK_AHEAD_TIME: Final = 0.3  # growth of that distance with speed [s]


@kernel_inner
def steer(path: Path, scene: Floats, station: float, offset: float) -> float:
    """Return the steering angle [rad] by pure pursuit of a point ahead, at an offset from the path.

    The circle through that point is exact for highway-env's bicycle model.
    """
    x, y, along = pose_on_path(path, station + LOOK_AHEAD + LOOK_AHEAD_TIME * scene[EGO, SPEED])
    dx = x - math.sin(along) * offset - scene[EGO, X]
    dy = y + math.cos(along) * offset - scene[EGO, Y]
    bearing = math.atan2(dy, dx) - scene[EGO, HEADING]
    share = scene[EGO, LENGTH] / math.hypot(dx, dy)
    wanted = math.atan(2 * share * math.sin(bearing) / (1 + share * math.cos(bearing)))
    return min(max(wanted, STEERING_RANGE[0]), STEERING_RANGE[1])
