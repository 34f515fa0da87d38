"""Summaries of campaigns in figures, computed from their run folders alone."""

import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import scipy

from behavexplor.bench.experiment import PlannedRun
from behavexplor.campaign.progress import executing_and_analysing
from behavexplor.campaign.record import ERROR, Record
from behavexplor.campaign.store import Store
from behavexplor.data.csv_text import csv_text
from behavexplor.data.scripted_logical import ROUTES, WAYPOINTS
from behavexplor.data.trace import ENVIRONMENT
from behavexplor.judge.discovery import Discovery
from behavexplor.judge.events import REQUIREMENTS
from behavexplor.judge.fault import NPC_CAUSED
from behavexplor.triage.signatures import signature

LABELS: Final = {**REQUIREMENTS, ERROR: "error"}  # labels of the specs in tables; a user's spec keeps its name
UNEXPLAINED: Final = "unexplained"
_LEAST: Final = 3  # least number of mutants for a correlation


class Mutant(NamedTuple):
    """An execution for which the search method measured the distance of its behavior from the known ones."""

    degree: float  # violation degree
    distance: float  # distance of the behavior from the nearest known one, in [0, 1]
    failed: bool  # whether it violated a spec


@dataclass(frozen=True)
class Failure:
    """A failed execution."""

    number: int  # number of the execution, counted from 0
    label: str  # most severe spec that it violates: "R1", "R2", "R3" or the name of a user's spec; or "error"
    npc_caused: bool  # whether it is a collision that an NPC caused, judged from the trace alone
    kind: str  # class of the violation
    # weakness of the rule planner that the decision log indicates, or "environment" or "unexplained"; None for a driver
    # without that log
    signature: str | None = None

    @property
    def at_fault(self) -> bool:
        """True if the ADS was at fault, as far as the trace can tell."""
        return not self.npc_caused


@dataclass(frozen=True)
class Summary:
    """Summary of one campaign."""

    env: str  # environment
    ads: str  # driving system under test
    method: str  # name of the search method in the experiment
    seed: int  # seed of the campaign
    executions: int  # number of executions
    failures: tuple[Failure, ...]  # all failures in order
    novelty_rate: float  # share of executions with a behavior that was new to the campaign
    executing: float  # time spent on executions [s]
    analysing: float  # time spent on everything else [s]
    durations: tuple[float, ...] = ()  # simulated time of each execution [s]; empty if that was not recorded
    # executions for which the method measured the distance of their behavior from the known ones
    mutants: tuple[Mutant, ...] = ()
    mutations: tuple[int, int] = (0, 0)  # numbers of waypoint mutations and of route mutations
    assignments: int = 0  # number of distinct assignments of types and routes to the NPCs
    # labels of the specs in tables, in order: "R1", "R2", "R3", the user's specs, and "error"
    labels: tuple[str, ...] = tuple(LABELS.values())

    @property
    def time(self) -> float:
        """Simulated time and analysis time, the paper's budget [s]; nan if one of them was not recorded."""
        return sum(self.durations) + self.analysing if self.durations else math.nan

    def within(self, seconds: float) -> "Summary":
        """Return the summary of the campaign as it was after some of its `time`, without mutants and mutations.

        The analysis time is spread evenly over the executions.
        """
        spent = np.cumsum(self.durations) + self.analysing * np.arange(1, self.executions + 1) / self.executions
        return self.first(int(np.searchsorted(spent, seconds * (1 + 1e-12), side="right")))

    def first(self, count: int) -> "Summary":
        """Return the summary of the first executions, without mutants and mutations."""
        share = count / self.executions
        return replace(
            self,
            executions=count,
            failures=tuple(failure for failure in self.failures if failure.number < count),
            executing=self.executing * share,
            analysing=self.analysing * share,
            durations=self.durations[:count],
            mutants=(),
            mutations=(0, 0),
        )

    def total(self, label: str | None = None) -> int:
        """Return the number of failures with a label, or of all failures."""
        return sum(label in (None, failure.label) for failure in self.failures)

    def kinds(self, label: str | None = None, before: int | None = None) -> frozenset[str]:
        """Return the unique violations: the classes of the failures with this label, before the execution `before`.

        None stands for all failures.
        """
        return frozenset(
            failure.kind
            for failure in self.failures
            if label in (None, failure.label) and (before is None or failure.number < before)
        )

    def at_fault(self) -> int:
        """Return the number of failures for which the ADS was at fault."""
        return sum(failure.at_fault for failure in self.failures)

    def classes_at_fault(self) -> int:
        """Return the number of classes of failures for which the ADS was at fault."""
        return len({failure.kind for failure in self.failures if failure.at_fault})

    @property
    def discovery(self) -> Discovery:
        """What the campaign has not found yet."""
        return Discovery.of((failure.kind for failure in self.failures), self.executions)

    def weaknesses(self) -> frozenset[str]:
        """Return the weaknesses of the rule planner in the signatures of the failures."""
        signatures = {failure.signature for failure in self.failures} - {ENVIRONMENT, UNEXPLAINED}
        return frozenset(name for name in signatures if name is not None)

    @property
    def signed(self) -> bool:
        """True if every failure has a signature."""
        return all(failure.signature is not None for failure in self.failures)

    @property
    def npc_caused(self) -> int:
        """Number of collisions that NPCs caused."""
        return sum(failure.npc_caused for failure in self.failures)


