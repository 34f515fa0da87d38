"""Causes of the rule planner's failures: the weaknesses without which a failure does not happen.

The weaknesses are those of paper section 4.1.2, whose authors found them in recordings. Here, a failed execution is
replayed exactly up to some seconds before its violation, and continues from there with other weaknesses. A weakness is
*necessary* if the violation disappears when that weakness is switched off. It is *sufficient* if the violation remains
when all other weaknesses of the same spec are switched off. Where two weaknesses lead to the same violation, each is
sufficient and none is necessary. A missed destination has no such point in time, since its cause is an omission. There,
the whole execution is repeated.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Final

import numpy as np

from behavexplor.ads.rule import Parameters, RulePlanner
from behavexplor.ads.rule.weaknesses import WEAKNESSES
from behavexplor.data.array_types import Bools, Floats
from behavexplor.data.roadmap import RoadMap
from behavexplor.data.scenario import Scenario
from behavexplor.data.trace import ENVIRONMENT, UNKNOWN, Trace, weakness_names
from behavexplor.execution.rollout import rollout, rollout_all
from behavexplor.execution.simulation import Simulation
from behavexplor.judge.events import R3, REQUIREMENTS, ViolationEvent, recent_decisions, violation_event
from behavexplor.judge.specs import judge

OUTLOOKS: Final = (6.0, 15.0)  # times before a violation from which causes are searched for, one after the other [s]
AFTERMATH: Final = 6.0  # a violation later than this after the recorded one is a different violation [s]
UPSTREAM: Final = ("prediction", "decision", "path", "speed", "control")  # the order of the planner's modules


@dataclass(frozen=True)
class Cause:
    """Why the rule planner failed."""

    # the weakness to blame, see `primary_cause`; "environment" if the planner without any weakness violates the same
    # spec; "unknown" if no single weakness is to blame
    primary: str
    # weaknesses without which the violation does not happen, upstream first
    necessary: tuple[str, ...]
    # weaknesses of the violated spec that cause the violation without any other weakness of that spec, upstream first
    sufficient: tuple[str, ...]


def find_cause(simulation: Simulation, scenario: Scenario, trace: Trace) -> Cause | None:
    """Return the cause of the first violated spec, in the order R1, R2, R3.

    It is None if no spec is violated, or the ADS is not the rule planner. The simulation must have the ADS and the
    environment of the recorded execution. The trace must have its decision log.
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
    """Return the weakness to blame.

    A weakness of the violated spec comes before one that only led to the situation. For example, overtaking without
    room to return lets another weakness overshoot the line. Then come weaknesses that are both necessary and
    sufficient, then necessary ones, then sufficient ones, each upstream first.
    """
    both = tuple(name for name in necessary if name in sufficient)
    order = (*both, *necessary, *sufficient, UNKNOWN)
    return next((name for name in order if name.startswith(spec)), order[0])


def suspected(trace: Trace, event: ViolationEvent, outlook: float) -> tuple[str, ...]:
    """Return the weaknesses reached in the last `outlook` [s] before a violation event, upstream first."""
    bits = trace.decisions["reached"][recent_decisions(trace, event.frame, outlook)]
    return upstream_first(weakness_names(int(np.bitwise_or.reduce(bits.astype(np.int64)))))


def upstream_first(weaknesses: Iterable[str]) -> tuple[str, ...]:
    """Sort weaknesses in the order of the planner's modules."""
    return tuple(sorted(weaknesses, key=lambda name: UPSTREAM.index(WEAKNESSES[name].module)))


