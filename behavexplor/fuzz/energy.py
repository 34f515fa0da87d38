"""Energy of testcases, which determines their selection and their mutation (paper section 3.3)."""

import math

import numpy as np

from behavexplor.data.array_types import Floats

SELECTION_CHANGE = -0.05  # dE_S, the decay with each selection
_BENIGN_SHARE = 0.1  # a passed mutant costs less energy than a failed one adds
GAMMA = 1e-5  # gamma of equation 16, against division by zero


def failure_change(failed: bool, n_failed: int, n_passed: int) -> float:
    """Compute dE_F of the parent (paper equation 15).

    Args:
        failed: whether the last mutant of the parent failed.
        n_failed: #F, number of mutants that failed, including the last one.
        n_passed: #NF, number of mutants that did not fail, including the last one.
    """
    if failed:
        return n_failed / (n_passed + n_failed)
    return -_BENIGN_SHARE * n_passed / (n_passed + n_failed)


def degree_change(parent_degree: float, degree: float, distance: float, *, bounded: bool, gamma: float) -> float:
    """Compute dE_V of a mutant and its parent (paper equation 16).

    Args:
        parent_degree: O_s, the violation degree of the parent [m].
        degree: O_s', the violation degree of the mutant [m].
        distance: dis(s', s), the distance of their behaviors, in [0, 1].
        bounded: whether the printed formula is bounded by tanh. Unbounded, a single mutant at distance 1 changes the
            energy by 1e5 per meter, and the selection never recovers from it.
        gamma: the small number in the denominator, against division by zero.
    """
    change = (parent_degree - degree) / (1 - distance + gamma)
    return math.tanh(change) if bounded else change


def selection_probabilities(energies: Floats) -> Floats:
    """Compute p_i of each testcase (paper equation 18), normalized over the positive energies so that they sum to 1.

    Args:
        energies: E of each testcase, shape (n,). If none is positive, all testcases are equally likely.

    Returns:
        Probabilities, shape (n,).
    """
    weights = np.maximum(energies, 0.0)
    total = weights.sum()
    return np.asarray(weights / total if total > 0 else np.full(len(weights), 1 / len(weights)))