def summarize(run: PlannedRun, root: Path) -> Summary:
    """Return the summary of a run from its run folder.

    Raises:
        InputError: if the run folder is damaged.
    """
    with closing(Store.read(root / run.folder)) as store:
        records = list(store.records())
        failures = _with_signatures([_failure(record) for record in records if record.failed], store)
        executing, analysing = executing_and_analysing(store.stages)
    specs = dict.fromkeys([*REQUIREMENTS, *(name for record in records for name in record.degrees)])
    origins = [record.origin for record in records]
    return Summary(
        run.env,
        run.ads,
        run.method,
        run.seed,
        len(records),
        tuple(failures),
        sum(record.novel for record in records) / len(records),
        executing,
        analysing,
        durations=_durations(records),
        mutants=tuple(_mutants(records)),
        mutations=(origins.count(WAYPOINTS), origins.count(ROUTES)),
        assignments=len({_assignment(record) for record in records}),
        labels=tuple(LABELS.get(name, name) for name in (*specs, ERROR)),
    )


def _durations(records: Sequence[Record]) -> tuple[float, ...]:
    durations = [record.duration for record in records if record.duration is not None]
    return tuple(durations) if len(durations) == len(records) else ()


def _mutants(records: Sequence[Record]) -> Iterator[Mutant]:
    for record in records:
        if "novelty" in record.search and record.error is None and record.degree is not None:
            yield Mutant(record.degree, float(record.search["novelty"]), record.failed)


def _assignment(record: Record) -> tuple[tuple[str, str], ...]:
    """Return the type and the route of each NPC; nothing in a highway-env environment, whose vehicles have none."""
    return tuple((npc["type"], npc["route"]) for npc in record.scenario.get("npcs", ()))


def _failure(record: Record) -> Failure:
    label = LABELS.get(record.violated[0], record.violated[0])
    return Failure(record.id, label, record.fault in NPC_CAUSED, record.violation_class or "")


def _with_signatures(failures: Sequence[Failure], store: Store) -> list[Failure]:
    """Return the failures with their signatures, or unchanged if the driver keeps no log of its weaknesses."""
    signed = []
    for failure in failures:
        execution = store.execution(failure.number)
        trace = execution.load_trace()
        if failure.label != LABELS[ERROR] and "triggered" not in trace.decisions:
            return list(failures)
        found = signature(trace, execution.record.violated)
        signed.append(replace(failure, signature=found or UNEXPLAINED))
    return signed


