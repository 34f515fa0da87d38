"""Triage of a whole run: every failure is examined once, and the findings are kept in the run folder.

Also how well given labels agree with true ones, and which weaknesses of the rule planner a run has reached.
"""

import json
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from behavexplor.ads.interface import ADS
from behavexplor.campaign.config import CampaignConfig
from behavexplor.campaign.confirmation import unconfirmed
from behavexplor.campaign.judgment import ads_failure, confirmed
from behavexplor.campaign.store import Execution, Store
from behavexplor.data.durable import folder_in, write_durably
from behavexplor.data.trace import WEAKNESS_NAMES, Trace, weakness_names
from behavexplor.data.validation import checked
from behavexplor.errors import InputError
from behavexplor.execution.evaluator import EXECUTE
from behavexplor.execution.executor import AHEAD, ADSError, in_order
from behavexplor.triage.examination import EXAMINE, Examiner, examination, start_evaluator
from behavexplor.triage.findings import (
    WITNESSES,
    Finding,
    Sighting,
    Triage,
    WeaknessRecord,
    error_finding,
    known_findings,
    trace_finding,
    witness_path,
)

WRITTEN_AFTER: Final = 10  # findings after which the file is written, the most that an interruption can lose
TIME_LIMIT: Final = 10.0  # time limit of one failure, in units of the time limit of an execution


class RunTriage:
    """Triage of one run.

    Known failures are examined again only `afresh`. A `driver` of this process drives in place of the one that the
    configuration names. The numbers of the failures that have to be examined are `waiting`.

    Raises:
        InputError: if the folder is not a run folder, or is damaged.
    """

    def __init__(
        self, run: Path, config: CampaignConfig, workers: int, *, afresh: bool = False, driver: ADS | None = None
    ) -> None:
        self._run, self._config, self._workers, self._driver = run, config, workers, driver
        self._store = Store.read(run)
        self._total = len(self._store)
        self._known = {} if afresh else known_findings(run)
        self._failures = [record.id for record in self._store.records() if record.failed]
        self.waiting = [number for number in self._failures if number not in self._known]

    def examine(self, observe: Callable[[int], None]) -> Triage:
        """Examine the waiting failures, and write the findings into the run folder.

        Raises:
            InputError: if the run folder cannot be written, or is damaged.
            RuntimeError: if a failure could not be examined.
        """
        try:
            return self._examine(observe)
        except OSError as error:
            raise InputError(f"The run folder {self._run} cannot be written: {error.strerror}") from None
        finally:
            self._store.close()

    def _examine(self, observe: Callable[[int], None]) -> Triage:
        folder_in(self._run, WITNESSES)
        for done, finding in enumerate(self._findings(), 1):
            self._known[finding.id] = finding
            if done % WRITTEN_AFTER == 0:
                self._triage(self._known.values()).write(self._run)
            observe(done)
        found = self._triage(self._known[number] for number in self._failures)
        if self._config.ads.partition(":")[0] == "rule":
            traces = ((execution.id, execution.load_trace()) for execution in self._store.executions())
            found = replace(found, weaknesses=weakness_records(traces, found.findings))
        found.write(self._run)
        return found

    def _triage(self, findings: Iterable[Finding]) -> Triage:
        ordered = tuple(sorted(findings, key=lambda finding: finding.id))
        return Triage(self._config.env, self._config.ads, self._total, ordered)

    def _findings(self) -> Iterator[Finding]:
        """Examine the waiting failures in order, write their witnesses, and yield the findings."""
        if not self.waiting:
            return
        workers = min(self._workers, len(self.waiting))
        executor = start_evaluator(Examiner, self._config, TIME_LIMIT, workers, self._driver)
        calls = (_call(self._store.execution(number), self._config.seed) for number in self.waiting)
        try:
            for number, future in zip(self.waiting, in_order(executor, calls, AHEAD * self._workers), strict=True):
                yield _finding(self._run, self._store.execution(number), future)
            missing = unconfirmed(self._config, self._run, self._store.records())
            deque(confirmed(executor, self._store, missing), maxlen=0)
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
    return checked(Finding, values["finding"], "the finding")


@dataclass(frozen=True)
class Agreement:
    """Agreement of given labels with true labels."""

    n: int  # number of compared labels
    equal: float  # share of equal labels; meaningful only if both sequences use the same names
    precision: float  # mean over the given names of the share of items with that label for which it is true
    recall: float  # mean over the true names of the share of items with that true label that were given it
    # adjusted Rand index, which compares the groups and ignores their names: 1 for equal groups, about 0 for groups
    # made by chance
    adjusted_rand: float


def agreement(true: Sequence[str], given: Sequence[str]) -> Agreement:
    """Compare given labels with true labels.

    Raises:
        InputError: if there are no labels, or the sequences differ in length.
    """
    from sklearn.metrics import adjusted_rand_score, precision_recall_fscore_support  # noqa: PLC0415 - slow to import

    if not true or len(true) != len(given):
        raise InputError(f"Labels are compared one by one, so {len(true)} and {len(given)} labels do not match")
    equal = sum(a == b for a, b in zip(true, given, strict=True)) / len(true)
    precision, recall = (
        precision_recall_fscore_support(true, given, labels=sorted(set(names)), average="macro", zero_division=0.0)[i]
        for i, names in enumerate((given, true))
    )
    return Agreement(len(true), equal, float(precision), float(recall), float(adjusted_rand_score(true, given)))


def weakness_records(traces: Iterable[tuple[int, Trace]], findings: Sequence[Finding]) -> dict[str, WeaknessRecord]:
    """Count, by weakness, the executions that reached or triggered it, and the failures that it caused.

    Traces and findings are in order.
    """
    bits = ("reached", "triggered")
    seen: dict[str, dict[str, list[int]]] = {name: {bit: [] for bit in bits} for name in WEAKNESS_NAMES}
    for number, trace in traces:
        for bit in bits if len(trace.actions) else ():
            for name in weakness_names(int(np.bitwise_or.reduce(trace.decisions[bit].astype(np.int64)))):
                seen[name][bit].append(number)
    detected = {name: [finding.id for finding in findings if finding.cause == name] for name in WEAKNESS_NAMES}
    return {
        name: WeaknessRecord(
            Sighting.of(found["reached"]), Sighting.of(found["triggered"]), Sighting.of(detected[name])
        )
        for name, found in seen.items()
    }
