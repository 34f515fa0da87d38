"""Motion: the predicted motion of an NPC along its ways, as a careful planner and one with weaknesses predict it."""

import math
from typing import Final, NamedTuple

from behavexplor.ads.road.path import Path
from behavexplor.ads.rule.parameters import Numbers
from behavexplor.ads.rule.weaknesses import R1_1, R1_2, R1_4, R1_7
from behavexplor.data.array_types import Floats
from behavexplor.data.scene import ACCELERATION, EGO, HEADING, LENGTH, PRESENT, SPEED, WIDTH, X, Y
from behavexplor.jit import kernel_inner

TWO_PI = 2 * math.pi
MARGIN: Final = 1e-6  # much more than the share by which roundings change a product
NARROW: Final = 0.7  # sine of half the angular width below which vehicles in opposite half-planes do not overlap
MOVES: Final = 0.05  # speed above which a vehicle moves [m/s]
SUDDEN: Final = 2.0  # acceleration or braking beyond which a change of speed is sudden [m/s2]
LARGE: Final = 7.0  # length above which a vehicle is large [m]
CAR_LENGTH, CAR_WIDTH = 4.6, 1.9  # size of a large vehicle as seen at severity 1 (R1-7) [m]


@kernel_inner
def hidden_share(scene: Floats, row: int) -> float:
    """Return the hidden share of a vehicle's angular width, as seen from the ego's center.

    It is the largest share that a single nearer vehicle covers.
    """
    most, distance = 0.0, _distance(scene, row)
    for other in range(EGO + 1, len(scene)):
        if other == row or scene[other, PRESENT] == 0.0 or _is_apart(scene, row, other):
            continue
        if _distance(scene, other) < distance:
            most = max(most, _covered_share(scene, row, other))
    return most


@kernel_inner
def _distance(scene: Floats, row: int) -> float:
    return math.hypot(scene[row, X] - scene[EGO, X], scene[row, Y] - scene[EGO, Y])


@kernel_inner
def _is_apart(scene: Floats, row: int, other: int) -> bool:
    """Return whether two vehicles are surely in different directions from the ego. It takes no slow functions."""
    x, y = scene[row, X] - scene[EGO, X], scene[row, Y] - scene[EGO, Y]
    other_x, other_y = scene[other, X] - scene[EGO, X], scene[other, Y] - scene[EGO, Y]
    radius = (scene[row, LENGTH] + scene[row, WIDTH]) / 2  # an upper bound of half the diagonal
    other_radius = (scene[other, LENGTH] + scene[other, WIDTH]) / 2
    widths = radius * (abs(other_x) + abs(other_y)) + other_radius * (abs(x) + abs(y))
    if abs(x * other_y - y * other_x) > (1.0 + MARGIN) * widths:
        return True
    if x * other_x + y * other_y >= 0.0:
        return False
    widest = max(
        radius * radius / (x * x + y * y), other_radius * other_radius / (other_x * other_x + other_y * other_y)
    )
    return bool(widest < NARROW * NARROW)


@kernel_inner
def _covered_share(scene: Floats, row: int, other: int) -> float:
    """Return the share of a vehicle's angular width that another one covers, negative with a gap between them."""
    bearing, low, high = bearings(scene, row)
    middle, other_low, other_high = bearings(scene, other)
    away = (middle - bearing + math.pi) % TWO_PI - math.pi
    covered = min(high, away + other_high) - max(low, away + other_low)
    return covered / (high - low)


@kernel_inner
def bearings(scene: Floats, row: int) -> tuple[float, float, float]:
    """Return the bearing of a vehicle's center from the ego's center [rad], and the range of its corners' bearings.

    The range is the least and the greatest bearing of a corner relative to that of the center [rad].

    Args:
        scene: scene, see `behavexplor.data.scene`.
        row: row of the vehicle.
    """
    dx, dy = scene[row, X] - scene[EGO, X], scene[row, Y] - scene[EGO, Y]
    bearing = math.atan2(dy, dx)
    cos, sin = math.cos(scene[row, HEADING]), math.sin(scene[row, HEADING])
    low, high = math.inf, -math.inf
    for along in (-0.5 * scene[row, LENGTH], 0.5 * scene[row, LENGTH]):
        for across in (-0.5 * scene[row, WIDTH], 0.5 * scene[row, WIDTH]):
            corner = math.atan2(dy + along * sin + across * cos, dx + along * cos - across * sin)
            away = (corner - bearing + math.pi) % TWO_PI - math.pi
            low, high = min(low, away), max(high, away)
    return bearing, low, high


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
