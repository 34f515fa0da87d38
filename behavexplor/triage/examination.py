"""One failure, looked at from all sides; as a function from bytes to bytes, for worker processes."""

import json
from collections.abc import Collection, Mapping
from dataclasses import asdict, replace
from typing import Any, Final

import numpy as np

from behavexplor.data.scenario import Scenario
from behavexplor.data.trace import Trace
from behavexplor.execution import executor
from behavexplor.execution.simulation import Simulation
from behavexplor.judge.classes import violation_class
from behavexplor.judge.events import REQUIREMENTS
from behavexplor.judge.specs import judge
from behavexplor.triage.blame import Blame, blame
from behavexplor.triage.counterfactual import find_cause
from behavexplor.triage.findings import Finding, witness_values
from behavexplor.triage.flakiness import repeat
from behavexplor.triage.signatures import signature
from behavexplor.triage.witness import Witness

STREAM: Final = 0x7472_6961  # sets the draws of triage apart from those of campaigns

_simulation: list[Simulation] = []  # the one of this process, once it has begun


def begin(env: str, ads: str, trust: Collection[str] = ()) -> Simulation:
    """Make this process ready to examine failures; see `behavexplor.execution.executor.begin`."""
    _simulation[:] = [executor.begin(env, ads, trust)]
    return _simulation[0]


def begin_worker(env: str, ads: str, trust: Collection[str], unconfined: bool) -> None:  # noqa: ARG001
    """The same in a worker process, which examines one failure at a time."""
    begin(env, ads, trust)


def examination(record: Mapping[str, Any], trace: bytes, seed: int) -> bytes:
    """What `examine` is asked about a stored execution.

    Args:
        record: of the execution.
        trace: of it.
        seed: of the campaign.
    """
    return json.dumps({"record": dict(record), "seed": seed}).encode() + b"\n" + trace


def examine(request: bytes) -> bytes:
    """Look at a failure from all sides.

    Args:
        request: what `examination` gives.

    Returns:
        The finding, and the witness if there is one, as JSON.
    """
    head, _, data = request.partition(b"\n")
    values = json.loads(head)
    record = values["record"]
    finding, witness = examined(_simulation[0], record, Trace.from_bytes(data), values["seed"])
    shown = None if witness is None else witness_values(witness)
    return json.dumps({"finding": asdict(finding), "witness": shown}).encode()


def examined(
    simulation: Simulation, record: Mapping[str, Any], trace: Trace, seed: int
) -> tuple[Finding, Witness | None]:
    """What is found out about a failure, and a witness against it if there is one.

    Args:
        simulation: with the ADS that drove, in the environment where it did.
        record: of the execution.
        trace: of it.
        seed: of the campaign.
    """
    scenario = Scenario.from_dict(record["scenario"])
    again = repeat(simulation, scenario, trace)
    rng = np.random.default_rng([STREAM, seed, record["id"]])
    verdict = blame(simulation, scenario, trace, rng)
    cause = find_cause(simulation, scenario, trace) if again.same_trace else None
    finding = Finding(
        **seen(record, trace), same_verdict=again.same_verdict, same_trace=again.same_trace, **_collision(verdict)
    )
    if cause is not None:
        named = signature(trace, tuple(record["violated"]))
        finding = replace(
            finding,
            signature=named,
            cause=cause.primary,
            necessary=cause.necessary,
            sufficient=cause.sufficient,
        )
    return finding, verdict.witness if verdict else None


def _collision(verdict: Blame | None) -> dict[str, Any]:
    """What the verdict on a collision says, as fields of a `Finding`."""
    if verdict is None:
        return {}
    avoidance = verdict.witness.name if verdict.witness else None
    return {
        "fault": verdict.kind,
        "in_junction": verdict.in_junction,
        "avoidance": avoidance,
        "tried": verdict.tried,
    }


def seen(record: Mapping[str, Any], trace: Trace) -> dict[str, Any]:
    """What the trace alone tells: the first fields of a `Finding`."""
    kind = violation_class(trace, judge(trace))
    spec = next((short for name, short in REQUIREMENTS.items() if name in record["violated"]), "other")
    class_id, words = (kind.id, kind.words) if kind else (spec, "Violates " + ", ".join(record["violated"]))
    return {"id": record["id"], "spec": spec, "class_id": class_id, "words": words}


def error_finding(record: Mapping[str, Any], *, happened_again: bool) -> Finding:
    """What is known of an execution in which the ADS did something else than driving."""
    failure = record["error"]
    return Finding(
        id=record["id"],
        spec="error",
        class_id=f"error/{failure['kind']}",
        words=f"The ADS failed: {failure['message']}",
        same_verdict=happened_again,
        same_trace=happened_again,
    )
