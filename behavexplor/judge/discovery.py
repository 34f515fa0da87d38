"""How much of what can be found has been found: estimates from how often each class of failures was seen.

Sources: I. J. Good, "The population frequencies of species and the estimation of population parameters", Biometrika 40,
1953; A. Chao, "Nonparametric estimation of the number of classes in a population", Scandinavian Journal of Statistics
11, 1984; the interval is that of A. Chao, "Estimating the population size for capture-recapture data with unequal
catchability", Biometrics 43, 1987. M. Boehme, "STADS: Software testing as species discovery", ACM TOSEM 27, 2018, uses
them for fuzzers.

The estimates hold for independent executions, as uniform sampling makes them. The executions of a guided search are not
independent, so its estimates are rough.
"""

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, Self

_Z: Final = 1.96  # quantile of the normal distribution for an interval of 95 %


@dataclass(frozen=True)
class Discovery:
    """Estimates of what a campaign has not found yet.

    Attributes:
        executions: number of executions.
        found: number of classes that were found.
        new_chance: probability that the next execution shows a new class (Good-Turing).
        unseen: estimated number of classes not found yet (Chao1). It is a lower bound on average.
        unseen_low: lower end of the 95 % interval of `unseen`.
        unseen_high: upper end of the 95 % interval of `unseen`.
    """

    executions: int
    found: int
    new_chance: float
    unseen: float
    unseen_low: float
    unseen_high: float

    @classmethod
    def of(cls, classes: Iterable[str], executions: int) -> Self:
        """Estimate from the classes of the failures.

        Args:
            classes: class of each failure.
            executions: number of executions, failed or not.
        """
        counts = Counter(Counter(classes).values())
        found, once, twice = counts.total(), counts[1], counts[2]
        unseen, low, high = _chao1(found, once, twice, executions)
        return cls(executions, found, once / executions if executions else math.nan, unseen, low, high)


def _chao1(found: int, once: int, twice: int, executions: int) -> tuple[float, float, float]:
    """Return the bias-corrected Chao1 estimate of the unseen classes, and its 95 % interval.

    Args:
        found: number of classes seen.
        once: number of classes seen once.
        twice: number of classes seen twice.
        executions: number of executions.
    """
    if not executions or not once:
        return 0.0, 0.0, 0.0
    share = (executions - 1) / executions
    unseen = share * once * (once - 1) / (2 * (twice + 1))
    variance = (
        share * once * (once - 1) / (2 * (twice + 1))
        + share**2 * once * (2 * once - 1) ** 2 / (4 * (twice + 1) ** 2)
        + share**2 * once**2 * twice * (once - 1) ** 2 / (4 * (twice + 1) ** 4)
    )
    if twice == 0:
        variance -= share**2 * once**4 / (4 * (found + unseen))
    if unseen == 0.0:
        return 0.0, 0.0, _Z * math.sqrt(variance)
    spread = math.exp(_Z * math.sqrt(math.log(1 + variance / unseen**2)))
    return unseen, unseen / spread, unseen * spread
