"""Decisions for the outputs of a policy's network, which are the preferences of its actions.

The probabilities of the actions are the softmax of the preferences. PPO and similar algorithms train a policy that
draws its actions with them. Drawn several times a second, the accelerations average out, so the deterministic driver
nearest to the one that was trained takes their mean. Taking the most probable action can make another driver: where
braking has 40 %, and two accelerations have 30 % each, it always brakes.
"""

import math
from typing import Final, NamedTuple

import numpy as np

from behavexplor.ads.learned.tracker import ACCELERATIONS, N_LANE_CHOICES
from behavexplor.data.array_types import Floats, Ints
from behavexplor.jit import kernel_inner

MEAN, MOST_PROBABLE, DRAWN = 0, 1, 2  # ways to choose
ACCELERATION_TABLE: Final = np.array(ACCELERATIONS)


class Decisions(NamedTuple):
    """Decisions of a batch of egos.

    Attributes:
        accelerations: wanted accelerations [m/s2], shape (B,).
        lanes: lane choices of `behavexplor.ads.learned.tracker`, shape (B,).
    """

    accelerations: Floats
    lanes: Ints


def as_decisions(actions: Ints) -> Decisions:
    """Return the decisions of actions, indices of shape (B,)."""
    return Decisions(ACCELERATION_TABLE[actions % len(ACCELERATION_TABLE)], actions // len(ACCELERATION_TABLE))


@kernel_inner
def choose(preferences: Floats, accelerations: Floats, how: int, share: float) -> tuple[float, int]:
    """Return the wanted acceleration [m/s2] and the lane choice of one ego.

    Args:
        preferences: outputs of the network, shape (N_ACTIONS,).
        accelerations: acceleration of each action that keeps the lane, shape (N_ACTIONS / N_LANE_CHOICES,) [m/s2].
        how: `MEAN` for the mean acceleration and the most probable lane choice; `MOST_PROBABLE` for the most probable
            action, the first of several with equal probability; `DRAWN` for an action drawn with its probability.
        share: number in [0, 1), the share of the cumulative probabilities at which a drawn action lies.
    """
    if how == MEAN:
        return _average(preferences, accelerations)
    action = _at_share(preferences, share) if how == DRAWN else _greatest(preferences)
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
