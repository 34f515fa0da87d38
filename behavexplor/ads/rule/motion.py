"""Motion: what an NPC is predicted to do along its ways, and what a planner with weaknesses makes of it."""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from behavexplor.ads.road.path import Path
from behavexplor.ads.rule.occlusion import hidden_share
from behavexplor.ads.rule.parameters import Numbers
from behavexplor.ads.rule.weaknesses import R1_1, R1_2, R1_4, R1_7
from behavexplor.data.scene import ACCELERATION, EGO, LENGTH, SPEED, WIDTH, X, Y
from behavexplor.jit import kernel_in_place

Floats = NDArray[np.float64]

MOVES: Final = 0.05  # faster than this a vehicle does not stand [m/s]
SUDDEN: Final = 2.0  # a change of speed beyond this is a sudden one [m/s2]
LARGE: Final = 7.0  # vehicles longer than this are large [m]
CAR_LENGTH, CAR_WIDTH = 4.6, 1.9  # what they are taken for [m]


class Motion(NamedTuple):
    """What an NPC is predicted to do along its ways, and with which size.

    Attributes:
        speed: [m/s].
        acceleration: [m/s2].
        memory: how long the acceleration may go on [s].
        limit: of the speed [m/s].
        length: of its box [m].
        width: [m].
        turning_length: of its box on curves [m].
        turning_width: [m].
    """

    speed: float
    acceleration: float
    memory: float
    limit: float
    length: float
    width: float
    turning_length: float
    turning_width: float


@kernel_in_place
def true_motion(path: Path, scene: Floats, row: int, p: Numbers) -> Motion:
    """An NPC's motion as a careful planner predicts it."""
    speed = max(scene[row, SPEED], 0.0)
    length, width = scene[row, LENGTH], scene[row, WIDTH]
    limit = max(path.speed_limit, speed)
    return Motion(speed, scene[row, ACCELERATION], p.acceleration_memory, limit, length, width, length, width)


@kernel_in_place
def _is_hidden(scene: Floats, row: int, p: Numbers) -> bool:
    """Whether a vehicle counts as hidden (weakness R1-1)."""
    if math.hypot(scene[row, X] - scene[EGO, X], scene[row, Y] - scene[EGO, Y]) < p.occlusion_beyond:
        return False
    return bool(hidden_share(scene, row) > 1.0 - p.occlusion)


@kernel_in_place
def weaknesses_of_motion(scene: Floats, row: int, true: Motion, p: Numbers) -> int:
    """Bits of the weaknesses of prediction whose gates an NPC opens: R1-1, R1-2, R1-4 and R1-7."""
    bits = 0
    if true.speed > MOVES:
        if p.occlusion > 0.0 and _is_hidden(scene, row, p):
            bits |= R1_1
        if true.speed < p.static_speed:
            bits |= R1_2
    if p.weak_braking > 0.0 and abs(true.acceleration) > SUDDEN:
        bits |= R1_4
    if p.narrow_bus > 0.0 and true.length > LARGE:
        bits |= R1_7
    return bits


@kernel_in_place
def false_motion(true: Motion, weak: int, p: Numbers) -> Motion:
    """An NPC's motion as a planner with weaknesses predicts it, given the bits of those whose gates it opens."""
    if weak == 0:
        return true
    speed, acceleration, memory = true.speed, true.acceleration, true.memory
    length, width = true.length, true.width
    if weak & (R1_1 | R1_2):
        speed = acceleration = 0.0
    if weak & R1_4:
        memory = 0.0
    if weak & R1_7:
        length -= p.narrow_bus * (length - CAR_LENGTH)
        width -= p.narrow_bus * (width - CAR_WIDTH)
    return Motion(speed, acceleration, memory, true.limit, true.length, true.width, length, width)
