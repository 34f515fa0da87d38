"""What a report knows of a run: read from its folder alone, and checked."""

import hashlib
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from behavexplor.campaign.config import CONFIG, CampaignConfig, stored_config
from behavexplor.campaign.store import Execution, Store
from behavexplor.errors import InputError
from behavexplor.judge.fault import AT_FAULT, NOT_AT_FAULT
from behavexplor.judge.specs import SPECS
from behavexplor.triage.findings import (
    TRIAGE,
    Finding,
    Triage,
    WeaknessRecord,
    error_finding,
    trace_finding,
)


@dataclass(frozen=True)
class Entry:
    """One execution, without its scenario and trace.

    Attributes:
        id: its number.
        end: how it ended.
        violated: names of the violated specs.
        degree: sum of the violation degrees [m], NaN where the record has none.
        novelty: in [0, 1], NaN where the record has none.
        novel: whether its behavior was new to the campaign.
        energy: of the testcase that it was made from, NaN where the method has none.
        elapsed: running time of the campaign up to it [s].
    """

    id: int
    end: str
    violated: tuple[str, ...]
    degree: float
    novelty: float
    novel: bool
    energy: float
    elapsed: float

    @classmethod
    def of(cls, execution: Execution) -> Self:
        """What the record says; anything that it lacks is left out."""
        record = execution.record
        return cls(
            id=record.id,
            end=record.end,
            violated=record.violated,
            degree=math.nan if record.degree is None else record.degree,
            novelty=math.nan if record.novelty is None else record.novelty,
            novel=record.novel,
            energy=_number(record.search.get("parent_energy")),
            elapsed=execution.elapsed,
        )


@dataclass(frozen=True)
class Run:
    """A run, as a report shows it.

    Attributes:
        folder: where it lies.
        config: of the campaign.
        entries: all executions in order.
        findings: one for each failure, in order.
        examined: numbers of the failures that triage has looked at; of the others only the class is known.
        weaknesses: see `behavexplor.triage.findings.Triage`.
        digests: SHA-256 of what was read, by name.
    """

    folder: Path
    config: CampaignConfig
    entries: tuple[Entry, ...]
    findings: tuple[Finding, ...]
    examined: frozenset[int]
    weaknesses: Mapping[str, WeaknessRecord]
    digests: Mapping[str, str]

    @property
    def name(self) -> str:
        """The folder's name: where it lies is nobody's business."""
        return self.folder.resolve().name or "run"

    @property
    def classes(self) -> dict[str, list[Finding]]:
        """The findings by class, the largest first."""
        return Triage(self.config.env, self.config.ads, len(self.entries), self.findings).classes

    @property
    def novel(self) -> int:
        """How many executions showed a new behavior."""
        return sum(entry.novel for entry in self.entries)

    @property
    def elapsed(self) -> float:
        """Running time [s]."""
        return max(entry.elapsed for entry in self.entries)

    def specs(self) -> dict[str, int]:
        """Failures by the first spec that they violate."""
        counts = dict.fromkeys((spec.name for spec in SPECS), 0)
        for entry in self.entries:
            for name in entry.violated[:1]:
                counts[name] = counts.get(name, 0) + 1
        return counts

    def faults(self) -> tuple[int, int]:
        """Collisions that were the ego's fault, and those that were not."""
        faults = [finding.fault for finding in self.findings if finding.id in self.examined]
        return sum(fault in AT_FAULT for fault in faults), sum(fault in NOT_AT_FAULT for fault in faults)

    def flaky(self) -> int:
        """Failures that did not happen again."""
        return sum(not finding.same_verdict for finding in self.findings if finding.id in self.examined)


def read_run(folder: Path) -> Run:
    """Read a run; traces are looked at only for failures whose class nobody has found out yet.

    Raises:
        InputError: if it is no run folder, has no executions yet, or is damaged.
    """
    config = stored_config(folder)
    triage = Triage.read(folder) if (folder / TRIAGE).is_file() else None
    known = {finding.id: finding for finding in triage.findings} if triage else {}
    entries, findings, digest = [], [], hashlib.sha256()
    for execution in stored(folder):
        entries.append(Entry.of(execution))
        digest.update(execution.trace)
        digest.update(json.dumps(execution.record.to_dict(), sort_keys=True).encode())
        if entries[-1].violated:
            findings.append(known.get(execution.id) or _finding(execution))
    if not entries:
        raise InputError(f"{folder} has no executions yet: go on with `behavexplor fuzz --resume {folder}`")
    digests = {CONFIG: _digest(folder / CONFIG), "executions": digest.hexdigest()}
    if triage:
        digests[TRIAGE] = _digest(folder / TRIAGE)
    examined = frozenset(known) & {finding.id for finding in findings}
    weaknesses = triage.weaknesses if triage else {}
    return Run(folder, config, tuple(entries), tuple(findings), examined, weaknesses, digests)


def stored(folder: Path) -> Iterator[Execution]:
    """All executions of a run, in order."""
    store = Store.read(folder)
    try:
        yield from store.executions()
    finally:
        store.close()


def _finding(execution: Execution) -> Finding:
    """Return what the record and the trace of a failure tell, before triage."""
    if execution.record.error is not None:
        return error_finding(execution.record, happened_again=False)
    return trace_finding(execution.record, execution.load_trace())


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _number(value: Any) -> float:
    """A finite number, or NaN."""
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return float(value) if is_number and math.isfinite(value) else math.nan
