"""The driver's own failure rate, beside the share of failures among scenarios that a search has chosen.

A guided search looks where failures are, so its share says how well it searched, and not how often the driver fails.
Scenarios that are drawn uniformly tell the latter. They are executed after the search has ended, and belong neither to
its budget nor to the records.
"""

import json
from dataclasses import asdict, dataclass
from typing import Any, Final, Self

from behavexplor.campaign.config import Budget
from behavexplor.campaign.store import Store
from behavexplor.data.untrusted import parse_json
from behavexplor.judge.discovery import INDEPENDENT
from behavexplor.judge.rates import clopper_pearson

MOST: Final = 200  # greatest number of scenarios
SHARE: Final = 4  # executions of the campaign for each of these scenarios, at least
_NOTE: Final = "uniform"  # in the store


@dataclass(frozen=True)
class UniformRate:
    """How many of some uniformly drawn scenarios failed."""

    n: int  # number of scenarios
    failed: int  # number of those that failed

    @property
    def rate(self) -> float:
        """Share of the scenarios that failed."""
        return self.failed / self.n

    @property
    def interval(self) -> tuple[float, float]:
        """The exact 95 % interval of the driver's failure rate."""
        return clopper_pearson(self.failed, self.n)

    @property
    def words(self) -> str:
        """The rate and its interval in words."""
        low, high = self.interval
        return f"{self.rate:.1%} (95%: {low:.1%} to {high:.1%})"

    @classmethod
    def stored(cls, store: Store) -> Self | None:
        """Return what was noted in a run's store; None if nothing was."""
        try:
            values = parse_json(store.note(_NOTE).decode(), "the rate of failures")
            found = cls(int(values["n"]), int(values["failed"]))
        except (ValueError, KeyError, TypeError, OverflowError):
            return None
        return found if 0 <= found.failed <= found.n and found.n else None

    def note(self, store: Store) -> None:
        """Note the rate in a run's store, for `stored`."""
        store.add_note(_NOTE, json.dumps(asdict(self)))

    def to_dict(self) -> dict[str, Any]:
        """Return the rate and its interval as JSON values."""
        low, high = self.interval
        return {**asdict(self), "rate": self.rate, "low": low, "high": high}


def own_rate(
    method: str, executions: int, failed: int, budget: Budget, elapsed: float, beside: UniformRate | None = None
) -> UniformRate | None:
    """Return the driver's own failure rate as far as a run tells it; None if it does not.

    Uniform draws tell it if the budget was used up. A run that ended at a failure has too many of these.
    `beside` is the rate of uniformly drawn scenarios beside the run, see `UniformRate.stored`.
    """
    if method in INDEPENDENT:
        is_used_up = executions >= (budget.executions or 0) and elapsed >= (budget.seconds or 0.0)
        return UniformRate(executions, failed) if executions and is_used_up else None
    return beside


def explained(method: str, rate: UniformRate | None) -> str:
    """Return a sentence that says which number is the driver's own failure rate; see `own_rate`."""
    if rate is None and method in INDEPENDENT:
        return "The run ended before its budget was used up, so its share of failures is not the driver's failure rate."
    if rate is None:
        return "The search chose these scenarios, so their share of failures is not the driver's rate."
    if method in INDEPENDENT:
        return f"The scenarios were drawn uniformly, so the driver's failure rate is {rate.words}."
    return (
        "The search chose these scenarios, so their share of failures is not the driver's rate. "
        f"Of {rate.n} other scenarios, drawn uniformly, {rate.failed} failed, so the driver's failure rate is "
        f"{rate.words}."
    )
