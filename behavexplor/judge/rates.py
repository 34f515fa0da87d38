"""What may be said of a failure rate: exact intervals, and sequences that stay valid however often one looks.

An ordinary interval is valid for a number of scenarios that was fixed in advance. If scenarios are added until the
interval looks good, it misses the rate in far more than 5 % of cases. A confidence sequence is valid at all times.

Sources: C. Clopper and E. Pearson, Biometrika 26, 1934; H. Robbins, "Statistical methods related to the law of the
iterated logarithm", Annals of Mathematical Statistics 41, 1970; J. Ville, "Etude critique de la notion de collectif",
1939; I. Waudby-Smith and A. Ramdas, "Estimating means of bounded random variables by betting", Journal of the Royal
Statistical Society B 86, 2024.
"""

import math
from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np
import scipy

from behavexplor.data.array_types import Floats
from behavexplor.data.trace import ARRIVED
from behavexplor.errors import InputError, unknown_name
from behavexplor.judge.specs import ERROR, SPECS

ALPHA: Final = 0.05  # probability of being wrong
_EDGE: Final = 1e-12  # least distance of a rate from 0 and 1
_BETS: Final = 16  # of each sign in a `PairedSequence`
NON_INFERIOR, INFERIOR = "non-inferior", "inferior"  # verdicts of a `PairedSequence`
AT_FAULT, FAILED = "at-fault", "failed"  # outcomes of a goal, beside those of an evaluation
OUTCOMES: Final = (ARRIVED, *(spec.name for spec in SPECS), ERROR, AT_FAULT, FAILED)
BELOW, ABOVE, KNOWN = "below", "above", "known"  # verdicts of a `Decision`


def check_outcome(name: str) -> None:
    """Raise an `InputError` if there is no outcome of this name, which may go on with a detail, as "error: raised"."""
    if name.partition(": ")[0] not in OUTCOMES:
        raise unknown_name("outcome", name, OUTCOMES)


def clopper_pearson(failed: int, n: int, alpha: float = ALPHA) -> tuple[float, float]:
    """Return the exact interval of a rate for a number n >= 1 of scenarios that was fixed before.

    It misses the rate with a probability of at most alpha.
    """
    found = scipy.stats.binomtest(failed, n).proportion_ci(1.0 - alpha, "exact")
    return float(found.low), float(found.high)


@dataclass(frozen=True)
class RateSequence:
    """Robbins' mixture: intervals of a rate that are valid at all times together.

    After k failures in n scenarios, a rate p is kept if B(k + a, n - k + b) / B(a, b) / (p^k (1 - p)^(n - k)) is less
    than 1 / alpha. Under the true rate, this ratio is a martingale, and ever reaches 1 / alpha with a probability of at
    most alpha (Ville's inequality). The prior, a beta distribution, decides where the intervals are narrow.
    """

    a: float = 0.5  # first parameter of the prior
    b: float = 10.0  # second parameter of the prior
    alpha: float = ALPHA  # probability with which the sequence may ever miss the rate

    @classmethod
    def for_rate(cls, rate: float, alpha: float = ALPHA) -> Self:
        """Return a sequence that soon shows a rate to be below this one, if hardly anything fails."""
        return cls(b=1.0 / (3.0 * rate), alpha=alpha)

    def excludes(self, rate: Any, failed: Any, n: Any) -> Any:
        """Return whether a rate, strictly between 0 and 1, is excluded. Arguments may be arrays."""
        passed = n - failed
        mixture = scipy.special.betaln(failed + self.a, passed + self.b) - scipy.special.betaln(self.a, self.b)
        return mixture - failed * np.log(rate) - passed * np.log1p(-np.asarray(rate)) >= -math.log(self.alpha)

    def interval(self, failed: int, n: int) -> tuple[float, float]:
        """Return the interval of the rates that are not excluded after `failed` failures in n scenarios."""
        if n == 0:
            return 0.0, 1.0
        middle = min(max(failed / n, _EDGE), 1.0 - _EDGE)
        return self._end(_EDGE, middle, failed, n), self._end(1.0 - _EDGE, middle, failed, n)

    def _end(self, outside: float, inside: float, failed: int, n: int) -> float:
        """Return the end of the interval between a rate that may be excluded and one that is not."""
        if not self.excludes(outside, failed, n):
            return round(outside)  # 0 or 1: no rate on this side is excluded
        for _ in range(60):
            middle = (outside + inside) / 2
            outside, inside = (middle, inside) if self.excludes(middle, failed, n) else (outside, middle)
        return outside


