"""Rewards of all slots: `behavexplor.envs.reward.reward_terms` for arrays."""

import numpy as np
from numpy.typing import NDArray

from behavexplor.data.trace import ENDS
from behavexplor.envs.vector.slots import END, MEAN_ACCELERATION, PROGRESS, REAR_END, TOUCHED, Slots
from behavexplor.jit import kernel_in_place

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

TERMS = ("progress", "step", "effort", "lines", "collision", "rear_end", "arrived", "missed")
N_TERMS = len(TERMS)
COLLISION, ARRIVED = ENDS.index("collision"), ENDS.index("arrived")


def reward_terms(weights: Floats, slots: Slots, active: Bools) -> Floats:
    """Compute the terms of the reward of the latest decision. They are 0 in inactive slots.

    Args:
        weights: weight of each term, shape (8,), in the order of `TERMS`.
        slots: the slots.
        active: whether each slot was stepped, shape (B,).

    Returns:
        The terms, shape (8, B).
    """
    terms = np.zeros((N_TERMS, len(active)))
    _fill_terms(weights, slots.numbers, slots.outcome, active, terms)
    return terms


@kernel_in_place
def _fill_terms(weights: Floats, numbers: Ints, outcome: Floats, active: Bools, terms: Floats) -> None:
    for b in range(len(active)):
        if not active[b]:
            continue
        end, rear_end = numbers[b, END], outcome[b, REAR_END] > 0
        happened = (
            outcome[b, PROGRESS],
            1.0,
            outcome[b, MEAN_ACCELERATION] ** 2,
            outcome[b, TOUCHED],
            1.0 if end == COLLISION and not rear_end else 0.0,
            1.0 if end == COLLISION and rear_end else 0.0,
            1.0 if end == ARRIVED else 0.0,
            1.0 if end >= 0 and end not in (COLLISION, ARRIVED) else 0.0,
        )
        for i in range(N_TERMS):
            terms[i, b] = weights[i] * happened[i]
