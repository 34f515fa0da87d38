"""Judgment of executions: verdict, class and fault; whether one is reproducible, and what highway-env says of it."""

import re
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from typing import Any, Final

from behavexplor.campaign.confirmation import Confirmation, difference, keep
from behavexplor.campaign.record import ERROR, Record, Result
from behavexplor.campaign.store import Execution, Store
from behavexplor.data.trace import Trace
from behavexplor.errors import InputError, brief, sentence
from behavexplor.execution.evaluator import EXECUTE, ORIGINAL
from behavexplor.execution.executor import MOST_WORKERS, ADSError, Executor, in_order
from behavexplor.judge.classes import violation_class
from behavexplor.judge.events import REQUIREMENTS
from behavexplor.judge.fault import collision_fault
from behavexplor.judge.specs import SPECS, Spec, Verdict, judge

_REPETITIONS: Final = 4  # of an execution in the engine: a driver that draws at random may do the same twice by chance
_ADDRESS = re.compile(r"0x[0-9a-f]{4,}")  # memory address of an object, which differs from run to run


@dataclass(frozen=True)
class Judgment:
    """An execution with its judgment."""

    data: bytes  # the trace as bytes
    trace: Trace
    result: Result
    members: Sequence[str]  # `result` as members of a record's JSON, for `Record.members_around`
    scenario: str | None = None  # the scenario as JSON, if a judge drew it from its seed and number, as the worker did


def judgment(data: bytes, failure: dict[str, str] | None, specs: Sequence[Spec]) -> Judgment:
    """Judge an execution by its trace as bytes. `failure` is how the ADS failed, see `ads_failure`; None if it did not.

    Raises:
        ADSError: if the data is no trace.
        InputError: if a spec cannot judge the trace.
    """
    try:
        trace = Trace.from_bytes(data)
    except InputError as error:
        raise ADSError("crash", f"its process sent what is no trace: {error}") from error
    verdict = judge(trace, specs)
    if failure is not None:
        verdict = replace(verdict, violated=(ERROR,))
    result = Result(
        end=trace.end,
        error=failure,
        duration=trace.duration,
        violated=verdict.violated,
        violation_class=_class_id(trace, verdict, failure),
        fault=collision_fault(trace, verdict.violated),
        degree=verdict.degree,
        degrees=dict(verdict.degrees),
    )
    return Judgment(data, trace, result, result.result_members)


def ads_failure(error: ADSError) -> dict[str, str]:
    """Return an ADS failure as stored in a record: without memory addresses, so that reproduced failures are equal."""
    return {"kind": error.kind, "message": _ADDRESS.sub("0x...", error.message)}


def _class_id(trace: Trace, verdict: Verdict, failure: dict[str, str] | None) -> str | None:
    if failure is not None:
        return f"{ERROR}/{failure['kind']}"
    if not verdict.violated:
        return None
    first, kind = verdict.violated[0], violation_class(trace, verdict.violated)
    return kind.id if kind else REQUIREMENTS.get(first, first)


@dataclass(frozen=True)
class Repetition:
    """The outcome of running an execution again.

    Attributes:
        reproduced: whether trace or failure was the same again, and the record says of the trace what judging it gives.
        words: the outcome as a sentence.
    """

    reproduced: bool
    words: str


def repeat_execution(executor: Executor, execution: Execution) -> Repetition:
    """Run a stored execution again, with an executor of the same target."""
    try:
        data = executor.submit(EXECUTE, execution.scenario.to_json().encode()).result()
        again = judgment(data, None, SPECS)
    except ADSError as error:
        if execution.record.error == ads_failure(error):
            return Repetition(True, f"The failure was reproduced: again, the ADS failed in the same way{error.place}.")
        return Repetition(False, sentence(f"The execution was NOT reproduced: running it again, {error}"))
    if again.trace.to_bytes() != execution.load_trace().to_bytes():
        return Repetition(False, "The execution was NOT reproduced: running it again gave a different trace.")
    if apart := _misjudged(execution.record, again.result):
        words = f"running it again gave the same trace, but its record says {apart}, as this version judges the trace"
        return Repetition(False, sentence(f"The record is NOT that of the execution: {words}."))
    return Repetition(True, "The execution was reproduced: running it again gave the same trace.")


def _misjudged(record: Record, found: Result) -> str:
    """Return in words how a record contradicts the judgment of its trace; empty if it does not.

    Specs of users are left out, because their code is not run for this.
    """
    ours = {ERROR, *(spec.name for spec in SPECS)}
    said: dict[str, Any] = {"end": record.end, "violated": [name for name in record.violated if name in ours]}
    true: dict[str, Any] = {"end": found.end, "duration": found.duration, "violated": [*found.violated]}
    if record.duration is not None:
        said["duration"] = record.duration
    if ours.issuperset(record.violated):  # else, class and fault may come from a user's spec
        said |= {"class": record.violation_class, "fault": record.fault}
        true |= {"class": found.violation_class, "fault": found.fault}
    differing = [name for name, value in said.items() if value != true[name]]
    return ", ".join(f"{name} {brief(said[name])} instead of {true[name]!r}" for name in differing)


def confirmed(executor: Executor, store: Store, numbers: Sequence[int]) -> Iterator[Confirmation]:
    """Let highway-env itself execute the scenarios of failures, several at a time; write and yield what comes out.

    Not all can be executed there, see `behavexplor.campaign.confirmation.can_be_confirmed`.

    Raises:
        RuntimeError: if a scenario could not be executed.
        OSError: if the run folder cannot be written.
    """
    calls = ((ORIGINAL, store.execution(number).scenario.to_json().encode()) for number in numbers)
    futures = in_order(executor, calls, 0 if executor.runs_here else MOST_WORKERS)
    for number, future in zip(numbers, futures, strict=True):
        found = confirmation(executor, store.execution(number), future)
        keep(store.folder, number, found)
        yield found


def confirmation(executor: Executor, execution: Execution, original: "Future[bytes] | None" = None) -> Confirmation:
    """Compare a recorded execution with one in highway-env; if they differ, both execute the scenario again.

    If each always does the same, they disagree, an error of this package; else the driver or the environment does not
    do the same twice. `original` is the execution in highway-env, if that has begun.
    """
    scenario = execution.scenario.to_json().encode()
    recorded = execution.record.error or execution.load_trace()
    theirs = _outcome(original or executor.submit(ORIGINAL, scenario))
    apart = difference(recorded, theirs)
    if apart is None:
        return Confirmation("confirmed")
    again = [(recorded, executor.submit(EXECUTE, scenario)) for _ in range(_REPETITIONS)]
    again.append((theirs, executor.submit(ORIGINAL, scenario)))
    if all(difference(first, _outcome(one)) is None for first, one in again):
        return Confirmation("disagrees", f"the compiled engine and highway-env disagree: {apart}")
    words = "the driver or the environment does not do the same twice, as if it drew at random, remembered earlier "
    words += "episodes or looked at the other rows of a batch"
    return Confirmation("changes", words)


def _outcome(future: "Future[bytes]") -> Trace | dict[str, str]:
    try:
        return judgment(future.result(), None, SPECS).trace
    except ADSError as error:
        return ads_failure(error)
