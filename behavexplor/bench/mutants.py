"""The mutants of a campaign, and how their violation degrees and behaviors are correlated (the paper's r_BF)."""

from collections.abc import Iterable
from typing import Final, NamedTuple

import numpy as np
import scipy

_LEAST: Final = 3  # least number of mutants for a correlation


class Mutant(NamedTuple):
    """An execution for which the search method measured the distance of its behavior from the known ones.

    Attributes:
        degree: violation degree.
        distance: distance of the behavior from the nearest known one, in [0, 1].
        failed: whether it violated a spec.
    """

    degree: float
    distance: float
    failed: bool


class Correlation(NamedTuple):
    """Pearson's correlation of violation degree and behavior distance.

    Attributes:
        n: number of mutants.
        r: the correlation.
        p: its two-sided p-value, for independent mutants.
    """

    n: int
    r: float
    p: float


def correlation(mutants: Iterable[Mutant], *, passed: bool = False) -> Correlation | None:
    """Return the correlation of degree and distance; None if one of them does not vary or there are too few mutants.

    Args:
        mutants: the mutants, of one campaign or of several.
        passed: whether only mutants that did not fail count. A failing run ends early at a collision or late at a
            standstill, so that its length makes it far from other behaviors, and its violation makes its degree low.
    """
    chosen = [(mutant.degree, mutant.distance) for mutant in mutants if not (passed and mutant.failed)]
    values = np.asarray(chosen, dtype=float).reshape(-1, 2)
    if len(values) < _LEAST or not np.ptp(values, axis=0).all():
        return None
    found = scipy.stats.pearsonr(values[:, 0], values[:, 1])
    return Correlation(len(values), float(found.statistic), float(found.pvalue))
