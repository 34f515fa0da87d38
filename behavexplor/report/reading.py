"""Reading of runs for a report, from their run folders alone."""

import hashlib
import json
import math
import shlex
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

from behavexplor.campaign.config import Budget, CampaignConfig, stored_config
from behavexplor.campaign.confirmation import not_confirmed, read_confirmations
from behavexplor.campaign.folder_format import CONFIG
from behavexplor.campaign.identity import Identity, begun_with
from behavexplor.campaign.store import Execution, Store
from behavexplor.campaign.uniform_rate import UniformRate, explained, own_rate
from behavexplor.data.untrusted import read_file
from behavexplor.errors import InputError
from behavexplor.judge.discovery import Discovery
from behavexplor.judge.fault import AT_FAULT, NOT_AT_FAULT, NPC_CAUSED
from behavexplor.judge.specs import SPECS
from behavexplor.triage.findings import (
    TRIAGE,
    Finding,
    Minimized,
    Triage,
    WeaknessRecord,
    error_finding,
    read_minimized,
    trace_finding,
)


@dataclass(frozen=True)
class Entry:
    """One execution, without its scenario and trace."""

    id: int  # number of the execution
    end: str  # kind of end
    violated: tuple[str, ...]  # names of the violated specs
    degree: float  # sum of the violation degrees [m]; NaN if the record has none
    novelty: float  # distance to the nearest known behavior, in [0, 1]; NaN if the record has none
    novel: bool  # whether the behavior was new to the campaign
    energy: float  # energy of the parent testcase; NaN if the method has none
    elapsed: float  # running time of the campaign up to this execution [s]

    @classmethod
    def of(cls, execution: Execution) -> Self:
        """Return the entry of a stored execution."""
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
class ReportedRun:
    """A run, as a report shows it."""

    folder: Path  # run folder
    config: CampaignConfig  # configuration of the campaign
    entries: tuple[Entry, ...]  # all executions, in order
    findings: tuple[Finding, ...]  # one finding for each failure, in order
    # numbers of the failures that triage has examined; only the classes of other failures are known
    examined: frozenset[int]
    weaknesses: Mapping[str, WeaknessRecord]  # coverage of weaknesses by name, see `behavexplor.triage.findings.Triage`
    minimized: Mapping[int, Minimized]  # minimized failures by the numbers of their executions
    digests: Mapping[str, str]  # SHA-256 of the read data and of the driver's files, by name
    stages: Mapping[str, float]  # time in each stage [s], see `behavexplor.campaign.progress`; empty if it is not known
    own_rate: str = ""  # a sentence that says which number is the driver's own failure rate
    confirmation: str = ""  # what highway-env itself said of failures; empty if it was not asked

    @property
    def name(self) -> str:
        """Name of the run folder, without its path, which is private."""
        return self.folder.resolve().name or "run"

    @property
    def classes(self) -> dict[str, list[Finding]]:
        """Findings by class, the largest class first."""
        return Triage(self.config.env, self.config.ads, len(self.entries), self.findings).classes

    @property
    def novel(self) -> int:
        """Number of executions with a new behavior."""
        return sum(entry.novel for entry in self.entries)

    @property
    def elapsed(self) -> float:
        """Running time [s]."""
        return max(entry.elapsed for entry in self.entries)

    def specs(self) -> dict[str, int]:
        """Return the number of failures by first violated spec."""
        counts = dict.fromkeys((spec.name for spec in SPECS), 0)
        for entry in self.entries:
            for name in entry.violated[:1]:
                counts[name] = counts.get(name, 0) + 1
        return counts

    def faults(self) -> tuple[int, int]:
        """Return the number of examined collisions that were the ego's fault, and of those that were not."""
        faults = [finding.fault for finding in self.findings if finding.id in self.examined]
        return sum(fault in AT_FAULT for fault in faults), sum(fault in NOT_AT_FAULT for fault in faults)

    def by_others(self) -> int:
        """Return the number of failures that another vehicle caused, as the traces tell."""
        return sum(finding.fault in NPC_CAUSED for finding in self.findings)

    @property
    def discovery(self) -> Discovery:
        """What the campaign has not found yet."""
        return Discovery.of((finding.class_id for finding in self.findings), len(self.entries))

    def flaky(self) -> int:
        """Return the number of examined failures that did not reproduce."""
        return sum(not finding.same_verdict for finding in self.findings if finding.id in self.examined)


def read_run(folder: Path) -> ReportedRun:
    """Read a run. Only traces of failures that triage has not examined are loaded.

    Raises:
        InputError: if the folder is not a run folder, has no executions yet, or is damaged.
    """
    config = _without_path(stored_config(folder).unverified)
    triage = Triage.read(folder) if (folder / TRIAGE).is_file() else None
    known = {finding.id: finding for finding in triage.findings} if triage else {}
    entries, findings, digest = [], [], hashlib.sha256()
    with closing(Store.read(folder)) as store:
        stages = store.stages
        identity = begun_with(store) or Identity()
        uniform = UniformRate.stored(store)
        for execution in store.executions():
            entries.append(Entry.of(execution))
            digest.update(execution.trace)
            digest.update(json.dumps(execution.record.to_dict(), sort_keys=True).encode())
            if entries[-1].violated:
                findings.append(known.get(execution.id) or _finding(execution))
    if not entries:
        again = f"`behavexplor fuzz --resume {shlex.quote(str(folder))}`"
        raise InputError(f"{folder} has no executions yet: resume it with {again}")
    digests = {CONFIG: _digest(folder / CONFIG), "executions": digest.hexdigest(), **identity.digests}
    if triage:
        digests[TRIAGE] = _digest(folder / TRIAGE)
    examined = frozenset(known) & {finding.id for finding in findings}
    weaknesses = triage.weaknesses if triage else {}
    budget, elapsed = Budget.parse(config.budget), entries[-1].elapsed
    rate = own_rate(config.method, len(entries), len(findings), budget, elapsed, uniform)
    own = explained(config.method, rate)
    minimized = read_minimized(folder)
    words = _confirmation(folder)
    return ReportedRun(
        folder, config, tuple(entries), tuple(findings), examined, weaknesses, minimized, digests, stages, own, words
    )


def _confirmation(folder: Path) -> str:
    """Return what highway-env itself said of a run's failures, in words; empty if it was not asked."""
    tried = read_confirmations(folder)
    if not tried:
        return ""
    unsure = not_confirmed(tried)
    failures = "1 failure" if len(tried) == 1 else f"{len(tried)} failures"
    head = f"highway-env itself was asked about {failures} and confirms {len(tried) - len(unsure)}."
    return " ".join([head, *unsure])


def _without_path(config: CampaignConfig) -> CampaignConfig:
    """Return a configuration that names a policy's file without its folder, which is private."""
    is_path = "/" in config.ads and ":" not in config.ads
    return replace(config, ads=Path(config.ads).name) if is_path else config


def _finding(execution: Execution) -> Finding:
    """Return the finding about a failure before triage, from its record and trace."""
    if execution.record.error is not None:
        return error_finding(execution.record, happened_again=False)
    return trace_finding(execution.record, execution.load_trace())


def _digest(path: Path) -> str:
    return hashlib.sha256(read_file(path)).hexdigest()


def _number(value: Any) -> float:
    """Return a finite number as it is, and anything else as NaN."""
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return float(value) if is_number and math.isfinite(value) else math.nan
