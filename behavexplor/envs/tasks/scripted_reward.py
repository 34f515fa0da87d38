"""The reward of the environments, as a sum of terms for R1-R3, progress, time and effort.

The weights are the environment's `config["reward"]`; the defaults are `WEIGHTS`. Each term is a weight times an amount:

- `progress`: distance that the ego moved forward along its route since the last decision [m];
- `step`: 1;
- `effort`: square of the mean acceleration since the last decision [(m/s2)^2];
- `lines`: 1 at the decision in which the ego first touches an illegal line (R2);
- `collision`: 1 at a collision (R1) that is not a `rear_end`;
- `rear_end`: 1 at a collision in which a faster vehicle struck the ego from behind;
- `arrived`: 1 on arrival (R3);
- `missed`: 1 at any other end.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behavexplor.data.trace import ENDS
from behavexplor.envs.engine.state import Records
from behavexplor.jit import kernel_in_place

WEIGHTS: Mapping[str, float] = MappingProxyType(
    {
        "progress": 0.1,
        "step": -0.02,
        "effort": -0.002,
        "lines": -8.0,
        "collision": -20.0,
        "rear_end": -2.0,
        "arrived": 10.0,
        "missed": -4.0,
    }
)


Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

TERMS: Final = tuple(WEIGHTS)
COLLISION, ARRIVED = ENDS.index("collision"), ENDS.index("arrived")


def reward_terms(weights: Mapping[str, float], runs: Records, active: Bools) -> Floats:
    """Compute the terms of the reward of the latest decision. They are 0 in inactive slots.

    Args:
        weights: weight of each term, such as `WEIGHTS`.
        runs: what has happened in each slot, shape (B,) of `behavexplor.envs.tasks.scripted_slots.RUN`.
        active: whether each slot was stepped, shape (B,).

    Returns:
        The terms in the order of `TERMS`, shape (8, B). Their sum is the reward.
    """
    terms = np.zeros((len(TERMS), len(active)))
    _fill_terms(np.array([weights[name] for name in TERMS]), runs, active, terms)
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
        for i in range(len(weights)):
            terms[i, b] = weights[i] * happened[i]
