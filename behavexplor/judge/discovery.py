"""How much of what can be found has been found: estimates from how often each class of failures was seen.

Sources: I. J. Good, "The population frequencies of species and the estimation of population parameters", Biometrika 40,
1953; A. Chao, "Nonparametric estimation of the number of classes in a population", Scandinavian Journal of Statistics
11, 1984; the interval is that of A. Chao, "Estimating the population size for capture-recapture data with unequal
catchability", Biometrics 43, 1987. M. Boehme, "STADS: Software testing as species discovery", ACM TOSEM 27, 2018, uses
them for fuzzers.

The estimates hold for independent executions, as uniform sampling makes them. The executions of a guided search are not
independent, and their intervals hold less often (docs/results.md, "What the estimates of unseen classes were worth").
So nothing is said of what such a search has not found.
"""

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, Self

import scipy

INDEPENDENT: Final = frozenset({"uniform"})  # search methods whose executions are independent
LEVEL: Final = 0.95  # probability with which a limit is to hold
_STRICT: Final = 0.995  # level at which E[chance] is limited, so that the limit holds for the chance itself at `LEVEL`
_Z: Final = 1.96  # quantile of the normal distribution for an interval of 95 %


@dataclass(frozen=True)
class Discovery:
    """Estimates of what a campaign has not found yet."""

    executions: int  # number of executions, failed or not
    found: int  # number of classes that were found
    new_chance: float  # probability that the next execution shows a new class (Good-Turing)
    unseen: float  # estimated number of classes not found yet (Chao1). It is a lower bound on average.
    unseen_low: float  # lower end of the 95 % interval of `unseen`
    unseen_high: float  # upper end of the 95 % interval of `unseen`
    once: int = 0  # number of classes that were seen once

    @property
    def new_chance_limit(self) -> float:
        """Upper 95 % limit of the probability that the next execution shows a new class.

        The number of classes seen once is about Poisson distributed, with the mean m = `executions` x E[chance], where
        the chance is that probability. The exact (chi-square) upper limit of m, divided by `executions`, limits
        E[chance]. The chance itself varies around E[chance], so the limit is taken at `_STRICT` instead of `LEVEL`.
        Then it holds in about 95 % of campaigns, and in at least 92 % for populations of 40 classes. If no class was
        seen once, it is above the rule of three, 3 / `executions`.
        """
        most = float(scipy.stats.chi2.ppf(_STRICT, 2 * (self.once + 1))) / 2
        return min(most / self.executions, 1.0) if self.executions else 1.0

    @property
    def next_limit(self) -> int:
        """Upper 95 % limit of the number of new classes in as many further executions.

        That number is about Poisson distributed, and its mean is at most that of `once`. So the limit is the quantile
        of a negative binomial distribution, which a flat prior for that mean gives.
        """
        return int(scipy.stats.nbinom.ppf(LEVEL, self.once + 1, 0.5))

    def outlook(self, method: str) -> str:
        """Return a sentence on what a campaign with this search method has not found yet."""
        if method not in INDEPENDENT:
            return "A guided search cannot tell how many classes it has not found; another seed finds more."
        return (
            f"The next execution shows a new class with a probability of at most {self.new_chance_limit:.1%}, and a "
            f"second campaign of this size, with another seed, at most {self.next_limit} new "
            f"{'class' if self.next_limit == 1 else 'classes'} (95 %)."
        )

    @classmethod
    def of(cls, classes: Iterable[str], executions: int) -> Self:
        """Estimate from the class of each failure, and the number of executions, failed or not."""
        counts = Counter(Counter(classes).values())
        found, once, twice = counts.total(), counts[1], counts[2]
        unseen, low, high = _chao1(found, once, twice, executions)
        return cls(
            executions=executions,
            found=found,
            new_chance=once / executions if executions else math.nan,
            unseen=unseen,
            unseen_low=low,
            unseen_high=high,
            once=once,
        )


def _chao1(found: int, once: int, twice: int, executions: int) -> tuple[float, float, float]:
    """Return the bias-corrected Chao1 estimate of the unseen classes, and its 95 % interval.

    `found` classes have been seen in `executions` executions, `once` of them once and `twice` of them twice.
    """
    if not executions or not once:
        return 0.0, 0.0, 0.0
    share = (executions - 1) / executions
    unseen = share * once * (once - 1) / (2 * (twice + 1))
    variance = (
        unseen
        + share**2 * once * (2 * once - 1) ** 2 / (4 * (twice + 1) ** 2)
        + share**2 * once**2 * twice * (once - 1) ** 2 / (4 * (twice + 1) ** 4)
    )
    if twice == 0:
        variance -= share**2 * once**4 / (4 * (found + unseen))
    if unseen == 0.0:
        return 0.0, 0.0, _Z * math.sqrt(variance)
    spread = math.exp(_Z * math.sqrt(math.log(1 + variance / unseen**2)))
    return unseen, unseen / spread, unseen * spread
