"""Confirmation of failures that the compiled engine found, in highway-env itself."""

from typing import Final

import numpy as np

from behavexplor.data.scenario import Scenario
from behavexplor.data.trace import Trace
from behavexplor.execution.rollout import ADSError
from behavexplor.execution.simulation import Simulation
from behavexplor.judge.specs import DIFFERS, SPECS

TOLERANCE: Final = (
    0.1  # greatest difference of two equal motions [m]; it begins in the last bit, and traffic amplifies it
)


def confirmed(simulation: Simulation, scenario: Scenario, trace: Trace) -> Trace:
    """Return the trace of an execution, from highway-env itself if the execution failed.

    Args:
        simulation: simulation with the driving system and its environment.
        scenario: the executed scenario.
        trace: its trace from the compiled engine.

    Raises:
        ADSError: if highway-env's own trace is another one, or the driving system fails.
    """
    if not any(spec.violated(trace) for spec in SPECS):
        return trace
    reference = simulation.run(scenario)
    difference = _difference(trace, reference)
    if difference is not None:
        raise ADSError(DIFFERS, f"the compiled engine and highway-env disagree: {difference}")
    return reference


def _difference(trace: Trace, reference: Trace) -> str | None:
    """Return how two traces differ; None if they do not."""
    for name in ("end", "partner"):
        if getattr(trace, name) != getattr(reference, name):
            return f"{name} is {getattr(trace, name)!r}, and {getattr(reference, name)!r} in highway-env"
    if trace.position.shape != reference.position.shape:
        return f"{trace.position.shape[:2]} frames and vehicles, and {reference.position.shape[:2]} in highway-env"
    apart = float(np.abs(trace.position - reference.position).max())
    return f"the vehicles are up to {apart:.3g} m apart" if apart > TOLERANCE else None