def _causes(
    simulation: Simulation, scenario: Scenario, trace: Trace, event: ViolationEvent, outlook: float
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the necessary and the sufficient weaknesses, found by switching off weaknesses `outlook` [s] earlier.

    If the violation happens with all weaknesses of the violated spec switched off, none of them is sufficient.
    """
    planner = simulation.ads  # a `RulePlanner`, as `find_cause` has checked
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
    if too_late:  # the violation happens even with all weaknesses switched off
        return (), ()
    necessary = tuple(name for name, fail in zip(suspects, fails, strict=False) if not fail)
    alone = tuple(name for name, fail in zip(kin, fails[len(suspects) :], strict=True) if fail)
    return necessary, () if without_kin else alone


def _violates(trace: Trace, spec: str, until: float | None = None) -> bool:
    """Return whether an execution violates a spec, by the time `until` [s] if given."""
    violated = tuple(name for name in judge(trace).violated if REQUIREMENTS.get(name) == spec)
    event = violation_event(trace, violated)
    return event is not None and (until is None or bool(trace.time[event.frame] <= until))


def _switches(weaknesses: Iterable[str]) -> list[str]:
    return [WEAKNESSES[name].parameter for name in weaknesses]


def without(parameters: Parameters, names: Sequence[str]) -> Parameters:
    """Return parameters with the named ones, which are severities of weaknesses, set to 0."""
    return replace(parameters, **dict.fromkeys(names, 0.0))


@dataclass(frozen=True)
class Fork:
    """An alternative continuation of a recorded execution."""

    parameters: Parameters  # parameters of the planner after the fork
    decision: int = 0  # index of the first decision with these parameters; 0 for the whole execution


class ForkedPlanner:
    """An ADS that drives the egos of a batch as recorded, each up to its own fork.

    Up to its fork, an ego gets the recorded commands. Meanwhile, the recorded planner runs as well, so that the planner
    that takes over has the right memory. Row i of the batch is fork i. `planner` is the planner of the recorded
    execution, and `actions` are its commands, shape (D, 2).
    """

    def __init__(self, planner: RulePlanner, actions: Floats, forks: Sequence[Fork]) -> None:
        self._planner = planner
        self._actions = actions
        self._others = [_rule_planner(planner.roadmap, fork.parameters) for fork in forks]
        self._decision = np.array([fork.decision for fork in forks])
        self.observation: Mapping[str, Any] = planner.observation
        self.action: Mapping[str, Any] = planner.action
        self.policy_frequency = planner.policy_frequency

    def predict(
        self,
        observation: Floats,
        state: tuple[int, Floats | None] | None = None,
        episode_start: Bools | None = None,  # noqa: ARG002 - all egos begin together
        deterministic: bool = True,  # noqa: ARG002 - the planner is always deterministic
    ) -> tuple[Floats, tuple[int, Floats]]:
        """Return the commands of all egos, as in `behavexplor.ads.interface.ADS`. The state counts the decisions."""
        step, memory = (0, None) if state is None else state
        together = self._decision > step
        actions = np.empty((len(observation), 2))
        after: list[Floats] = [np.empty(0)] * len(observation)
        if together.any():
            first = int(together.argmax())  # egos before their forks have the same position and the same memory
            _, common = self._planner.predict(observation[[first]], None if memory is None else memory[[first]])
            actions[together] = self._actions[step]
        for row, other in enumerate(self._others):
            if together[row]:
                after[row] = common[0]
                continue
            own, memories = other.predict(observation[[row]], None if memory is None else memory[[row]])
            actions[row], after[row] = own[0], memories[0]
        return actions, (step + 1, np.stack(after))


@lru_cache(maxsize=128)  # the same few planners continue all failures of a run; their memory is an argument
def _rule_planner(roadmap: RoadMap, parameters: Parameters) -> RulePlanner:
    return RulePlanner(roadmap, parameters)


def run_forks(
    simulation: Simulation, scenario: Scenario, trace: Trace, forks: Sequence[Fork], seconds: float | None = None
) -> list[Trace]:
    """Continue a recorded execution along one or more forks, and return the trace of each.

    The ADS of the simulation must be the rule planner of the recorded execution. `seconds` limits the duration of the
    replays [s]; None for whole executions. A replay may be longer.
    """
    planner = simulation.ads
    limits = {} if seconds is None else {"duration": seconds}
    envs = simulation.vector_env(len(forks), **limits)
    if envs is None:
        return [rollout(simulation.env, ForkedPlanner(planner, trace.actions, [fork]), scenario) for fork in forks]
    ads = ForkedPlanner(planner, trace.actions, forks)
    ended = dict(rollout_all(envs, ads, [scenario] * len(forks)))
    envs.close()
    return [ended[row] for row in range(len(forks))]
