"""Convert verdicts to the objectives of a many-objective search."""

import numpy as np

from behavexplor.data.array_types import Floats
from behavexplor.judge.specs import Verdict

_APART = 1e-3  # [m]


def objectives(verdict: Verdict) -> Floats:
    """Compute the distance of an execution from violating each spec, in [0, 1); shape (specs,).

    An objective is 0 if and only if the spec is violated. Otherwise, a degree d becomes (d + e) / (d + e + 1), the
    usual normalization of search-based testing (Arcuri, "It really does matter how you normalize the branch distance",
    STVR 2013). It keeps the order and needs no upper limit of the degree. The small e distinguishes an execution that
    came arbitrarily close to a violation from one that violates the spec.
    """
    degrees = np.maximum(np.array(list(verdict.degrees.values())), 0.0) + _APART
    violated = [name in verdict.violated for name in verdict.degrees]
    return np.where(violated, 0.0, degrees / (degrees + 1))
