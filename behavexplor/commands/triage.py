"""`behavexplor triage`: classes, fault and causes of the failures of a run."""

import json
import shlex
import sys
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import tyro
from rich.table import Table

from behavexplor.campaign.campaign import ads_failure
from behavexplor.campaign.config import CampaignConfig, stored_config
from behavexplor.campaign.store import Execution, Store, write_durably
from behavexplor.commands import EXECUTION_FAILED, OK, program
from behavexplor.commands.display import class_count
from behavexplor.commands.meter import Meter
from behavexplor.commands.terminal_tables import grid, plain_text
from behavexplor.commands.workers import chosen_workers
from behavexplor.data.decision_log import UNKNOWN
from behavexplor.errors import InputError, sentence
from behavexplor.execution.evaluator import EXECUTE, recipe_for
from behavexplor.execution.lookahead import AHEAD, in_order
from behavexplor.execution.rollout import ADSError
from behavexplor.execution.start import start_executor
from behavexplor.triage.agreement import agreement
from behavexplor.triage.coverage import weakness_records
from behavexplor.triage.examination import EXAMINE, Examiner, examination
from behavexplor.triage.findings import (
    TRIAGE,
    WITNESSES,
    Finding,
    Sighting,
    Triage,
    counted,
    error_finding,
    trace_finding,
    witness_path,
)

WRITTEN_AFTER = 10  # findings after which the file is written, the most that an interruption can lose
_NUMBERS = ("count", "first", "look at")  # columns of numbers
TIME_LIMIT = 10.0  # time limit of one failure, in units of the time limit of an execution


def triage(
    run: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")],
    *,
    workers: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: the cores)")] = None,
    afresh: bool = False,
    quiet: bool = False,
) -> int:
    """Classify the failures of a run, and find out whose fault they were and how they could have been avoided.

    Each failure is executed again first. For the rule planner, replays find the weakness that caused the failure. The
    findings are kept in the run folder, in triage.json and witnesses/, and only new failures are examined.

    Args:
        run: The run folder.
        workers: Number of worker processes; 0 uses this process. The findings do not depend on it.
        afresh: Examine all failures again.
        quiet: Print only the tables.
    """
    count = chosen_workers(workers)
    config = stored_config(run)
    store = Store.read(run)
    known = {} if afresh else _known(run)
    failures = [record.id for record in store.records() if record.failed]
    waiting = [number for number in failures if number not in known]
    total = len(store)
    try:
        (run / WITNESSES).mkdir(exist_ok=True)
        with Meter(sys.stderr, len(waiting), "failures", quiet=quiet) as meter:
            for done, finding in enumerate(_examined(store, config, waiting, count), 1):
                known[finding.id] = finding
                if done % WRITTEN_AFTER == 0:
                    _triage(config, total, known.values()).write(run)
                meter.show(done)
        found = _triage(config, total, (known[number] for number in failures))
        if config.ads.partition(":")[0] == "rule":
            traces = ((execution.id, execution.load_trace()) for execution in store.executions())
            found = replace(found, weaknesses=weakness_records(traces, found.findings))
        found.write(run)
    except OSError as error:
        raise InputError(f"The run folder {run} cannot be written: {error.strerror}") from None
    except RuntimeError as error:
        print(f"{program()}: {sentence(f'A failure could not be examined: {error}')}", file=sys.stderr)
        return EXECUTION_FAILED
    finally:
        store.close()
    print(report(found))
    preventable = next((finding for finding in found.findings if finding.avoidance), None)
    if preventable is not None:
        command = f"{program()} replay {shlex.quote(str(run))} {preventable.id}"
        print(f"\nTo see how the first preventable collision could have been avoided: {command} --avoided")
    return OK


def _known(run: Path) -> dict[int, Finding]:
    """Return the findings of an earlier call."""
    if not (run / TRIAGE).is_file():
        return {}
    return {finding.id: finding for finding in Triage.read(run).findings}


def _triage(config: CampaignConfig, total: int, findings: Iterable[Finding]) -> Triage:
    return Triage(config.env, config.ads, total, tuple(sorted(findings, key=lambda finding: finding.id)))


