"""Whether another scenario fails in the same way: the class of the violation, its fault, and its cause if known."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from behavexplor.campaign.record import ERROR, Record
from behavexplor.data.logical import Parts
from behavexplor.data.scenario import Scenario
from behavexplor.data.trace import Trace
from behavexplor.errors import InputError
from behavexplor.execution.executor import ADSError
from behavexplor.execution.rollout import LockStep, run_episodes
from behavexplor.execution.simulation import Simulation
from behavexplor.judge.classes import violation_class
from behavexplor.judge.events import REQUIREMENTS
from behavexplor.judge.fault import contact_fault
from behavexplor.judge.specs import Spec, judge
from behavexplor.triage.blame import blame
from behavexplor.triage.counterfactual import find_cause
from behavexplor.triage.findings import Finding


class Signature(NamedTuple):
    """What an execution tells of its failure without further executions.

    Attributes:
        class_id: class of the violation; "error/" and the kind of the failure if the ADS failed; empty if the execution
            passed.
        fault: verdict on a collision; None for another failure.
    """

    class_id: str
    fault: str | None = None


def signature(outcome: Trace | ADSError, specs: Sequence[Spec]) -> Signature:
    """Return the signature of an execution, which ended with a trace or by a failure of the ADS."""
    if isinstance(outcome, ADSError):
        return Signature(f"{ERROR}/{outcome.kind}")
    violated = judge(outcome, specs).violated
    if not violated:
        return Signature("")
    kind = violation_class(outcome, violated)
    return Signature(kind.id if kind else REQUIREMENTS.get(violated[0], violated[0]), contact_fault(outcome))


def recorded_signature(record: Record, trace: Trace, specs: Sequence[Spec]) -> Signature:
    """Return the signature of a stored execution."""
    if record.error is not None:
        return Signature(f"{ERROR}/{record.error['kind']}")
    return signature(trace, specs)


class ManyScenarios:
    """Executes scenarios of one driver, in lock-step where that is possible.

    Args:
        simulation: simulation with the driver.
        episodes: its episodes in lock-step; None if it has none.
    """

    def __init__(self, simulation: Simulation, episodes: LockStep | None) -> None:
        self.simulation = simulation
        self._episodes = episodes

    def run_all(self, scenarios: Sequence[Scenario]) -> list[Trace | ADSError]:
        """Execute scenarios, and return the trace of each, or how the ADS failed."""
        if self._episodes is None:
            return [self.run(scenario) for scenario in scenarios]
        traces: dict[int, Trace] = {}
        try:
            traces.update(run_episodes(self._episodes, scenarios))
        except ADSError:
            self._episodes.give_up()
        return [traces[i] if i in traces else self.run(scenario) for i, scenario in enumerate(scenarios)]

    def run(self, scenario: Scenario) -> Trace | ADSError:
        """Execute one scenario alone; in a stock environment, in highway-env itself."""
        try:
            return self.simulation.run(scenario)
        except ADSError as error:
            return error


class SameFailure:
    """The property that a failure still happens; see `behavexplor.triage.shrinking.Property`.

    Args:
        driven: the driver of the failed execution.
        specs: the specs of the campaign.
        scenario: the scenario of the failed execution.
        sought: signature of the failure.
        known: the finding of triage about the failure, whose fault and cause are kept; None without triage.
        seed: seed for the random evasions by which fault is determined.
    """

    def __init__(
        self,
        driven: ManyScenarios,
        specs: Sequence[Spec],
        scenario: Scenario,
        sought: Signature,
        known: Finding | None,
        seed: Sequence[int],
    ) -> None:
        self._driven = driven
        self._specs = specs
        self._scenario = scenario
        self._sought = sought
        self._known = known
        self._seed = seed

    def held_by(self, candidates: Sequence[Parts]) -> list[bool]:
        """Return whether each candidate is valid and fails with the same signature."""
        made = [self._made(candidate) for candidate in candidates]
        valid = [i for i, scenario in enumerate(made) if scenario is not None]
        outcomes = self._driven.run_all([scenario for scenario in made if scenario is not None])
        alike = {i: signature(outcome, self._specs) == self._sought for i, outcome in zip(valid, outcomes, strict=True)}
        return [alike.get(i, False) for i in range(len(candidates))]

    def kept_by(self, candidate: Parts) -> bool:
        """Return whether fault and cause are also the same, as far as triage has found them."""
        known, simulation = self._known, self._driven.simulation
        if known is None or known.spec == ERROR:
            return True
        scenario = simulation.logical.with_parts(self._scenario, candidate)
        (trace,) = self._driven.run_all([scenario])
        if isinstance(trace, ADSError):
            return False
        if known.fault is not None:
            verdict = blame(simulation, scenario, trace, np.random.default_rng(self._seed))
            if verdict is None or verdict.kind != known.fault:
                return False
        if known.cause is None:
            return True
        cause = find_cause(simulation, scenario, trace)
        return cause is not None and cause.primary == known.cause

    def _made(self, candidate: Parts) -> Scenario | None:
        try:
            return self._driven.simulation.logical.with_parts(self._scenario, candidate)
        except InputError:
            return None
