"""Evaluation of an ADS: rates of arrival and violations over uniformly drawn scenarios."""

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

STREAM: Final = 0x65_76_61_6C  # separates the scenarios of evaluations from those of campaigns and trainings


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
        """Judge traces and count their outcomes."""
        judged = [_outcomes(trace) for trace in traces]
        found = Counter(outcome for outcomes in judged for outcome in outcomes)
        faults = sorted(outcome for outcome in found if ": " in outcome)
        names = ["arrived", SPECS[0].name, *faults, *(spec.name for spec in SPECS[1:])]
        return cls(len(judged), {name: found[name] for name in names})

    def rate(self, outcome: str) -> float:
        """Return the share of scenarios with an outcome."""
        return self.counts.get(outcome, 0) / self.n

    def interval(self, outcome: str) -> tuple[float, float]:
        """Return the 95 % Wilson interval of a rate."""
        found = binomtest(self.counts.get(outcome, 0), self.n).proportion_ci(0.95, "wilson")
        return float(found.low), float(found.high)


def estimate_rates(
    simulation: Simulation, n: int, seed: int, observe: Callable[[int], None] | None = None
) -> Evaluation:
    """Evaluate an ADS in uniformly drawn scenarios.

    Args:
        simulation: simulation with the ADS and its environment.
        n: number of scenarios.
        seed: seed of the random scenarios.
        observe: callback that gets the number of finished scenarios.
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
