"""Evaluation of an ADS: rates of arrival and violations over uniformly drawn scenarios."""

import json
import math
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import islice
from typing import Final, NamedTuple, Self

import numpy as np

from behavexplor.ads.interface import ADS
from behavexplor.data.logical import LogicalScenario
from behavexplor.data.scenario import Scenario
from behavexplor.data.target import Target
from behavexplor.data.trace import ARRIVED, CRASHED, OFF_ROAD, Trace
from behavexplor.execution.evaluator import EXECUTE, Evaluator, recipe_for
from behavexplor.execution.executor import Executor
from behavexplor.execution.start import start_executor, start_in_process
from behavexplor.judge.fault import collision_fault, contact_fault, is_at_fault
from behavexplor.judge.rates import AT_FAULT, FAILED, Decision, Goal, clopper_pearson
from behavexplor.judge.specs import SPECS, judge

STREAM: Final = 0x65_76_61_6C  # separates the scenarios of evaluations from those of campaigns and trainings
_BETWEEN_LOOKS: Final = 1.005  # ratio of the numbers of scenarios at two looks at a rate
AHEAD: Final = 1024  # scenarios under way, enough for many processes in lock-step


_SIGNALS: Final = {ARRIVED: ARRIVED, SPECS[1].name: OFF_ROAD, SPECS[2].name: ARRIVED}  # that an outcome needs


class Outcomes(NamedTuple):
    """What happened in one scenario.

    Attributes:
        found: the outcomes, see `Evaluation`.
        asked: the outcomes, beside the verdicts on a collision, that mean something in the environment.
        at_fault: whether the driver failed by its own fault; see `behavexplor.campaign.record.Record.at_fault`.
    """

    found: list[str]
    asked: list[str]
    at_fault: bool

    @property
    def passed(self) -> bool:
        """True if the driver did not fail."""
        return set(self.found) <= {ARRIVED}


@dataclass(frozen=True)
class Evaluation:
    """Outcomes of a number of scenarios.

    Attributes:
        n: number of scenarios.
        counts: number of scenarios by outcome: "arrived", each spec for its violations, and "collision: " with each
            verdict on a collision. Outcomes are in the order in which they are reported.
        decision: what was decided on a rate, if the evaluation ended when enough was known. Its number of scenarios
            then depends on what happened in them, so `interval` does not hold, but that of the decision does.
    """

    n: int
    counts: Mapping[str, int]
    decision: Decision | None = None

    @classmethod
    def of(cls, traces: Iterable[Trace]) -> Self:
        """Judge traces and count their outcomes."""
        return cls.of_outcomes(map(outcomes_of, traces))

    @classmethod
    def of_outcomes(cls, scenarios: Iterable[Outcomes]) -> Self:
        """Count the outcomes of scenarios. An outcome that means nothing in any of them is left out."""
        judged = list(scenarios)
        found = Counter(outcome for one in judged for outcome in one.found)
        asked = {outcome for one in judged for outcome in one.asked}
        faults = sorted(outcome for outcome in found if ": " in outcome)
        names = [ARRIVED, SPECS[0].name, *faults, *(spec.name for spec in SPECS[1:])]
        return cls(len(judged), {name: found[name] for name in names if name in asked or name in faults})

    def rate(self, outcome: str) -> float:
        """Return the share of scenarios with an outcome."""
        return self.counts.get(outcome, 0) / self.n

    def interval(self, outcome: str) -> tuple[float, float]:
        """Return the exact 95 % interval of a rate (Clopper and Pearson)."""
        return clopper_pearson(self.counts.get(outcome, 0), self.n)


class Judge(Evaluator):
    """An evaluator that tells the outcomes of a scenario instead of its trace, which takes longer to pack."""

    def answer(self, trace: Trace) -> bytes:
        """Return the `Outcomes` as a JSON list."""
        return json.dumps(outcomes_of(trace)).encode()


def start_judge(target: Target, workers: int, driver: ADS | None = None) -> Executor:
    """Start the executor for `estimate_rates`; see `behavexplor.execution.start.start_executor`.

    Args:
        target: the driving system and its environment.
        workers: number of worker processes.
        driver: object of this process that drives in place of the driving system of that name; None for none.
    """
    recipe = recipe_for(Judge, target)
    return (
        start_executor(target, workers, recipe=recipe) if driver is None else start_in_process(target, driver, recipe)
    )


