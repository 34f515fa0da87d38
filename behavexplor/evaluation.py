"""How well an ADS drives: its rates of arrival and of violations over scenarios drawn uniformly."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from scipy.stats import binomtest

from behavexplor.data.trace import Trace
from behavexplor.execution.simulation import Simulation
from behavexplor.judge.fault import contact_fault
from behavexplor.judge.specs import SPECS, judge

STREAM: Final = 0x65_76_61_6C  # sets the scenarios of evaluations apart from those of campaigns and trainings


@dataclass(frozen=True)
class Evaluation:
    """What happened in a number of scenarios.

    Attributes:
        n: number of scenarios.
        counts: how many of them by what happened, in the order in which it is told: "arrived", each spec that was
            violated, each verdict on a collision behind "collision: ".
    """

    n: int
    counts: Mapping[str, int]

    @classmethod
    def of(cls, traces: Iterable[Trace]) -> Self:
        """Judge traces."""
        judged = [_outcomes(trace) for trace in traces]
        found = Counter(outcome for outcomes in judged for outcome in outcomes)
        faults = sorted(outcome for outcome in found if ": " in outcome)
        names = ["arrived", SPECS[0].name, *faults, *(spec.name for spec in SPECS[1:])]
        return cls(len(judged), {name: found[name] for name in names})

    def rate(self, outcome: str) -> float:
        """The share of scenarios with an outcome."""
        return self.counts.get(outcome, 0) / self.n

    def interval(self, outcome: str) -> tuple[float, float]:
        """The 95 % interval of a rate, after Wilson."""
        found = binomtest(self.counts.get(outcome, 0), self.n).proportion_ci(0.95, "wilson")
        return float(found.low), float(found.high)


def evaluate(simulation: Simulation, n: int, seed: int, observe: Callable[[int], None] | None = None) -> Evaluation:
    """Drive scenarios drawn uniformly.

    Args:
        simulation: the ADS in its environment.
        n: number of scenarios.
        seed: of the draw.
        observe: called with the number of scenarios done.
    """
    generator = np.random.default_rng([STREAM, seed])
    scenarios = [simulation.logical.sample(generator) for _ in range(n)]
    traces: list[Trace] = []
    for _, trace in simulation.run_all(scenarios):
        traces.append(trace)
        if observe is not None:
            observe(len(traces))
    return Evaluation.of(traces)


def _outcomes(trace: Trace) -> list[str]:
    verdict = judge(trace, SPECS)
    outcomes = ["arrived"] if trace.end == "arrived" else []
    outcomes += verdict.violated
    fault = contact_fault(trace)
    return [*outcomes, f"{SPECS[0].name}: {fault}"] if fault else outcomes
