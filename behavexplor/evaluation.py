"""Evaluation of an ADS: rates of arrival and violations over uniformly drawn scenarios."""

from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from typing import Final, Self

import numpy as np
from scipy.stats import binomtest

from behavexplor.data.logical import LogicalScenario
from behavexplor.data.scenario import Scenario
from behavexplor.data.trace import ARRIVED, OFF_ROAD, Trace
from behavexplor.execution.evaluator import EXECUTE
from behavexplor.execution.executor import Executor
from behavexplor.judge.fault import contact_fault
from behavexplor.judge.specs import SPECS, judge

STREAM: Final = 0x65_76_61_6C  # separates the scenarios of evaluations from those of campaigns and trainings
AHEAD: Final = 1024  # scenarios under way, enough for many processes in lock-step

_SIGNALS: Final = {ARRIVED: ARRIVED, SPECS[1].name: OFF_ROAD, SPECS[2].name: ARRIVED}  # that an outcome needs


@dataclass(frozen=True)
class Evaluation:
    """Outcomes of a number of scenarios.

    Attributes:
        n: number of scenarios.
        counts: number of scenarios by outcome: "arrived", each spec for its violations, and "collision: " with each
            verdict on a collision. Outcomes are in the order in which they are reported.
    """

    n: int
    counts: Mapping[str, int]

    @classmethod
    def of(cls, traces: Iterable[Trace]) -> Self:
        """Judge traces and count their outcomes. In a stock environment, only those that mean something there."""
        judged: list[list[str]] = []
        signals: set[str] = set()
        for trace in traces:
            judged.append(_outcomes(trace))
            signals.update(trace.signals)
        found = Counter(outcome for outcomes in judged for outcome in outcomes)
        faults = sorted(outcome for outcome in found if ": " in outcome)
        names = [ARRIVED, SPECS[0].name, *faults, *(spec.name for spec in SPECS[1:])]
        foreign = {name for name, signal in _SIGNALS.items() if signals and signal not in signals}
        return cls(len(judged), {name: found[name] for name in names if name not in foreign})

    def rate(self, outcome: str) -> float:
        """Return the share of scenarios with an outcome."""
        return self.counts.get(outcome, 0) / self.n

    def interval(self, outcome: str) -> tuple[float, float]:
        """Return the 95 % Wilson interval of a rate."""
        found = binomtest(self.counts.get(outcome, 0), self.n).proportion_ci(0.95, "wilson")
        return float(found.low), float(found.high)


def estimate_rates(
    executor: Executor, logical: LogicalScenario, n: int, seed: int, observe: Callable[[int], None] | None = None
) -> Evaluation:
    """Evaluate an ADS in uniformly drawn scenarios. The result does not depend on the executor.

    Args:
        executor: executor of the ADS, see `behavexplor.execution.start.start_executor`.
        logical: logical scenario of its environment.
        n: number of scenarios.
        seed: seed of the random scenarios.
        observe: callback that gets the number of finished scenarios.

    Raises:
        ADSError: if the ADS fails in a scenario.
        RuntimeError: if a scenario could not be executed.
    """
    generator = np.random.default_rng([STREAM, seed])
    return Evaluation.of(_traces(executor, (logical.sample(generator) for _ in range(n)), observe))


def _traces(
    executor: Executor, scenarios: Iterable[Scenario], observe: Callable[[int], None] | None
) -> Iterator[Trace]:
    """Execute scenarios and yield their traces in order. At most `AHEAD` of them are under way."""
    requests = (scenario.to_json().encode() for scenario in scenarios)
    waiting = deque(executor.submit(EXECUTE, request) for request in islice(requests, AHEAD))
    done = 0
    while waiting:
        yield Trace.from_bytes(waiting.popleft().result())
        waiting.extend(executor.submit(EXECUTE, request) for request in islice(requests, 1))
        done += 1
        if observe is not None:
            observe(done)


def _outcomes(trace: Trace) -> list[str]:
    verdict = judge(trace, SPECS)
    arrived = trace.signals[ARRIVED].any() if ARRIVED in trace.signals else trace.end == ARRIVED
    outcomes = [ARRIVED] if arrived else []
    outcomes += verdict.violated
    fault = contact_fault(trace)
    return [*outcomes, f"{SPECS[0].name}: {fault}"] if fault else outcomes
