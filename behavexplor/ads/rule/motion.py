"""Motion: the predicted motion of an NPC along its ways, as a careful planner and one with weaknesses predict it."""

import math
from typing import Final, NamedTuple

from behavexplor.ads.road.path import Path
from behavexplor.ads.rule.occlusion import hidden_share
from behavexplor.ads.rule.parameters import Numbers
from behavexplor.ads.rule.weaknesses import R1_1, R1_2, R1_4, R1_7
from behavexplor.data.array_types import Floats
from behavexplor.data.scene import ACCELERATION, EGO, LENGTH, SPEED, WIDTH, X, Y
from behavexplor.jit import kernel_inner

MOVES: Final = 0.05  # speed above which a vehicle moves [m/s]
SUDDEN: Final = 2.0  # acceleration or braking beyond which a change of speed is sudden [m/s2]
LARGE: Final = 7.0  # length above which a vehicle is large [m]
CAR_LENGTH, CAR_WIDTH = 4.6, 1.9  # size of a large vehicle as seen at severity 1 (R1-7) [m]


class Motion(NamedTuple):
    """Predicted motion and size of an NPC along its ways.

    Attributes:
        speed: present speed [m/s].
        acceleration: present acceleration [m/s2].
        memory: time for which the acceleration may go on [s].
        limit: greatest speed [m/s].
        length: length of the box [m].
        width: width of the box [m].
        turning_length: length of the box on curves [m].
        turning_width: width of the box on curves [m].
    """

    speed: float
    acceleration: float
    memory: float
    limit: float
    length: float
    width: float
    turning_length: float
    turning_width: float


@kernel_inner
def true_motion(path: Path, scene: Floats, row: int, p: Numbers) -> Motion:
    """Return an NPC's motion as a careful planner predicts it."""
    speed = max(scene[row, SPEED], 0.0)
    length, width = scene[row, LENGTH], scene[row, WIDTH]
    limit = max(path.speed_limit, speed)
    return Motion(speed, scene[row, ACCELERATION], p.acceleration_memory, limit, length, width, length, width)


@kernel_inner
def _is_hidden(scene: Floats, row: int, p: Numbers) -> bool:
    """Return whether a vehicle counts as hidden (weakness R1-1)."""
    if math.hypot(scene[row, X] - scene[EGO, X], scene[row, Y] - scene[EGO, Y]) < p.occlusion_beyond:
        return False
    return bool(hidden_share(scene, row) > 1.0 - p.occlusion)


@kernel_inner
def weaknesses_of_motion(scene: Floats, row: int, true: Motion, p: Numbers) -> int:
    """Return the bits of the weaknesses of prediction whose gates an NPC opens: R1-1, R1-2, R1-4 and R1-7."""
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


@kernel_inner
def false_motion(true: Motion, weak: int, p: Numbers) -> Motion:
    """Return an NPC's motion as a planner with weaknesses predicts it.

    Args:
        true: motion as a careful planner predicts it.
        weak: bits of the weaknesses whose gates the NPC opens.
        p: parameters of the planner.
    """
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
