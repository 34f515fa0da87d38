"""Decisions by a network's outputs, which are preferences of actions; and the tracker that drives by the decisions.

The probabilities of the actions are the softmax of the preferences. PPO and similar algorithms train a policy that
draws its actions with them. Drawn several times a second, the accelerations average out, so the deterministic driver
nearest to the one that was trained takes their mean. Taking the most probable action can make another driver: where
braking has 40 %, and two accelerations have 30 % each, it always brakes.
"""

import math
from typing import Final, NamedTuple

import numpy as np

from behavexplor.ads.learned.observation import lanes_beside
from behavexplor.ads.learned.route_table import Course
from behavexplor.ads.road.path import limit_at, project_on_path, row_at, steer
from behavexplor.ads.scene_io import ACCELERATION_RANGE
from behavexplor.data.array_types import Floats, Ints
from behavexplor.data.scene import EGO, SPEED, X, Y
from behavexplor.jit import kernel_inner

PERIOD: Final = 0.2  # time between decisions [s]
ACCELERATIONS: Final = (-6.0, -3.0, -1.0, 0.0, 2.0)  # [m/s2]
KEEP, LEFT, RIGHT, HOME = 0, 1, 2, 3  # lane choices: as before, one to the left, one to the right, the route's
N_LANE_CHOICES: Final = 4
N_ACTIONS: Final = len(ACCELERATIONS) * N_LANE_CHOICES  # action a is acceleration a % 5 and lane choice a // 5

SIDEWAYS: Final = 1.5  # lateral speed of the driven path in a lane change [m/s]
LAST_CHANGE: Final = 20.0  # least distance to the end of the lanes beside at which a change may begin [m]

WANTED: Final = 0  # offset of the wanted lane from the route [m]
DRIVEN: Final = 1  # offset of the driven path from the route, which moves towards the wanted offset [m]
STARTED: Final = 2  # 1 after the first decision of an episode
N_MEMORIES: Final = 3
MEAN, MOST_PROBABLE, DRAWN = 0, 1, 2  # ways to choose
ACCELERATION_TABLE: Final = np.array(ACCELERATIONS)


class Decisions(NamedTuple):
    """Decisions of a batch of egos."""

    accelerations: Floats  # wanted accelerations [m/s2], shape (B,)
    lanes: Ints  # lane choices: `KEEP`, `LEFT`, `RIGHT` or `HOME`, shape (B,)


def as_decisions(actions: Ints) -> Decisions:
    """Return the decisions of actions, indices of shape (B,)."""
    return Decisions(ACCELERATION_TABLE[actions % len(ACCELERATION_TABLE)], actions // len(ACCELERATION_TABLE))


@kernel_inner
def choose(preferences: Floats, accelerations: Floats, rule: int, share: float) -> tuple[float, int]:
    """Return the wanted acceleration [m/s2] and the lane choice of one ego.

    The rule `MEAN` takes the mean acceleration and the most probable lane choice; `MOST_PROBABLE` the most probable
    action, the first of equal ones; and `DRAWN` the action at `share`, in [0, 1), of the cumulative probabilities.

    `preferences` are the network's outputs, shape (N_ACTIONS,); `accelerations` has the acceleration of each action of
    one lane choice, shape (N_ACTIONS / N_LANE_CHOICES,) [m/s2].
    """
    if rule == MEAN:
        return _average(preferences, accelerations)
    action = _at_share(preferences, share) if rule == DRAWN else _greatest(preferences)
    return accelerations[action % len(accelerations)], action // len(accelerations)


@kernel_inner
def _average(preferences: Floats, table: Floats) -> tuple[float, int]:
    """Return the mean acceleration and the most probable lane choice."""
    top = preferences[_greatest(preferences)]
    total, acceleration, most, lane = 0.0, 0.0, 0.0, 0
    for choice in range(N_LANE_CHOICES):
        weight = 0.0
        for i in range(len(table)):
            part = math.exp(preferences[choice * len(table) + i] - top)
            weight += part
            acceleration += part * table[i]
        if weight > most:
            most, lane = weight, choice
        total += weight
    return acceleration / total, lane


@kernel_inner
def _at_share(preferences: Floats, share: float) -> int:
    """Return the action at a share of the cumulative probabilities."""
    top = preferences[_greatest(preferences)]
    total = 0.0
    for i in range(len(preferences)):
        total += math.exp(preferences[i] - top)
    left = share * total
    for i in range(len(preferences) - 1):
        left -= math.exp(preferences[i] - top)
        if left < 0.0:
            return i
    return len(preferences) - 1


@kernel_inner
def _greatest(preferences: Floats) -> int:
    best = 0
    for i in range(1, len(preferences)):
        if preferences[i] > preferences[best]:
            best = i
    return best


@kernel_inner
def begin(course: Course, scene: Floats, memory: Floats) -> None:
    """Begin an episode: the ego wants its route's lane, and drives from where it stands."""
    memory[WANTED] = 0.0
    memory[DRIVEN] = project_on_path(course.path, scene[EGO, X], scene[EGO, Y])[1]
    memory[STARTED] = 1.0


@kernel_inner
def track(course: Course, scene: Floats, wanted: float, choice: int, memory: Floats) -> tuple[float, float]:
    """Return acceleration [m/s2] and steering angle [rad] for a decision.

    The decision is the `wanted` acceleration [m/s2] and a lane choice. The scene has the shape (1 + n, 8), see
    `behavexplor.data.scene`. The ego's memory, shape (N_MEMORIES,), is changed in place.
    """
    station, offset = project_on_path(course.path, scene[EGO, X], scene[EGO, Y])
    row = row_at(course.path, station)
    _choose_lane(course, row, offset, choice, memory)
    change = SIDEWAYS * PERIOD * min(scene[EGO, SPEED] / 4.0, 1.0)
    memory[DRIVEN] += min(max(memory[WANTED] - memory[DRIVEN], -change), change)
    acceleration = _accelerate(course, scene, station, wanted)
    return acceleration, steer(course.path, scene, station, memory[DRIVEN])


@kernel_inner
def _choose_lane(course: Course, row: int, offset: float, choice: int, memory: Floats) -> None:
    """Choose the lane beside if it exists; near a junction, only the lane of the route."""
    if course.side_by_side[row] < LAST_CHANGE:
        if course.path.junction_start < math.inf:
            memory[WANTED] = 0.0
        return
    left, right = lanes_beside(course, row, offset)
    center = course.path.lane_width * round(offset / course.path.lane_width)
    if choice == LEFT and left > 0:
        memory[WANTED] = center - course.path.lane_width
    elif choice == RIGHT and right > 0:
        memory[WANTED] = center + course.path.lane_width
    elif choice == HOME:
        memory[WANTED] = 0.0


@kernel_inner
def _accelerate(course: Course, scene: Floats, station: float, wanted: float) -> float:
    """Limit the acceleration so that the ego keeps the speed limit, in curves too, and never reverses."""
    speed: float = scene[EGO, SPEED]
    limit: float = limit_at(course.path, station + speed * PERIOD)
    wanted = min(wanted, max((limit - speed) / PERIOD, -3.0))
    return max(wanted, -speed / PERIOD, ACCELERATION_RANGE[0])