def _examined(store: Store, config: CampaignConfig, waiting: Sequence[int], workers: int) -> Iterator[Finding]:
    """Examine failures in order, write their witnesses, and yield the findings."""
    if not waiting:
        return
    target = replace(config.target, time_limit=TIME_LIMIT * config.time_limit)
    executor = start_executor(
        target, min(workers, len(waiting)), recipe=recipe_for(Examiner, target, specs=config.specs)
    )
    try:
        calls = (_call(store.execution(number), config.seed) for number in waiting)
        for number, future in zip(waiting, in_order(executor, calls, AHEAD * workers), strict=True):
            yield _finding(store.folder, store.execution(number), future)
    finally:
        executor.shutdown(wait=False)


def _call(execution: Execution, seed: int) -> tuple[str, bytes]:
    if execution.record.error is not None:
        return EXECUTE, execution.scenario.to_json().encode()
    return EXAMINE, examination(execution.record, execution.trace, seed)


def _finding(run: Path, execution: Execution, future: Future[bytes]) -> Finding:
    record = execution.record
    try:
        answer = future.result()
    except ADSError as error:
        if record.error is not None:
            return error_finding(record, happened_again=record.error == ads_failure(error))
        return trace_finding(record, execution.load_trace())
    if record.error is not None:
        return error_finding(record, happened_again=False)
    values = json.loads(answer)
    if values["witness"] is not None:
        write_durably(witness_path(run, execution.id), json.dumps(values["witness"]) + "\n")
    return Finding(**values["finding"])


def report(found: Triage) -> str:
    """Return the tables for the terminal."""
    flaky = sum(not finding.same_verdict for finding in found.findings)
    lines = [
        f"{len(found.findings)} failures in {found.executions} executions, in {class_count(len(found.classes))}; "
        + (f"{flaky} did not reproduce" if flaky else "all replayed failures reproduced"),
        "",
        plain_text(_class_table(found)),
        "",
        "A class groups failures that look alike. It begins with the violated requirement:",
        "R1 collision, R2 illegal line touched, R3 destination missed.",
    ]
    if found.weaknesses:
        lines += [
            "Causes such as R2-2 are weaknesses of the rule planner, not requirements:",
            "R2-2 is the second weakness that leads to violations of R2.",
            "",
            plain_text(_weakness_table(found)),
            "",
            "reached: executions in which the weakness could matter",
            "triggered: executions in which it changed the planner's output",
            "detected: failures that it caused; first: number of the first such execution",
            *_agreements(found.findings),
        ]
    return "\n".join(lines)


def _class_table(found: Triage) -> Table:
    columns = ("class", "count", "first", "look at", "fault", *(["cause"] if found.weaknesses else []))
    table = grid(*columns, numbers=_NUMBERS)
    for class_id, findings in found.classes.items():
        shown = next((finding.id for finding in findings if finding.same_trace), findings[0].id)
        cells = [class_id, str(len(findings)), str(findings[0].id), str(shown), counted(f.fault for f in findings)]
        table.add_row(*cells, *([counted(f.cause for f in findings)] if found.weaknesses else []))
    return table


def _weakness_table(found: Triage) -> Table:
    columns = ("weakness", "reached", "first", "triggered", "first", "detected", "first")
    table = grid(*columns, numbers=_NUMBERS)
    for name, record in found.weaknesses.items():
        sightings = (record.reached, record.triggered, record.detected)
        table.add_row(name, *(cell for sighting in sightings for cell in _cells(sighting)))
    return table


def _cells(sighting: Sighting) -> tuple[str, str]:
    return str(sighting.count), "" if sighting.first is None else str(sighting.first)


def _agreements(findings: Sequence[Finding]) -> list[str]:
    """Return how well signatures and classes, which need no replays, agree with the causes."""
    caused = [finding for finding in findings if finding.cause not in (None, UNKNOWN)]
    if not caused:
        return []
    causes = [str(finding.cause) for finding in caused]
    signatures = agreement(causes, [finding.signature or "none" for finding in caused])
    classes = agreement(causes, [finding.class_id for finding in caused])
    return [
        "",
        "The signature, a guess of the cause without replays,",
        f"is right for {signatures.equal:.0%} of {signatures.n} failures with a known cause "
        f"(precision {signatures.precision:.2f}, recall {signatures.recall:.2f}).",
        "The adjusted Rand index says how well a grouping matches the grouping by cause",
        f"(1: equal, 0: chance): {signatures.adjusted_rand:.2f} for signatures "
        f"and {classes.adjusted_rand:.2f} for classes.",
    ]
