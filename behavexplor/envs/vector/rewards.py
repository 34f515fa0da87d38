"""Rewards of all slots: `behavexplor.envs.reward.reward_terms` for arrays."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from behavexplor.data.trace import ENDS
from behavexplor.envs.vector.slots import END, MEAN_ACCELERATION, PROGRESS, REAR_END, TOUCHED, Slots

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

COLLISION, ARRIVED = ENDS.index("collision"), ENDS.index("arrived")


def reward_terms(weights: Mapping[str, float], slots: Slots, active: Bools) -> dict[str, Floats]:
    """Compute the terms of the reward of the latest decision, each of shape (B,). They are 0 in inactive slots."""
    end, outcome = slots.numbers[:, END], slots.outcome
    rear_end = outcome[:, REAR_END] > 0
    happened = {
        "progress": outcome[:, PROGRESS],
        "step": 1.0,
        "effort": outcome[:, MEAN_ACCELERATION] ** 2,
        "lines": outcome[:, TOUCHED],
        "collision": (end == COLLISION) & ~rear_end,
        "rear_end": (end == COLLISION) & rear_end,
        "arrived": end == ARRIVED,
        "missed": (end >= 0) & (end != COLLISION) & (end != ARRIVED),
    }
    return {name: np.where(active, weights[name] * amount, 0.0) for name, amount in happened.items()}
