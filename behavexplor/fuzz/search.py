"""The interface between a campaign and its search method, in the ask-and-tell style.

The campaign asks for a scenario, executes it, and tells the search method the result.
"""

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Protocol

from behavexplor.data.scenario import LogicalScenario, Scenario
from behavexplor.data.scenario import draws as draws  # noqa: PLC0414 - it belongs to this interface
from behavexplor.data.trace import Trace
from behavexplor.judge.specs import Verdict

INITIAL, UNIFORM = "initial", "uniform"  # origins of candidates without a parent
MAX_POPULATION = 1000  # greatest population of a method that compares all pairs of its members
MAX_FAILED_INITIAL = 1000  # a search ends if this many initial scenarios have all failed


class SearchExhausted(Exception):  # noqa: N818 - it ends a campaign, nothing went wrong
    """The search has no further candidates. The message is a sentence that says why."""


@dataclass(frozen=True)
class Candidate:
    """A scenario that a search method proposes for execution.

    Attributes:
        number: index of the candidate, counted from 0 in the order in which the campaign asked for candidates.
        scenario: the scenario, which is valid in the campaign's logical scenario.
        origin: origin of the scenario, such as "initial" or the kind of its mutation.
        parent: number of the candidate that was mutated; None without a parent.
    """

    number: int
    scenario: Scenario
    origin: str
    parent: int | None


class UniformCandidate(Candidate):
    """A uniform candidate, whose scenario is drawn when `scenario` is first read.

    Workers can draw it as well: it is the `sample` of the logical scenario by `draws(seed, number)`.

    Attributes:
        seed: seed of the campaign.
    """

    seed: int
    _logical: LogicalScenario

    def __init__(self, number: int, logical: LogicalScenario, seed: int) -> None:
        vars(self).update(number=number, origin=UNIFORM, parent=None, seed=seed, _logical=logical)  # it is frozen

    @cached_property
    def scenario(self) -> Scenario:
        """The scenario."""
        return self._logical.sample(draws(self.seed, self.number))


def nothing_to_mutate(failed: int) -> SearchExhausted:
    """Return the exception that ends a search whose initial scenarios all failed."""
    return SearchExhausted(f"All {failed} initial scenarios failed, so the search has no scenario to mutate.")


class SearchMethod(Protocol):
    """A search for failures. It knows scenarios, traces and verdicts, but neither the simulator nor the ADS.

    A search method is built as `method(logical, seed, options)`, where `options` is an instance of the frozen dataclass
    `method.Options`. The first line of the class docstring is the method's description in the help text. Many
    candidates may be in flight, but their results arrive in the order in which the method proposed them. The same
    sequence of calls of `ask` and `tell` must give the same candidates. So draw every random choice for candidate i
    from `draws(seed, i)`.

    A method may have an attribute `foreseen`: how many of its next candidates no further result can change, such as
    the rest of a generation. A campaign asks for them early, so that all workers have enough to do. With an attribute
    `uses_nearness` that is true, the processes that judge also compute what
    `behavexplor.judge.closest_approach.Nearness.of` returns.
    """

    Options: ClassVar[type]

    def __init__(self, logical: LogicalScenario, seed: int, options: Any) -> None: ...

    def ask(self) -> Candidate:
        """Return the next candidate.

        Raises:
            SearchExhausted: if there are no further candidates.
        """

    def tell(self, candidate: Candidate, trace: Trace, verdict: Verdict) -> Mapping[str, Any]:
        """Learn from an execution.

        Returns:
            Figures about the execution, as JSON values for its record.
        """

    def status(self) -> Mapping[str, float]:
        """Return figures for the live display, by name."""


class WithoutLearning:
    """The common part of methods that learn nothing: no result changes any candidate."""

    foreseen = sys.maxsize  # see `SearchMethod`

    def tell(self, candidate: Candidate, trace: Trace, verdict: Verdict) -> Mapping[str, Any]:  # noqa: ARG002
        """Ignore the execution, and return no figures."""
        return {}

    def status(self) -> Mapping[str, float]:
        """Return no figures."""
        return {}
