"""Confirmation of failures that the compiled engine found, in highway-env itself."""

from typing import Final

import numpy as np

from behavexplor.data.scenario import Scenario
from behavexplor.data.trace import Trace
from behavexplor.execution.executor import ADSError
from behavexplor.execution.simulation import Simulation
from behavexplor.judge.specs import DIFFERS, SPECS

TOLERANCE: Final = (
    0.1  # greatest difference of two equal motions [m]; it begins in the last bit, and traffic amplifies it
)


def confirmed(simulation: Simulation, scenario: Scenario, driven: Trace | ADSError) -> Trace:
    """Return the trace of an execution, from highway-env itself if the execution failed.

    If highway-env's own execution is another one, the compiled engine repeats its own: only if that is the same again,
    the two engines disagree. Otherwise the driving system does not do the same twice.

    Args:
        simulation: simulation with the driving system and its environment.
        scenario: the executed scenario.
        driven: its trace from the compiled engine, or the failure of the driving system there.

    Raises:
        ADSError: if the driving system fails in highway-env, or highway-env's own execution is another one.
    """
    if isinstance(driven, Trace) and not any(spec.violated(driven) for spec in SPECS):
        return driven
    reference = simulation.run(scenario)
    difference = _difference(driven, reference)
    if difference is None:
        return reference
    if _difference(driven, driven_compiled(simulation, scenario)) is None:
        raise ADSError(DIFFERS, f"the compiled engine and highway-env disagree: {difference}")
    if isinstance(driven, ADSError):
        raise ADSError(driven.kind, f"{driven.message}; repeated, it did not fail in the same scenario", driven.place)
    raise ADSError(
        DIFFERS,
        "the ADS did not drive a scenario in the same way when it was repeated, as if it drew its actions, or "
        "remembered earlier episodes",
    )


def repeated(simulation: Simulation, scenario: Scenario, driven: Trace) -> Trace:
    """Return the trace of an execution in highway-env, after a second execution if it failed.

    Args:
        simulation: simulation with the driving system and its environment.
        scenario: the executed scenario.
        driven: its trace.

    Raises:
        ADSError: if the second execution is another one.
    """
    if not any(spec.violated(driven) for spec in SPECS):
        return driven
    difference = _difference(driven, simulation.run(scenario), "when it was repeated")
    if difference is None:
        return driven
    raise ADSError(DIFFERS, f"the scenario does not repeat in highway-env: {difference}")


def driven_compiled(simulation: Simulation, scenario: Scenario) -> Trace | ADSError:
    """Return the outcome of a scenario alone in the compiled engine.

    Raises:
        InputError: if the engine cannot begin the scenario, or the scenario is not one of this environment.
    """
    try:
        ((_, trace),) = simulation.run_all([scenario])
    except ADSError as error:
        return error
    return trace


def _difference(driven: Trace | ADSError, other: Trace | ADSError, where: str = "in highway-env") -> str | None:
    """Return how an outcome in highway-env differs from one in the compiled engine; None if it does not."""
    if isinstance(driven, ADSError) or isinstance(other, ADSError):
        kinds = [one.kind if isinstance(one, ADSError) else "" for one in (driven, other)]
        return None if kinds[0] == kinds[1] else f"only in one of them, {driven if kinds[0] else other}"
    for name in ("end", "partner"):
        if getattr(driven, name) != getattr(other, name):
            return f"{name} is {getattr(driven, name)!r}, and {getattr(other, name)!r} {where}"
    if driven.position.shape != other.position.shape:
        return f"{driven.position.shape[:2]} frames and vehicles, and {other.position.shape[:2]} {where}"
    apart = float(np.abs(driven.position - other.position).max())
    return f"the vehicles are up to {apart:.3g} m apart" if apart > TOLERANCE else None
