"""What one campaign found, in figures: made from its run folder alone, and again at any time."""

import csv
import io
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from scipy.stats import pearsonr

from behavexplor.bench.experiment import PlannedRun
from behavexplor.bench.timing import read_timing
from behavexplor.campaign.record import ERROR, Record
from behavexplor.campaign.store import Store
from behavexplor.data.decision_log import ENVIRONMENT
from behavexplor.judge.events import REQUIREMENTS
from behavexplor.judge.fault import NPC_CAUSED
from behavexplor.triage.signatures import signature

LABELS: Final = {**REQUIREMENTS, ERROR: "error"}  # what tables call the specs; a user's spec goes by its name
UNEXPLAINED: Final = "unexplained"
_LEAST_PAIRS: Final = 3  # of a correlation


@dataclass(frozen=True)
class Failure:
    """A failed execution.

    Attributes:
        number: of the execution, counted from 0.
        label: "R1", "R2", "R3" or the name of a user's spec, the first spec that it violates; or "error".
        npc_caused: whether it is a collision that an NPC caused, as far as its trace alone tells.
        kind: its class of violations, if it has been classified.
        signature: the weakness of the rule planner that its decision log hints at, or "environment" or "unexplained";
            None for a driver without that log.
    """

    number: int
    label: str
    npc_caused: bool
    kind: str | None
    signature: str | None = None


@dataclass(frozen=True)
class Summary:
    """What one campaign found.

    Attributes:
        env: environment.
        ads: system under test.
        method: its name in the experiment.
        seed: of the campaign.
        executions: how many there were.
        failures: all that failed, in order.
        novelty_rate: share of executions that showed a behavior that was new to the campaign.
        executing: time spent on executions [s].
        analysing: time spent on all else [s].
        r: Pearson's correlation of violation degree and behavior distance (the paper's r_BF), where the method
            measures that distance.
        r_p: its p.
        labels: what tables call the specs, in their order: "R1", "R2", "R3", specs of the user, and "error".
    """

    env: str
    ads: str
    method: str
    seed: int
    executions: int
    failures: tuple[Failure, ...]
    novelty_rate: float
    executing: float
    analysing: float
    r: float | None = None
    r_p: float | None = None
    labels: tuple[str, ...] = tuple(LABELS.values())

    def total(self, label: str | None = None) -> int:
        """How many failed, of one label or of all."""
        return sum(label in (None, failure.label) for failure in self.failures)

    def kinds(self, label: str | None = None, before: int | None = None) -> frozenset[str]:
        """The classes of the failures of one label, or of all, up to an execution: the unique violations."""
        return frozenset(failure.kind for failure in self._failed(label, before) if failure.kind is not None)

    def weaknesses(self, label: str | None = None, before: int | None = None) -> frozenset[str]:
        """The weaknesses of the rule planner that the signatures of these failures name."""
        signatures = {failure.signature for failure in self._failed(label, before)} - {ENVIRONMENT, UNEXPLAINED}
        return frozenset(name for name in signatures if name is not None)

    def _failed(self, label: str | None, before: int | None) -> Iterator[Failure]:
        for failure in self.failures:
            if label in (None, failure.label) and (before is None or failure.number < before):
                yield failure

    @property
    def classified(self) -> bool:
        """Whether every failure has a class."""
        return all(failure.kind is not None for failure in self.failures)

    @property
    def signed(self) -> bool:
        """Whether every failure has a signature."""
        return all(failure.signature is not None for failure in self.failures)

    @property
    def npc_caused(self) -> int:
        """How many collisions NPCs caused."""
        return sum(failure.npc_caused for failure in self.failures)


def summarize(run: PlannedRun, root: Path) -> Summary:
    """What the campaign of a run found.

    Args:
        run: whose run folder is read.
        root: the experiment's folder.

    Raises:
        InputError: if the run folder is damaged.
    """
    folder = root / run.folder
    store = Store.read(folder)
    novel, pairs, failures = 0, [], []
    count, specs = 0, dict.fromkeys(REQUIREMENTS)
    for record in store.records():
        count += 1
        novel += record.novel
        specs |= dict.fromkeys(record.degrees)
        if "novelty" in record.search and record.error is None and record.degree is not None:
            pairs.append((record.degree, float(record.search["novelty"])))
        if record.failed:
            failures.append(_failure(record))
    failures = _with_signatures(failures, store)
    store.close()
    timing = read_timing(folder)
    share = count / timing.executions if timing.executions else math.nan
    r, p = correlation(pairs)
    return Summary(
        run.env,
        run.ads,
        run.method,
        run.seed,
        count,
        tuple(failures),
        novel / count,
        timing.executing * share,
        timing.analysing * share,
        r,
        p,
        tuple(LABELS.get(name, name) for name in (*specs, ERROR)),
    )


