"""The true cause of a failure of the rule planner: the weakness without which it does not happen.

The weaknesses are those of paper section IV-B2, where people found them by looking at recordings. Here a failing
drive is replayed exactly up to some seconds before its violation, and goes on from there with other weaknesses: if
the violation is gone with one switched off, that one was *necessary*; if it is still there with all the others of the
same spec switched off, that one is *sufficient*. Where two weaknesses lead to the same violation, each is sufficient
and none necessary. A drive that misses its destination did so by something that it never did: there the whole drive
is repeated.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np

from behavexplor.ads.rule import RulePlanner
from behavexplor.ads.rule.weaknesses import WEAKNESSES
from behavexplor.data.decision_log import ENVIRONMENT, UNKNOWN, weakness_names
from behavexplor.data.scenario import Scenario
from behavexplor.data.trace import Trace
from behavexplor.execution.simulation import Simulation
from behavexplor.judge.events import R3, REQUIREMENTS, ViolationEvent, recent_decisions, violation_event
from behavexplor.judge.specs import judge
from behavexplor.triage.forks import Fork, run_forks, without

OUTLOOKS: Final = (6.0, 15.0)  # before a violation, in which its causes are looked for; the longer if in vain [s]
AFTERMATH: Final = 6.0  # behind it: a violation that is put off for longer is another one [s]
UPSTREAM: Final = ("prediction", "decision", "path", "speed", "control")  # the order of the planner's modules


@dataclass(frozen=True)
class Cause:
    """Why the rule planner failed.

    Attributes:
        primary: the weakness to blame, see `primary_cause`; or "environment" where the planner without any weakness
            violates the same spec, and "unknown" where no single weakness is to blame.
        necessary: the weaknesses without which the violation does not happen, upstream first.
        sufficient: the weaknesses of the violated spec with which it happens without any other of them, upstream first.
    """

    primary: str
    necessary: tuple[str, ...]
    sufficient: tuple[str, ...]


def find_cause(simulation: Simulation, scenario: Scenario, trace: Trace) -> Cause | None:
    """The cause of the first violated spec, R1 before R2 before R3.

    Args:
        simulation: with the ADS that drove, in the environment where it did.
        scenario: that was driven.
        trace: of it, with the decision log.

    Returns:
        None if nothing is violated, or the ADS is not the rule planner.
    """
    planner = simulation.ads
    event = violation_event(trace, judge(trace).violated)
    if event is None or not isinstance(planner, RulePlanner):
        return None
    hardened = Fork(without(planner.parameters, _switches(WEAKNESSES)))
    careful = run_forks(simulation, scenario, trace, [hardened])[0]
    necessary: tuple[str, ...] = ()
    sufficient: tuple[str, ...] = ()
    for outlook in OUTLOOKS if event.spec != R3 else (trace.duration,):
        if not (necessary or sufficient):
            necessary, sufficient = _causes(simulation, scenario, trace, event, outlook)
    if _violates(careful, event.spec):
        return Cause(ENVIRONMENT, necessary, sufficient)
    return Cause(primary_cause(event.spec, necessary, sufficient), necessary, sufficient)


def primary_cause(spec: str, necessary: tuple[str, ...], sufficient: tuple[str, ...]) -> str:
    """The one weakness to blame.

    A weakness that shows as a violation of this very spec goes before one that only led there (an overtaking without
    room to return lets another weakness overshoot the line); then who is necessary and sufficient before who is
    necessary before who is sufficient; then upstream first.
    """
    both = tuple(name for name in necessary if name in sufficient)
    order = (*both, *necessary, *sufficient, UNKNOWN)
    return next((name for name in order if name.startswith(spec)), order[0])


def suspected(trace: Trace, event: ViolationEvent, outlook: float) -> tuple[str, ...]:
    """The weaknesses that were reached in the time before a violation [s], upstream first."""
    bits = trace.decisions["reached"][recent_decisions(trace, event.frame, outlook)]
    return upstream_first(weakness_names(int(np.bitwise_or.reduce(bits.astype(np.int64)))))


def upstream_first(weaknesses: Iterable[str]) -> tuple[str, ...]:
    """Weaknesses in the order of the modules that they sit in."""
    return tuple(sorted(weaknesses, key=lambda name: UPSTREAM.index(WEAKNESSES[name].module)))


def _causes(
    simulation: Simulation, scenario: Scenario, trace: Trace, event: ViolationEvent, outlook: float
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The necessary and the sufficient weaknesses, if others are switched off so long before the violation [s].

    No weakness of the violated spec is sufficient if the violation happens without any of them.
    """
    planner = simulation.ads
    assert isinstance(planner, RulePlanner)  # noqa: S101 - asked before
    decisions = recent_decisions(trace, event.frame, outlook)
    begin = int(decisions[0]) if len(decisions) else 0
    until = None if event.spec == R3 else float(trace.time[event.frame]) + AFTERMATH
    suspects = suspected(trace, event, outlook)
    family = {name for name in WEAKNESSES if name.startswith(event.spec)}
    kin = [name for name in suspects if name in family]
    off = [set(WEAKNESSES), family, *({name} for name in suspects), *(family - {name} for name in kin)]
    forks = [Fork(without(planner.parameters, _switches(switched)), begin) for switched in off]
    others = run_forks(simulation, scenario, trace, forks, until)
    too_late, without_kin, *fails = (_violates(other, event.spec, until) for other in others)
    if too_late:  # whatever is switched off
        return (), ()
    necessary = tuple(name for name, fail in zip(suspects, fails, strict=False) if not fail)
    alone = tuple(name for name, fail in zip(kin, fails[len(suspects) :], strict=True) if fail)
    return necessary, () if without_kin else alone


def _violates(trace: Trace, spec: str, until: float | None = None) -> bool:
    """Whether a drive violates a spec, up to a time [s]."""
    violated = tuple(name for name in judge(trace).violated if REQUIREMENTS.get(name) == spec)
    event = violation_event(trace, violated)
    return event is not None and (until is None or bool(trace.time[event.frame] <= until))


def _switches(weaknesses: Iterable[str]) -> list[str]:
    return [WEAKNESSES[name].parameter for name in weaknesses]
