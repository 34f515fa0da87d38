"""Rewards of all slots: `behavexplor.envs.reward.reward_terms` for arrays."""

import numpy as np
from numpy.typing import NDArray

from behavexplor.data.trace import ENDS
from behavexplor.envs.engine.record_types import Records
from behavexplor.envs.tasks.scripted_slots import ScriptedSlots
from behavexplor.jit import kernel_in_place

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

TERMS = ("progress", "step", "effort", "lines", "collision", "rear_end", "arrived", "missed")
N_TERMS = len(TERMS)
COLLISION, ARRIVED = ENDS.index("collision"), ENDS.index("arrived")


def reward_terms(weights: Floats, slots: ScriptedSlots, active: Bools) -> Floats:
    """Compute the terms of the reward of the latest decision. They are 0 in inactive slots.

    Args:
        weights: weight of each term, shape (8,), in the order of `TERMS`.
        slots: the slots.
        active: whether each slot was stepped, shape (B,).

    Returns:
        The terms, shape (8, B).
    """
    terms = np.zeros((N_TERMS, len(active)))
    _fill_terms(weights, slots.runs, active, terms)
    return terms


@kernel_in_place
def _fill_terms(weights: Floats, runs: Records, active: Bools, terms: Floats) -> None:
    for b in range(len(active)):
        if not active[b]:
            continue
        run = runs[b]
        happened = (
            run.progress,
            1.0,
            run.mean_acceleration**2,
            1.0 if run.touched else 0.0,
            1.0 if run.end == COLLISION and not run.rear_end else 0.0,
            1.0 if run.end == COLLISION and run.rear_end else 0.0,
            1.0 if run.end == ARRIVED else 0.0,
            1.0 if run.end >= 0 and run.end not in (COLLISION, ARRIVED) else 0.0,
        )
        for i in range(N_TERMS):
            terms[i, b] = weights[i] * happened[i]