def all_signed(summaries: Sequence[Summary]) -> bool:
    """Return whether every failure of an experiment has a signature, and at least one of them names a weakness."""
    return all(summary.signed for summary in summaries) and any(summary.weaknesses() for summary in summaries)


def all_labels(summaries: Sequence[Summary]) -> tuple[str, ...]:
    """Return the labels of all specs of an experiment, in order, with "error" last."""
    named = dict.fromkeys(label for summary in summaries for label in summary.labels)
    return (*(label for label in named if label != LABELS[ERROR]), LABELS[ERROR])


def summary_rows(summaries: Sequence[Summary]) -> list[dict[str, object]]:
    """Return a row for each campaign, as values by column name.

    Columns of signatures are left out unless all failures of the experiment have them.
    """
    signed, labels = all_signed(summaries), all_labels(summaries)
    return [_row(summary, labels, signed=signed) for summary in summaries]


def summaries_csv(summaries: Sequence[Summary]) -> str:
    """Return the rows of all campaigns as CSV."""
    rows = summary_rows(summaries)
    return csv_text([rows[0] if rows else ["env"], *(row.values() for row in rows)])


def _row(summary: Summary, labels: Sequence[str], *, signed: bool) -> dict[str, object]:
    values: dict[str, object] = {name: getattr(summary, name) for name in ("env", "ads", "method", "seed")}
    values |= {"executions": summary.executions, "failed": summary.total(), "at_fault": summary.at_fault()}
    values |= {f"failed_{label}": summary.total(label) for label in labels}
    values |= {"R1_npc_caused": summary.npc_caused, "R1_other": summary.total("R1") - summary.npc_caused}
    values |= {"unique": len(summary.kinds()), **{f"unique_{label}": len(summary.kinds(label)) for label in labels}}
    values["at_fault_classes"] = summary.classes_at_fault()
    values |= {"new_class_chance": _rounded(summary.discovery.new_chance, 6)}
    values |= {"unseen_classes": _rounded(summary.discovery.unseen, 3)}
    values["classes"] = " ".join(sorted(summary.kinds()))
    if signed:
        values |= {"weaknesses": len(summary.weaknesses()), "signatures": " ".join(sorted(summary.weaknesses()))}
    values["novelty_rate"] = _rounded(summary.novelty_rate, 6)
    values["executing_s"] = _rounded(summary.executing, 3)
    values["analysing_s"] = _rounded(summary.analysing, 3)
    values["simulated_s"] = round(sum(summary.durations), 3) if summary.durations else ""
    values |= dict(zip(("waypoint_mutations", "route_mutations"), summary.mutations, strict=True))
    values["assignments"] = summary.assignments
    for name, passed in (("r_BF", False), ("r_BF_passed", True)):
        found = correlation(summary.mutants, passed=passed)
        values |= {name: found and round(found.r, 6), f"{name}_p": found and f"{found.p:.6g}"}
    return values


def _rounded(value: float | None, digits: int) -> float | str:
    return "" if value is None or math.isnan(value) else round(value, digits)


class Correlation(NamedTuple):
    """Pearson's correlation of violation degree and behavior distance."""

    n: int  # number of mutants
    r: float  # the correlation
    p: float  # its two-sided p-value, for independent mutants


def correlation(mutants: Iterable[Mutant], *, passed: bool = False) -> Correlation | None:
    """Return the correlation of degree and distance; None if one of them does not vary or there are too few mutants.

    With `passed`, only mutants that did not fail count. A failing run ends early at a collision or late at a
    standstill, so that its length makes it far from other behaviors, and its violation makes its degree low.
    """
    chosen = [(mutant.degree, mutant.distance) for mutant in mutants if not (passed and mutant.failed)]
    values = np.asarray(chosen, dtype=float).reshape(-1, 2)
    if len(values) < _LEAST or not np.ptp(values, axis=0).all():
        return None
    found = scipy.stats.pearsonr(values[:, 0], values[:, 1])
    return Correlation(len(values), float(found.statistic), float(found.pvalue))