@dataclass(frozen=True)
class Goal:
    """What is to be known of the rate of an outcome before an evaluation ends.

    Raises:
        InputError: if a value is unknown or out of range, or not exactly one of `below` and `until` is given.
    """

    # a name of `behavexplor.evaluation.Evaluation.counts`; `AT_FAULT` for failures by the driver's own fault, or
    # `FAILED` for all failures
    outcome: str = "collision"
    below: float | None = None  # a rate: is that of the outcome below it? None for `until`
    until: float | None = None  # greatest half of the interval's width, as a share of the rate

    def __post_init__(self) -> None:
        check_outcome(self.outcome)
        if (self.below is None) == (self.until is None):
            raise InputError("Give either below, a rate such as 0.001, or until, a share such as 0.2")
        for name, least in (("below", 1e-7), ("until", 0.01)):
            value = getattr(self, name)
            if value is not None and not least <= value < 1.0:
                raise InputError(f"{name} {value} must lie between {least:g} and 1")

    @property
    def sequence(self) -> RateSequence:
        """The confidence sequence that decides."""
        return RateSequence() if self.below is None else RateSequence.for_rate(self.below)


@dataclass(frozen=True)
class Decision:
    """What an evaluation has found out about the rate of an outcome. It is valid whenever the evaluation ended."""

    goal: Goal
    n: int  # number of scenarios
    count: int  # number of those with the outcome, and of `errors`
    low: float  # lower end of the 95 % interval of the rate
    high: float  # upper end of it
    errors: int = 0  # scenarios without the outcome that count because the driver's program failed; 0 for "arrived"

    @classmethod
    def of(cls, goal: Goal, n: int, count: int, errors: int = 0) -> Self:
        """Return what is known after a number of scenarios; see the fields for the other numbers."""
        return cls(goal, n, count, *goal.sequence.interval(count, n), errors)

    @property
    def verdict(self) -> str:
        """`BELOW` or `ABOVE` the rate in question, `KNOWN` as precisely as wanted, or "" if not decided."""
        if self.goal.below is None:
            wanted = self.goal.until or 0.0
            return KNOWN if self.count and (self.high - self.low) / 2 <= wanted * self.count / self.n else ""
        if self.high < self.goal.below:
            return BELOW
        return ABOVE if self.low > self.goal.below else ""

    @property
    def words(self) -> str:
        """The decision as a sentence."""
        found = f"in {self.count} of {self.n} scenarios ({self.low:.3%} to {self.high:.3%}"
        if not self.count:
            found = f"in none of {self.n} scenarios (at most {self.high:.3%}"
        outcome = f"{self.goal.outcome} or error" if self.errors else self.goal.outcome
        rate = f"{100 * (self.goal.below or 0.0):g} %"
        heads = {BELOW: f"Below {rate}", ABOVE: f"Above {rate}", KNOWN: "Known as precisely as wanted"}
        return f"{heads.get(self.verdict, 'Not decided')}: {outcome} {found}; 95 %, valid at any time)"


class PairedSequence:
    """A sequential test of non-inferiority: a new driver against an old one, in the same scenarios, with a margin.

    Each pair is a bet on how much more often the new driver fails. Under the hypothesis that it is worse by at least
    the margin, the capital is a supermartingale, as is its mean over several bets. If the capital ever reaches 1 /
    alpha, the new driver is non-inferior; mirrored bets show it to be inferior. The margin, between 0 and 1, is the
    greatest difference of the failure rates that counts as no worse; either verdict may be wrong with the probability
    alpha.
    """

    def __init__(self, margin: float, alpha: float = ALPHA) -> None:
        self.n = 0  # pairs so far
        self.verdict = ""  # `NON_INFERIOR` or `INFERIOR` once it is decided, which does not change any more
        self._margin = margin
        self._decisive = -math.log(alpha)  # logarithm of the capital that decides
        self._bets = {sign: np.geomspace(0.003, 0.98 / (1 - sign * margin), _BETS) for sign in (1, -1)}
        self._logs: dict[int, Floats] = {sign: np.zeros(_BETS) for sign in self._bets}

    def add(self, *, old_failed: bool, new_failed: bool) -> str:
        """Add a scenario that both have driven, and return the verdict."""
        self.n += 1
        worse = int(new_failed) - int(old_failed)
        for sign, bets in self._bets.items():
            self._logs[sign] += np.log1p(bets * sign * (self._margin - worse))
        for sign, verdict in ((1, NON_INFERIOR), (-1, INFERIOR)):
            if not self.verdict and scipy.special.logsumexp(self._logs[sign]) - math.log(_BETS) >= self._decisive:
                self.verdict = verdict
        return self.verdict
