"""Means with their intervals, and whether two methods can be told apart.

Mann-Whitney U asks whether they can, Vargha and Delaney's A12 how far they are apart, Holm's correction keeps a table
of many comparisons from finding something by chance.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import stats

LEVEL: Final = 0.05  # of significance, for a whole family of comparisons
MOST_ARRANGEMENTS: Final = 20_000  # beyond them the distribution of a U with ties is approximated

_SIZES: Final = ((0.21, "large"), (0.14, "medium"), (0.06, "small"))  # of |A12 - 0.5|, Vargha and Delaney 2000


@dataclass(frozen=True)
class Estimate:
    """A mean and its 95 % interval.

    Attributes:
        n: number of values.
        mean: of them.
        low: lower end of the interval; as the upper one, nan if there is only one value.
        high: upper end.
    """

    n: int
    mean: float
    low: float
    high: float


def estimate(values: Sequence[float]) -> Estimate:
    """The mean of values, with Student's t interval."""
    n, mean = len(values), float(np.mean(values))
    if n < 2:
        return Estimate(n, mean, math.nan, math.nan)
    half = float(stats.t.ppf(0.975, n - 1) * np.std(values, ddof=1) / math.sqrt(n))
    return Estimate(n, mean, mean - half, mean + half)


def a12(first: Sequence[float], second: Sequence[float]) -> float:
    """The probability that a value of the first exceeds one of the second, ties counting half.

    Source: Vargha and Delaney 2000. The samples need not be of one size.
    """
    apart = np.subtract.outer(np.asarray(first, float), np.asarray(second, float))
    return float(np.mean((apart > 0) + 0.5 * (apart == 0)))


def size(effect: float) -> str:
    """An A12 in words."""
    return next((word for least, word in _SIZES if round(abs(effect - 0.5), 9) >= least), "negligible")


def mann_whitney(first: Sequence[float], second: Sequence[float]) -> float:
    """The two-sided p of Mann and Whitney's U.

    It is exact, but for samples with ties that can be arranged in more than `MOST_ARRANGEMENTS` ways. A sample of one
    value tells nothing: p is 1.
    """
    together = np.concatenate([np.asarray(first, float), np.asarray(second, float)])
    distinct = len(np.unique(together))
    if distinct == 1 or min(len(first), len(second)) < 2:
        return 1.0  # where nothing is apart the test has no variance to work with
    method: object = "exact"
    if distinct < len(together):
        exact = math.comb(len(together), len(first)) <= MOST_ARRANGEMENTS
        method = stats.PermutationMethod(n_resamples=MOST_ARRANGEMENTS) if exact else "asymptotic"
    return float(stats.mannwhitneyu(first, second, alternative="two-sided", method=method).pvalue)


def least_p(n: int, m: int) -> float:
    """The least p that samples of these sizes can have at all."""
    return 2 / math.comb(n + m, n) if min(n, m) > 1 else 1.0


def holm(ps: Sequence[float]) -> list[float]:
    """The p of a family of comparisons, corrected after Holm 1979: the i-th least of m times m - i, and monotone."""
    order = sorted(range(len(ps)), key=lambda i: ps[i])
    corrected, worst = [0.0] * len(ps), 0.0
    for rank, i in enumerate(order):
        worst = max(worst, min(1.0, (len(ps) - rank) * ps[i]))
        corrected[i] = worst
    return corrected


@dataclass(frozen=True)
class Comparison:
    """Two samples compared.

    Attributes:
        n: sizes of both.
        means: of both.
        effect: A12 of the first over the second.
        p: of Mann and Whitney's U.
        corrected: the same within its family; see `holm`.
    """

    n: tuple[int, int]
    means: tuple[float, float]
    effect: float
    p: float
    corrected: float

    @property
    def verdict(self) -> str:
        """What the comparison says, in words."""
        if self.corrected >= LEVEL:
            return "not distinguishable"
        return f"{'more' if self.effect > 0.5 else 'fewer'}, {size(self.effect)}"


def compare(pairs: Sequence[tuple[Sequence[float], Sequence[float]]]) -> list[Comparison]:
    """Compare pairs of samples, corrected as one family."""
    ps = [mann_whitney(first, second) for first, second in pairs]
    return [
        Comparison(
            (len(first), len(second)), (float(np.mean(first)), float(np.mean(second))), a12(first, second), p, corrected
        )
        for (first, second), p, corrected in zip(pairs, ps, holm(ps), strict=True)
    ]