def _failure(record: Record) -> Failure:
    label = LABELS.get(record.violated[0], record.violated[0])
    return Failure(record.id, label, record.fault in NPC_CAUSED, record.violation_class)


def _with_signatures(failures: Sequence[Failure], store: Store) -> list[Failure]:
    """The failures with their signatures, as they are if the driver keeps no log of its weaknesses."""
    signed = []
    for failure in failures:
        execution = store.execution(failure.number)
        trace = execution.load_trace()
        if failure.label != LABELS[ERROR] and "triggered" not in trace.decisions:
            return list(failures)
        found = signature(trace, execution.record.violated)
        signed.append(replace(failure, signature=found or UNEXPLAINED))
    return signed


def correlation(pairs: Sequence[tuple[float, float]]) -> tuple[float | None, float | None]:
    """Pearson's r of pairs and its p; None where one side does not vary, or there are hardly any."""
    values = np.asarray(pairs, dtype=float).reshape(-1, 2)
    if len(values) < _LEAST_PAIRS or not np.ptp(values, axis=0).all():
        return None, None
    found = pearsonr(values[:, 0], values[:, 1])
    return float(found.statistic), float(found.pvalue)


def all_classified(summaries: Sequence[Summary]) -> bool:
    """Whether every failure of an experiment has a class, so that unique violations can be counted."""
    return bool(summaries) and all(summary.classified for summary in summaries)


def all_signed(summaries: Sequence[Summary]) -> bool:
    """Whether every failure of an experiment has a signature, and some of them a weakness."""
    return all(summary.signed for summary in summaries) and any(summary.weaknesses() for summary in summaries)


def all_labels(summaries: Sequence[Summary]) -> tuple[str, ...]:
    """Return the labels of all specs of an experiment, in their order, "error" last."""
    named = dict.fromkeys(label for summary in summaries for label in summary.labels)
    return (*(label for label in named if label != LABELS[ERROR]), LABELS[ERROR])


def summary_rows(summaries: Sequence[Summary]) -> list[dict[str, object]]:
    """The columns of each campaign by name; what not all failures of the experiment have is left out."""
    unique, signed, labels = all_classified(summaries), all_signed(summaries), all_labels(summaries)
    return [_row(summary, labels, unique=unique, signed=signed) for summary in summaries]


def summaries_csv(summaries: Sequence[Summary]) -> str:
    """A row for each campaign, as CSV."""
    rows = summary_rows(summaries)
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]) if rows else ["env"], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def _row(summary: Summary, labels: Sequence[str], *, unique: bool, signed: bool) -> dict[str, object]:
    values: dict[str, object] = {name: getattr(summary, name) for name in ("env", "ads", "method", "seed")}
    values |= {"executions": summary.executions, "failed": summary.total()}
    values |= {f"failed_{label}": summary.total(label) for label in labels}
    values |= {"R1_npc_caused": summary.npc_caused, "R1_other": summary.total("R1") - summary.npc_caused}
    if unique:
        values |= {"unique": len(summary.kinds()), **{f"unique_{label}": len(summary.kinds(label)) for label in labels}}
        values["classes"] = " ".join(sorted(summary.kinds()))
    if signed:
        values |= {"weaknesses": len(summary.weaknesses()), "signatures": " ".join(sorted(summary.weaknesses()))}
    values["novelty_rate"] = _rounded(summary.novelty_rate, 6)
    values["executing_s"] = _rounded(summary.executing, 3)
    values["analysing_s"] = _rounded(summary.analysing, 3)
    values |= {"r_BF": _rounded(summary.r, 6), "r_BF_p": "" if summary.r_p is None else f"{summary.r_p:.6g}"}
    return values


def _rounded(value: float | None, digits: int) -> float | str:
    return "" if value is None or math.isnan(value) else round(value, digits)
