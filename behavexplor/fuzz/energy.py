"""Energy: how likely a testcase is to be selected, and how boldly it is mutated (paper section III-C)."""

import math

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

SELECTION_CHANGE = -0.05  # dE_S: the decay with each selection
_BENIGN_SHARE = 0.1  # a passed mutant takes less than a failed one gives
_GAMMA = 1e-5  # gamma of equation 16, against division by zero


def failure_change(failed: bool, n_failed: int, n_passed: int) -> float:
    """dE_F of the parent (paper equation 15).

    Args:
        failed: whether its last mutant failed.
        n_failed: #F, how many of its mutants failed, the last one included.
        n_passed: #NF, how many did not.
    """
    if failed:
        return n_failed / (n_passed + n_failed)
    return -_BENIGN_SHARE * n_passed / (n_passed + n_failed)


def degree_change(parent_degree: float, degree: float, distance: float, *, bounded: bool) -> float:
    """dE_V of a mutant and its parent (paper equation 16).

    Args:
        parent_degree: O_s, the parent's violation degree [m].
        degree: O_s' of the mutant [m].
        distance: dis(s', s), the distance of their behaviors, in [0, 1].
        bounded: whether the tanh of the printed formula is taken. As printed a single mutant at distance 1 weighs
            1e5 per meter, and the selection never recovers from it.
    """
    change = (parent_degree - degree) / (1 - distance + _GAMMA)
    return math.tanh(change) if bounded else change


def selection_probabilities(energies: Floats) -> Floats:
    """p_i of each testcase (paper equation 18), over the positive energies so that they sum to 1.

    Args:
        energies: E, shape (n,); if none is positive, all testcases are equally likely.

    Returns:
        Shape (n,).
    """
    weights = np.maximum(energies, 0.0)
    total = weights.sum()
    return np.asarray(weights / total if total > 0 else np.full(len(weights), 1 / len(weights)))
