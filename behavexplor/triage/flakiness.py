"""Reproducibility of a failure, checked by a second execution."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from behavexplor.data.scenario import Scenario
from behavexplor.data.trace import Trace
from behavexplor.execution.ads_error import ADSError
from behavexplor.execution.simulation import Simulation
from behavexplor.judge.specs import SPECS, Spec, judge


@dataclass(frozen=True)
class Repetition:
    """Comparison of a second execution of a scenario with the first.

    Attributes:
        same_verdict: whether both violated the same specs.
        same_trace: whether both have the same trace, to the resolution of traces.
        deviation: greatest distance between the ego's positions at the same time, over the shorter execution [m].
    """

    same_verdict: bool
    same_trace: bool
    deviation: float


def repeat(simulation: Simulation, scenario: Scenario, trace: Trace, specs: Sequence[Spec] = SPECS) -> Repetition:
    """Execute a scenario again and compare the traces.

    Args:
        simulation: simulation with the same ADS and environment as in the recorded execution.
        scenario: the executed scenario.
        trace: its recorded trace.
        specs: specs that judge both traces.
    """
    try:
        again = simulation.run(scenario)
    except ADSError:
        return Repetition(same_verdict=False, same_trace=False, deviation=0.0)
    frames = min(len(again.time), len(trace.time))
    apart = again.position[:frames, 0] - trace.position[:frames, 0]
    return Repetition(
        same_verdict=judge(again, specs).violated == judge(trace, specs).violated,
        same_trace=again.to_bytes() == trace.to_bytes(),
        deviation=float(np.hypot(apart[:, 0], apart[:, 1]).max()),
    )
