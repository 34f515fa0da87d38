"""Whether a failure happens again: only what does is a finding."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from behavexplor.data.scenario import Scenario
from behavexplor.data.trace import Trace
from behavexplor.execution.rollout import ADSError
from behavexplor.execution.simulation import Simulation
from behavexplor.judge.specs import SPECS, Spec, judge


@dataclass(frozen=True)
class Repetition:
    """What happened when a scenario was run again.

    Attributes:
        same_verdict: whether the same specs were violated.
        same_trace: whether the same happened, to the resolution of traces.
        deviation: greatest distance of the ego from where it was at the same time [m]; over the shorter of both.
    """

    same_verdict: bool
    same_trace: bool
    deviation: float


def repeat(simulation: Simulation, scenario: Scenario, trace: Trace, specs: Sequence[Spec] = SPECS) -> Repetition:
    """Run a scenario again and compare what happens.

    Args:
        simulation: with the ADS that drove, in the environment where it did.
        scenario: that was driven.
        trace: of it.
        specs: what judges both.
    """
    try:
        again = simulation.run(scenario)
    except ADSError:  # that is no trace at all
        return Repetition(same_verdict=False, same_trace=False, deviation=0.0)
    frames = min(len(again.time), len(trace.time))
    apart = again.position[:frames, 0] - trace.position[:frames, 0]
    return Repetition(
        same_verdict=judge(again, specs).violated == judge(trace, specs).violated,
        same_trace=again.to_bytes() == trace.to_bytes(),
        deviation=float(np.hypot(apart[:, 0], apart[:, 1]).max()),
    )
