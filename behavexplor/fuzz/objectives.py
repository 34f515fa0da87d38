"""Verdicts as objectives of many-objective search."""

import numpy as np
from numpy.typing import NDArray

from behavexplor.judge.specs import Verdict

Floats = NDArray[np.float64]

_APART = 1e-3  # [m]


def objectives(verdict: Verdict) -> Floats:
    """How far a run is from violating each spec, in [0, 1), 0 if and only if it does; shape (specs,).

    A degree d becomes (d + e) / (d + e + 1), the usual normalization of search-based testing (Arcuri, "It really does
    matter how you normalize the branch distance", STVR 2013): it keeps the order and needs no greatest degree. The
    small e keeps a run that came arbitrarily near to a violation apart from one that violates.
    """
    degrees = np.maximum(np.array(list(verdict.degrees.values())), 0.0) + _APART
    violated = [name in verdict.violated for name in verdict.degrees]
    return np.where(violated, 0.0, degrees / (degrees + 1))
