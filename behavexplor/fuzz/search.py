"""The seam between a campaign and its search: scenarios are asked for, what became of them is told."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import numpy as np

from behavexplor.data.logical import LogicalScenario
from behavexplor.data.scenario import Scenario
from behavexplor.data.trace import Trace
from behavexplor.judge.specs import Verdict

INITIAL, UNIFORM = "initial", "uniform"  # origins of candidates without a parent
MAX_POPULATION = 1000  # members are compared with one another
MAX_FAILED_INITIAL = 1000  # after so many initial scenarios that all failed, there is nothing to mutate


class SearchExhausted(Exception):  # noqa: N818 - it ends a campaign, nothing went wrong
    """The search has nothing left to ask for; the message is a sentence that says why."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """A scenario that a search wants to see executed.

    Attributes:
        number: how many were asked for before it.
        scenario: valid in the campaign's logical scenario.
        origin: how it was made, such as "initial" or the kind of its mutation.
        parent: number of the candidate that it was made from, if any.
    """

    number: int
    scenario: Scenario
    origin: str
    parent: int | None


def nothing_to_mutate(failed: int) -> SearchExhausted:
    """The end of a search whose initial scenarios all failed."""
    return SearchExhausted(
        f"All {failed} initial scenarios failed: the ADS fails everywhere, there is nothing to mutate."
    )


class SearchMethod(Protocol):
    """A search for failures: it knows scenarios, traces and verdicts, but neither simulator nor ADS.

    It is built as `method(logical, seed, options)`, where `options` is an instance of the frozen dataclass
    `method.Options`; the first line of its docstring is its description. Many candidates may be in flight,
    but they are told in the order in which they were asked for. The same asks and tells in the same order give
    the same candidates: whatever concerns candidate i is drawn from `draws(seed, i)`.
    """

    Options: ClassVar[type]

    def __init__(self, logical: LogicalScenario, seed: int, options: Any) -> None: ...

    def ask(self) -> Candidate:
        """The next candidate.

        Raises:
            SearchExhausted: if there is none.
        """
        ...

    def tell(self, candidate: Candidate, trace: Trace, verdict: Verdict) -> Mapping[str, Any]:
        """Learn from an execution.

        Returns:
            What was learned about it, as JSON values for its record.
        """
        ...

    def status(self) -> Mapping[str, float]:
        """Figures for the live display, by name."""
        ...


def draws(seed: int, number: int, *purpose: int) -> np.random.Generator:
    """The random numbers of one candidate: they depend on nothing but the campaign's seed and its number.

    Args:
        seed: of the campaign.
        number: of the candidate.
        purpose: tells draws apart that one candidate needs at different times.
    """
    return np.random.default_rng([seed, number, *purpose])
