"""Examination of a failure: whether it is reproducible, whose fault it was, and what caused it."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Final

import numpy as np

from behavexplor.ads.interface import ADS
from behavexplor.campaign.config import CampaignConfig
from behavexplor.campaign.record import Record
from behavexplor.data.scenario import Scenario
from behavexplor.data.trace import Trace
from behavexplor.execution.evaluator import Evaluator, recipe_for
from behavexplor.execution.executor import ADSError, Executor
from behavexplor.execution.simulation import Simulation
from behavexplor.execution.start import start_executor
from behavexplor.judge.robustness import load_specs
from behavexplor.judge.specs import SPECS, Spec, judge
from behavexplor.triage.blame import Blame, blame
from behavexplor.triage.closed_loop import last_chance
from behavexplor.triage.counterfactual import find_cause
from behavexplor.triage.findings import Finding, OtherDriver, Witness, trace_finding, witness_values
from behavexplor.triage.signatures import signature

STREAM: Final = 0x7472_6961  # separates the random numbers of triage from those of campaigns
EXAMINE: Final = "examine"  # function of the service


@dataclass(frozen=True)
class Rerun:
    """Comparison of a second execution of a scenario with the first."""

    same_verdict: bool  # whether both violated the same specs
    same_trace: bool  # whether both have the same trace, to the resolution of traces


def repeat(simulation: Simulation, scenario: Scenario, trace: Trace, specs: Sequence[Spec] = SPECS) -> Rerun:
    """Execute a scenario again, with the same ADS in the same environment, and compare the traces."""
    try:
        again = simulation.run_compiled(scenario)
    except ADSError:
        return Rerun(same_verdict=False, same_trace=False)
    return Rerun(
        same_verdict=judge(again, specs).violated == judge(trace, specs).violated,
        same_trace=again.to_bytes() == trace.to_bytes(),
    )


class FailureEvaluator(Evaluator):
    """An evaluator that works on one failure at a time."""

    def __init__(self, specs: Sequence[str] = (), **target: Any) -> None:
        super().__init__(**target)
        self.specs = tuple(specs)  # names of the user's specs, for `load_specs`

    def begin(self) -> None:
        """Load the ADS and make its environment. Calls do not run in batches."""
        super().begin()
        self.batch = None


def start_evaluator(
    kind: type[FailureEvaluator], config: CampaignConfig, patience: float, workers: int, driver: ADS | None
) -> Executor:
    """Start the executor of an evaluator. A failure may take `patience` times the time limit of an execution."""
    target = replace(config.target, time_limit=patience * config.time_limit)
    return start_executor(target, workers, recipe=recipe_for(kind, target, specs=config.specs), driver=driver)


class Examiner(FailureEvaluator):
    """An evaluator that also examines failures; see `FailureEvaluator`."""

    def __init__(self, specs: Sequence[str] = (), **target: Any) -> None:
        super().__init__(specs, **target)
        self.functions = {**self.functions, EXAMINE: self.examine}

    def examine(self, request: bytes) -> bytes:
        """Examine a failure, encoded by `examination`; return the finding, and the witness if there is one, as JSON."""
        head, record, trace = request.split(b"\n", 2)
        found = Record.from_json(record), Trace.from_bytes(trace)
        finding, witness = examined(self.simulation, *found, seed=int(head), specs=load_specs(self.specs))
        shown = None if witness is None else witness_values(witness)
        return json.dumps({"finding": asdict(finding), "witness": shown}).encode()


def examination(record: Record, trace: bytes, seed: int) -> bytes:
    """Return the request for `Examiner.examine` about a stored execution in a campaign of this seed."""
    return b"%d\n%b\n%b" % (seed, record.to_json().encode(), trace)


def examined(
    simulation: Simulation, record: Record, trace: Trace, *, seed: int, specs: Sequence[Spec] = SPECS
) -> tuple[Finding, Witness | OtherDriver | None]:
    """Examine a failure: execute its scenario again, and find out whose fault it was and what caused it.

    The simulation must have the ADS and the environment of the recorded execution; seed and specs are the campaign's.

    Returns:
        The finding, and a witness if the failure is a collision that the ego could have avoided.
    """
    scenario = record.load_scenario()
    again = repeat(simulation, scenario, trace, specs)
    rng = np.random.default_rng([STREAM, seed, record.id])
    chance = last_chance(simulation, scenario, trace) if again.same_trace else None
    verdict = blame(simulation, scenario, trace, rng, chance)
    cause = find_cause(simulation, scenario, trace) if again.same_trace else None
    finding = replace(
        trace_finding(record, trace),
        same_verdict=again.same_verdict,
        same_trace=again.same_trace,
        last_chance=chance,
        **_collision(verdict),
    )
    if cause is not None:
        finding = replace(
            finding,
            signature=signature(trace, record.violated),
            cause=cause.primary,
            necessary=cause.necessary,
            sufficient=cause.sufficient,
        )
    return finding, verdict.witness if verdict else None


def _collision(verdict: Blame | None) -> dict[str, Any]:
    """Return the verdict on a collision as fields of a `Finding`."""
    if verdict is None:
        return {}
    return {
        "fault": verdict.kind,
        "in_junction": verdict.in_junction,
        "avoidance": verdict.witness.name if verdict.witness else None,
        "tried": verdict.tried,
    }
