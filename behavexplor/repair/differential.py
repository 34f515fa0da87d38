"""Differential search: scenarios in which one of two drivers fails and the other does not.

Any search method searches for them. Its requirements are "the first driver does not fail alone" and "the second driver
does not fail alone".
"""

from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

from behavexplor.campaign.record import ERROR
from behavexplor.data.logical import LogicalScenario
from behavexplor.data.scenario import Scenario
from behavexplor.data.trace import Trace
from behavexplor.execution.evaluator import EXECUTE
from behavexplor.execution.executor import ADSError, Executor
from behavexplor.fuzz.search import Candidate, SearchExhausted, SearchMethod
from behavexplor.judge.fault import collision_fault, is_at_fault
from behavexplor.judge.specs import DIFFERS, Spec, Verdict, judge

ONLY_FIRST, ONLY_SECOND = "only-first-fails", "only-second-fails"
BOTH_FAIL: Final = 1.0  # degree of a scenario in which both drivers fail [m], as if one of them nearly failed


class Driven(NamedTuple):
    """A driver of a differential search.

    Attributes:
        executor: executor of the driver.
        logical: logical scenario of its environment.
    """

    executor: Executor
    logical: LogicalScenario


@dataclass(frozen=True)
class Difference:
    """A scenario in which one driver fails and the other does not.

    Attributes:
        number: number of the candidate.
        fails: `ONLY_FIRST` or `ONLY_SECOND`.
        scenario: the scenario, as one of the first driver.
    """

    number: int
    fails: str
    scenario: Scenario


def search_differences(
    method: SearchMethod,
    first: Driven,
    second: Driven,
    specs: Sequence[Spec],
    *,
    budget: int,
    batch: int,
    observe: Callable[[int], None],
) -> list[Difference]:
    """Search for scenarios in which one driver fails and the other does not.

    Args:
        method: search method for the logical scenario of the first driver. It learns from the traces of that driver.
        first: the first driver.
        second: the second driver.
        specs: the specs that judge both drivers.
        budget: number of scenarios that are executed with both drivers.
        batch: number of scenarios in flight.
        observe: function that is called with the number of executed scenarios.

    Returns:
        The differences in the order in which the method proposed them. They do not depend on the executors.

    Raises:
        RuntimeError: if a scenario could not be executed.
    """
    found: list[Difference] = []
    pending: deque[tuple[Candidate, Future[bytes], Future[bytes]]] = deque()
    asked = done = 0
    while True:
        try:
            while len(pending) < batch and asked < budget:
                candidate = method.ask()
                pending.append((candidate, _submitted(first, candidate), _submitted(second, candidate)))
                asked += 1
        except SearchExhausted:
            budget = asked
        if not pending:
            return found
        candidate, *futures = pending.popleft()
        one, other = (_result(first, candidate.scenario, future) for future in futures)
        verdict = difference(verdict_at_fault(*one, specs), verdict_at_fault(*other, specs))
        found += [Difference(candidate.number, name, candidate.scenario) for name in verdict.violated]
        method.tell(candidate, one[0], verdict)
        done += 1
        observe(done)


def difference(first: Verdict, second: Verdict) -> Verdict:
    """Return the verdict on a scenario from those on both drivers, with `ONLY_FIRST` and `ONLY_SECOND` as specs."""
    alone = {ONLY_FIRST: (first, second), ONLY_SECOND: (second, first)}
    degrees = {name: _degree(fails, holds) for name, (fails, holds) in alone.items()}
    return Verdict(degrees, tuple(name for name, (fails, holds) in alone.items() if fails.failed and not holds.failed))


def _degree(fails: Verdict, holds: Verdict) -> float:
    """Return how far a scenario is from one in which only one driver fails [m], by the nearest spec of that driver."""
    nearest = 0.0 if fails.failed else min(fails.degrees.values())
    return nearest + (BOTH_FAIL if holds.failed else 0.0)


def _submitted(driven: Driven, candidate: Candidate) -> "Future[bytes]":
    return driven.executor.submit(EXECUTE, driven.logical.adopted(candidate.scenario).to_json().encode())


def _result(first: Driven, scenario: Scenario, future: "Future[bytes]") -> tuple[Trace, str | None]:
    """Return the trace of an execution, and the kind of the failure if the ADS failed instead of driving."""
    try:
        return Trace.from_bytes(future.result()), None
    except ADSError as error:
        return first.logical.first_frame(scenario, ERROR), error.kind


def verdict_at_fault(trace: Trace, error: str | None, specs: Sequence[Spec]) -> Verdict:
    """Return the verdict on a driver. Only failures at fault count, see `behavexplor.campaign.record.Record.at_fault`.

    Args:
        trace: trace of an execution.
        error: kind of the failure if the driver failed instead of driving; None if it drove.
        specs: the specs that judge it.
    """
    verdict = judge(trace, specs)
    if error is not None:
        return replace(verdict, violated=() if error == DIFFERS else (ERROR,))
    return verdict if is_at_fault(collision_fault(trace, verdict.violated)) else replace(verdict, violated=())
