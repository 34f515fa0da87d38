"""Triage of a whole run: every failure is examined once, and the findings are kept in the run folder.

Also which weaknesses of the rule planner a run has reached.
"""

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from behavexplor.ads.interface import ADS
from behavexplor.campaign.config import CampaignConfig
from behavexplor.campaign.confirmation import unconfirmed
from behavexplor.campaign.judgment import ads_failure, confirmed
from behavexplor.campaign.store import Execution, Store
from behavexplor.data.durable import make_folder, write_durably, writing
from behavexplor.data.trace import WEAKNESS_NAMES, Trace, weakness_names
from behavexplor.data.validation import checked
from behavexplor.execution.evaluator import EXECUTE
from behavexplor.execution.executor import AHEAD, ADSError, Executor, in_order
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
    """Triage of one run. With 0 `workers`, this process examines; `driver`, if any, drives in place of the run's ADS.

    `waiting` has the numbers of the failures to examine: those without a finding, or all of them if `afresh`.

    Raises:
        InputError: if the folder is not a run folder, or is damaged.
    """

    def __init__(
        self, run: Path, config: CampaignConfig, workers: int, *, afresh: bool = False, driver: ADS | None = None
    ) -> None:
        self._run, self._config = run, config
        self._workers, self._driver = workers, driver
        self._known = {} if afresh else known_findings(run)
        with closing(Store.read(run)) as store:
            self._total = len(store)
            self._failures = [record.id for record in store.records() if record.failed]
        self.waiting = [number for number in self._failures if number not in self._known]

    def examine(self, observe: Callable[[int], None]) -> Triage:
        """Examine the waiting failures, and write the findings into the run folder. `observe` gets how many are done.

        Then highway-env confirms the first failures of each class, unless that has been tried or the run is without it.

        Raises:
            InputError: if the run folder cannot be written, or is damaged.
            RuntimeError: if a failure could not be examined or confirmed.
        """
        with closing(Store.read(self._run)) as store, writing(f"The run folder {self._run}"):
            return self._examine(store, observe)

    def _examine(self, store: Store, observe: Callable[[int], None]) -> Triage:
        make_folder(self._run, WITNESSES)
        missing = unconfirmed(self._config, self._run, store.records())
        tasks = max(len(self.waiting), len(missing))
        if not tasks:
            return self._write_all(store)
        workers = min(self._workers, tasks)
        with start_evaluator(Examiner, self._config, TIME_LIMIT, workers, self._driver) as executor:
            for done, finding in enumerate(self._findings(store, executor, AHEAD * workers), 1):
                self._known[finding.id] = finding
                if done % WRITTEN_AFTER == 0:
                    self._triage(self._known.values()).write(self._run)
                observe(done)
            found = self._write_all(store)
            for _ in confirmed(executor, store, missing):  # writes what highway-env says of each
                pass
        return found

    def _findings(self, store: Store, executor: Executor, ahead: int) -> Iterator[Finding]:
        """Examine the waiting failures in order, write their witnesses, and yield the findings."""
        calls = (_call(store.execution(number), self._config.seed) for number in self.waiting)
        for number, future in zip(self.waiting, in_order(executor, calls, ahead), strict=True):
            yield _finding(self._run, store.execution(number), future)

    def _write_all(self, store: Store) -> Triage:
        """Write all findings, with the weaknesses that the rule planner has reached, and return them."""
        found = self._triage(self._known[number] for number in self._failures)
        if self._is_rule_planner:
            traces = ((execution.id, execution.load_trace()) for execution in store.executions())
            found = replace(found, weaknesses=weakness_records(traces, found.findings))
        found.write(self._run)
        return found

    @property
    def _is_rule_planner(self) -> bool:
        """True if the run's ADS is the rule planner, in any variant."""
        return self._config.ads.partition(":")[0] == "rule"

    def _triage(self, findings: Iterable[Finding]) -> Triage:
        ordered = tuple(sorted(findings, key=lambda finding: finding.id))
        return Triage(self._config.env, self._config.ads, self._total, ordered)


def _call(execution: Execution, seed: int) -> tuple[str, bytes]:
    """Return the function that examines a failure, and its argument. If the ADS itself failed, it is only run again."""
    if execution.record.error is not None:
        return EXECUTE, execution.scenario.to_json().encode()
    return EXAMINE, examination(execution.record, execution.trace, seed)


def _finding(run: Path, execution: Execution, future: Future[bytes]) -> Finding:
    """Return the finding that a `_call` has brought, and write its witness, if any, into the run folder.

    If the ADS fails now, but did not in the campaign, only what the trace shows is known.
    """
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


def weakness_records(traces: Iterable[tuple[int, Trace]], findings: Sequence[Finding]) -> dict[str, WeaknessRecord]:
    """Count, for each weakness by name, the executions that reached or triggered it and the failures that it caused.

    `traces` has those of all executions with their numbers, `findings` those of the failures; both are in order.
    """
    bits = ("reached", "triggered")
    seen: dict[str, dict[str, list[int]]] = {name: {bit: [] for bit in bits} for name in WEAKNESS_NAMES}
    for number, trace in traces:
        if not len(trace.actions):
            continue
        for bit in bits:
            in_any_decision = np.bitwise_or.reduce(trace.decisions[bit].astype(np.int64))
            for name in weakness_names(int(in_any_decision)):
                seen[name][bit].append(number)
    detected = {name: [finding.id for finding in findings if finding.cause == name] for name in WEAKNESS_NAMES}
    return {
        name: WeaknessRecord(
            Sighting.of(found["reached"]), Sighting.of(found["triggered"]), Sighting.of(detected[name])
        )
        for name, found in seen.items()
    }
