"""Contract test for search methods; see `behavexplor.fuzz.search.SearchMethod` for the contract."""

import json
import math
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, is_dataclass
from typing import Any, Final

from behavexplor.data.logical import LogicalScenario
from behavexplor.data.trace import Trace
from behavexplor.errors import InputError
from behavexplor.execution.simulation import logical_scenario
from behavexplor.fuzz.methods import load_method
from behavexplor.fuzz.search import Candidate, SearchExhausted, SearchMethod
from behavexplor.judge.specs import Verdict, judge
from behavexplor.testing.contracts import ContractError, promise
from behavexplor.testing.synthetic import synthetic_trace

IN_FLIGHT: Final = (1, 8)  # tested numbers of candidates in flight
SEEDS: Final = (0, 1)

Judge = Callable[[Trace], Verdict]


@dataclass(frozen=True)
class _Told:
    """One step of a campaign: a candidate, its trace and verdict, and the values that `tell` returned."""

    candidate: Candidate
    trace: Trace
    verdict: Verdict
    learned: Mapping[str, Any]


def check_search_method(
    method: str | type[SearchMethod], options: Any = None, *, env: str = "intersection-straight", executions: int = 60
) -> None:
    """Check that a search method keeps the promises of `behavexplor.fuzz.search.SearchMethod`.

    The method runs on synthetic traces, so no simulator is needed.

    Args:
        method: the class, or its name as for `--method`.
        options: an instance of the method's `Options`; None for the default options.
        env: the environment whose scenarios are searched.
        executions: number of executions in each test campaign.

    Raises:
        ContractError: if a promise is broken.
        InputError: if there is no such method or environment.
    """
    kind = load_method(method) if isinstance(method, str) else method
    _check_class(kind)
    logical = logical_scenario(env)
    chosen = kind.Options() if options is None else options

    def build(seed: int) -> SearchMethod:
        return kind(logical, seed, chosen)

    for in_flight in IN_FLIGHT:
        first, again = (_campaign(build(SEEDS[0]), logical, executions, in_flight) for _ in range(2))
        promise(
            [_asked(told) for told in first] == [_asked(told) for told in again],
            f"Two searches with the seed {SEEDS[0]} and {in_flight} candidates in flight asked for different "
            f"scenarios: draw random numbers from behavexplor.fuzz.search.draws(seed, number) only",
        )
        promise(
            [dict(told.learned) for told in first] == [dict(told.learned) for told in again],
            "Two searches with the same seed returned different values from tell",
        )
    _check_resuming(build, logical, executions)
    other = _campaign(build(SEEDS[1]), logical, executions, 1)
    promise(
        {told.candidate.scenario for told in first} != {told.candidate.scenario for told in other},
        f"The seeds {SEEDS[0]} and {SEEDS[1]} gave the same scenarios: use the seed",
    )
    for judged in (_all_fail, _none_fails):
        with suppress(SearchExhausted):  # a search may have nothing left to ask for
            _campaign(build(SEEDS[0]), logical, executions, IN_FLIGHT[-1], judged)


def _check_class(kind: Any) -> None:
    promise(isinstance(kind, type), f"{kind!r} is not a class: a campaign makes it as method(logical, seed, options)")
    for name in ("Options", "ask", "tell", "status"):
        promise(hasattr(kind, name), f"{kind.__name__} has no {name}")
    promise(is_dataclass(kind.Options), f"{kind.__name__}.Options is not a dataclass")
    promise((kind.__doc__ or "").strip(), f"{kind.__name__} has no docstring: its first line is its description")


def _campaign(
    search: SearchMethod, logical: LogicalScenario, executions: int, in_flight: int, judged: Judge = judge
) -> list[_Told]:
    """Run a search on synthetic traces, as a campaign does."""
    waiting: deque[Candidate] = deque()
    told: list[_Told] = []
    while len(told) < executions:
        while len(waiting) < min(in_flight, executions - len(told)):
            waiting.append(search.ask())
        candidate = waiting.popleft()
        _check_candidate(candidate, len(told), logical)
        trace = synthetic_trace(candidate.scenario, logical)
        verdict = judged(trace)
        told.append(_Told(candidate, trace, verdict, search.tell(candidate, trace, verdict)))
        _check_learned(told[-1], search)
    return told


def _check_candidate(candidate: Candidate, number: int, logical: LogicalScenario) -> None:
    promise(candidate.number == number, f"Candidate {number} has the number {candidate.number}: count from 0")
    promise(candidate.origin, f"Candidate {number} has no origin: say how it was made")
    promise(
        candidate.parent is None or 0 <= candidate.parent < number,
        f"Candidate {number} has the parent {candidate.parent}, which was not asked for before it",
    )
    try:
        logical.check(candidate.scenario)
    except InputError as error:
        raise ContractError(f"The scenario of candidate {number} cannot be run: {error}") from error


def _check_learned(told: _Told, search: SearchMethod) -> None:
    try:
        json.dumps(dict(told.learned), allow_nan=False)
    except (TypeError, ValueError) as error:
        raise ContractError(f"tell returned what is not JSON, {told.learned!r:.80}: {error}") from error
    status = search.status()
    promise(
        all(isinstance(value, (int, float)) and math.isfinite(value) for value in status.values()),
        f"status returned {dict(status)!r:.80}: give finite numbers by name",
    )


def _check_resuming(build: Callable[[int], SearchMethod], logical: LogicalScenario, executions: int) -> None:
    """Check that a fresh search continues like the first one after receiving the same results.

    A campaign is resumed in this way.
    """
    search = build(SEEDS[0])
    told = _campaign(search, logical, executions // 2, IN_FLIGHT[0])
    fresh = build(SEEDS[0])
    for step in told:
        candidate = fresh.ask()
        promise(candidate == step.candidate, f"A resumed search asked for another candidate {step.candidate.number}")
        fresh.tell(candidate, step.trace, step.verdict)
    with suppress(SearchExhausted):
        promise(
            fresh.ask() == search.ask(), "A resumed search asks for other scenarios: change state in ask and tell only"
        )


def _asked(told: _Told) -> tuple[Any, ...]:
    return told.candidate.number, told.candidate.origin, told.candidate.parent, told.candidate.scenario


def _all_fail(trace: Trace) -> Verdict:
    verdict = judge(trace)
    return Verdict(verdict.degrees, (next(iter(verdict.degrees)),))


def _none_fails(trace: Trace) -> Verdict:
    return Verdict(judge(trace).degrees, ())
