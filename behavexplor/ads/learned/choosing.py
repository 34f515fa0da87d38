"""Decisions for the outputs of a policy's network, which are the preferences of its actions.

The probabilities of the actions are the softmax of the preferences. PPO and similar algorithms train a policy that
draws its actions with them. Drawn several times a second, the accelerations average out, so the deterministic driver
nearest to the one that was trained takes their mean. Taking the most probable action can make another driver: where
braking has 40 %, and two accelerations have 30 % each, it always brakes.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from behavexplor.ads.learned.network_file import Rule
from behavexplor.ads.learned.tracker import ACCELERATIONS, N_LANE_CHOICES
from behavexplor.jit import kernel_in_place, kernel_inner

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_TABLE = np.array(ACCELERATIONS)


class Decisions(NamedTuple):
    """Decisions of a batch of egos.

    Attributes:
        accelerations: wanted accelerations [m/s2], shape (B,).
        lanes: lane choices of `behavexplor.ads.learned.tracker`, shape (B,).
    """

    accelerations: Floats
    lanes: Ints


def decide(preferences: Floats, rule: Rule) -> Decisions:
    """Decide without chance.

    Args:
        preferences: outputs of the network, shape (B, N_ACTIONS).
        rule: "mean" for the mean acceleration and the most probable lane choice, or "most probable" for the most
            probable action; the first of several with equal probability.
    """
    if rule == "most probable":
        return as_decisions(preferences.argmax(axis=1))
    accelerations, lanes = np.zeros(len(preferences)), np.zeros(len(preferences), dtype=np.int64)
    _average_all(preferences, _TABLE, accelerations, lanes)
    return Decisions(accelerations, lanes)


def draw_decisions(preferences: Floats, shares: Floats) -> Decisions:
    """Draw actions with their probabilities.

    Args:
        preferences: outputs of the network, shape (B, N_ACTIONS).
        shares: numbers in [0, 1), shape (B,): the share of the cumulative probabilities at which the action lies.
    """
    actions = np.zeros(len(preferences), dtype=np.int64)
    _draw_all(preferences, shares, actions)
    return as_decisions(actions)


def as_decisions(actions: Ints) -> Decisions:
    """Return the decisions of actions, indices of shape (B,)."""
    return Decisions(_TABLE[actions % len(_TABLE)], actions // len(_TABLE))


@kernel_in_place
def _average_all(preferences: Floats, table: Floats, accelerations: Floats, lanes: Ints) -> None:
    for i in range(len(preferences)):
        accelerations[i], lanes[i] = _average(preferences[i], table)


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


@kernel_in_place
def _draw_all(preferences: Floats, shares: Floats, actions: Ints) -> None:
    for i in range(len(preferences)):
        actions[i] = _at_share(preferences[i], shares[i])


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