def estimate_rates(
    judge: Executor, logical: LogicalScenario, n: int, seed: int, observe: Callable[[int], None] | None = None
) -> Evaluation:
    """Evaluate an ADS in uniformly drawn scenarios. The result does not depend on the number of workers.

    Args:
        judge: executor of the ADS, see `start_judge`.
        logical: logical scenario of its environment.
        n: number of scenarios.
        seed: seed of the random scenarios.
        observe: callback that gets the number of finished scenarios.

    Raises:
        ADSError: if the ADS fails in a scenario.
        RuntimeError: if a scenario could not be executed.
    """
    return Evaluation.of_outcomes(uniform_outcomes(judge, logical, n, seed, observe))


def decide_rate(
    judge: Executor,
    logical: LogicalScenario,
    goal: Goal,
    most: int,
    seed: int,
    observe: Callable[[int], None] | None = None,
) -> Evaluation:
    """Evaluate an ADS in uniformly drawn scenarios until a goal is reached. Workers do not change the result.

    Args:
        judge: see `estimate_rates`.
        logical: see `estimate_rates`.
        goal: what is to be known.
        most: greatest number of scenarios.
        seed: see `estimate_rates`.
        observe: see `estimate_rates`.

    Raises:
        ADSError: if the ADS fails in a scenario.
        RuntimeError: if a scenario could not be executed.
    """
    judged: list[Outcomes] = []
    count, look = 0, 1
    for one in uniform_outcomes(judge, logical, most, seed, observe):
        judged.append(one)
        count += _has(one, goal.outcome)
        if len(judged) < look:
            continue
        look = math.ceil(len(judged) * _BETWEEN_LOOKS)
        if Decision.of(goal, len(judged), count).verdict:
            break
    return replace(Evaluation.of_outcomes(judged), decision=Decision.of(goal, len(judged), count))


def _has(one: Outcomes, outcome: str) -> bool:
    """Return whether an outcome of a goal happened in a scenario."""
    if outcome == AT_FAULT:
        return one.at_fault
    return not one.passed if outcome == FAILED else outcome in one.found


def uniform_outcomes(
    judge: Executor, logical: LogicalScenario, n: int, seed: int, observe: Callable[[int], None] | None = None
) -> Iterator[Outcomes]:
    """Yield the outcomes of uniformly drawn scenarios in their order; see `estimate_rates`."""
    generator = np.random.default_rng([STREAM, seed])
    return outcomes_in(judge, (logical.sample(generator) for _ in range(n)), observe)


def outcomes_in(
    judge: Executor, scenarios: Iterable[Scenario], observe: Callable[[int], None] | None = None
) -> Iterator[Outcomes]:
    """Execute scenarios and yield their outcomes in order. At most `AHEAD` of them are under way."""
    requests = (scenario.to_json().encode() for scenario in scenarios)
    waiting = deque(judge.submit(EXECUTE, request) for request in islice(requests, AHEAD))
    done = 0
    while waiting:
        yield Outcomes(*json.loads(waiting.popleft().result()))
        waiting.extend(judge.submit(EXECUTE, request) for request in islice(requests, 1))
        done += 1
        if observe is not None:
            observe(done)


def outcomes_of(trace: Trace) -> Outcomes:
    """Judge a trace."""
    verdict = judge(trace, SPECS)
    arrived = trace.signals[ARRIVED].any() if ARRIVED in trace.signals else trace.end == ARRIVED
    arrived = arrived and trace.end != "collision"  # in a roundabout, an ego may get beyond the entry and crash there
    found = [*([ARRIVED] if arrived else []), *verdict.violated]
    fault = contact_fault(trace)
    if fault:
        found.append(f"{SPECS[0].name}: {fault}")
    names = (ARRIVED, *(spec.name for spec in SPECS))
    asked = [name for name in names if not trace.signals or _SIGNALS.get(name, CRASHED) in trace.signals]
    at_fault = bool(verdict.violated) and is_at_fault(collision_fault(trace, verdict.violated))
    return Outcomes(found, asked, at_fault)
