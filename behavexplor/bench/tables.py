"""The tables of an experiment as values. `behavexplor.bench.table` converts them to text."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from behavexplor.bench.comparisons import EqualTime, comparisons, in_equal_time, joint_comparisons
from behavexplor.bench.experiment import Experiment
from behavexplor.bench.overviews import correlations, forecasts, mutations, overviews, pooled_forecasts
from behavexplor.bench.statistics import estimate
from behavexplor.bench.summaries import LABELS, Summary, all_labels, all_signed
from behavexplor.bench.table import (
    Column,
    Figure,
    Table,
    Value,
    mean,
    n_weaknesses,
    novelty,
    table_by_method,
    total,
    unique,
)
from behavexplor.campaign.record import ERROR

SIGNATURES: Final = (
    "Signatures are derived from a failure's trace and decision log alone; `triage` reports how often they agree with "
    "the cause that replays show."
)
RARITY: Final = (
    "The rarity of each weakness was set with the paper's findings in sight, so finding all sixteen replicates nothing."
)


def tables(experiment: Experiment, summaries: Sequence[Summary]) -> list[Table]:
    """Return the tables of an experiment that have rows; the summaries are those of its finished campaigns."""
    made = [violations("violations", "Violations found", experiment, summaries, ())]  # of all methods
    cut = in_equal_time(experiment, summaries)
    if cut:
        made.append(violations_in_equal_time(experiment, cut))
    for name, methods in experiment.groups.items():
        made.append(violations(f"violations-{name}", f"Violations found: {name}", experiment, summaries, methods))
    made.append(distinct(experiment, summaries))
    made += [forecasts(experiment, summaries), pooled_forecasts(experiment, summaries)]
    if all_signed(summaries):
        made.append(weaknesses(experiment, summaries))
    made += overviews(experiment, summaries, cut)
    made.append(times(experiment, summaries))
    made += [mutations(experiment, summaries), correlations(experiment, summaries)]
    made += joint_comparisons(experiment, summaries) + comparisons(experiment, summaries)
    return [table for table in made if table.rows]


def violations(
    name: str, title: str, experiment: Experiment, summaries: Sequence[Summary], methods: Sequence[str]
) -> Table:
    """Return the table of total and unique violations by spec, means over the seeds (the paper's RQ1, RQ2 and RQ3).

    Without `methods`, it has all methods of the experiment.
    """
    columns = [*_found(summaries), (Column("Novel %"), novelty)]
    notes = (
        "Question: how many failures does each method find, and of how many kinds? (RQ1 of the paper for different "
        "methods, RQ2 for an ablation, RQ3 for windows)",
        f"Means over n campaigns of {experiment.budget} executions, with the 95 % interval in brackets (Student's t).",
        *_explained(summaries),
    )
    return _means(Table(name, title, (), notes=notes), experiment, summaries, columns, methods)


def violations_in_equal_time(experiment: Experiment, cut: EqualTime) -> Table:
    """Return the table of violations that each method found in the same time."""
    columns: list[tuple[Column, Figure]] = [
        (Column("Executions"), lambda summary: summary.executions),
        *_found(cut.summaries),
    ]
    notes = (
        "Question: which method finds most in the same time, as the paper compares them, instead of in the same number "
        "of executions?",
        *cut.notes,
        *_explained(cut.summaries),
    )
    table = Table("violations-equal-time", "Violations found in equal time", (), notes=notes)
    return _means(table, experiment, cut.summaries, columns)


def _found(summaries: Sequence[Summary]) -> list[tuple[Column, Figure]]:
    """Return the columns of findings, with their figures."""
    columns: list[tuple[Column, Figure]] = [
        (Column("At fault", interval=True, best=True), Summary.at_fault),
        (Column("At-fault classes", interval=True, best=True), Summary.classes_at_fault),
        *((Column(label), total(label)) for label in _labels(summaries)),
        (Column("Sum", interval=True, best=True), total(None)),
        (Column("R1 by NPC"), lambda summary: summary.npc_caused),
        *((Column(f"Unique {label}"), unique(label)) for label in _labels(summaries)),
        (Column("Unique sum", interval=True, best=True), unique(None)),
    ]
    if all_signed(summaries):
        columns += [(Column("Weaknesses", interval=True, best=True), n_weaknesses)]
    return columns


def _explained(summaries: Sequence[Summary]) -> tuple[str, ...]:
    """Return the notes on the columns of findings."""
    return (
        "At fault: failures other than R1 by NPC. At-fault classes: the number of their classes.",
        "Each failure is counted under its most severe type.",
        "R1 by NPC: collisions in which an NPC drove into the back of the ego, or into a standing ego.",
        *(("Weaknesses: number of the planner's sixteen. " + SIGNATURES,) if all_signed(summaries) else ()),
        *((RARITY,) if all_signed(summaries) else ()),
    )


def _means(
    table: Table,
    experiment: Experiment,
    summaries: Sequence[Summary],
    columns: Sequence[tuple[Column, Figure]],
    methods: Sequence[str] = (),
) -> Table:
    """Return a table with the means of the figures in its columns; see `table_by_method` for its rows."""

    def cells(found: Sequence[Summary]) -> tuple[Value, ...]:
        return (len(found), *(mean(found, figure) for _, figure in columns))

    heads = (Column("n"), *(column for column, _ in columns))
    return table_by_method(replace(table, columns=heads), experiment, summaries, cells, methods)


def distinct(experiment: Experiment, summaries: Sequence[Summary]) -> Table:
    """Return the table of unique violations over all environments and seeds (the paper's table of diversity)."""
    labels = _labels(summaries)
    rows: list[tuple[Value, ...]] = []
    for method in experiment.methods:
        found = [summary for summary in summaries if summary.method == method]
        if not found:
            continue
        by_label = [frozenset[str]().union(*(summary.kinds(label) for summary in found)) for label in labels]
        kinds = frozenset[str]().union(*(summary.kinds() for summary in found))
        rows.append((method, len(found), *map(len, by_label), len(kinds), ", ".join(sorted(kinds))))
    heads = (Column("Method"), Column("Campaigns"), *map(Column, labels), Column("Sum"))
    heads += (Column("Details", only_csv=True),)
    notes = (
        "Question: how many kinds of failures does each method find in all its campaigns? (the paper's diversity)",
        "Classes of violations that at least one campaign found; more campaigns find more classes.",
    )
    return Table("distinct", "Distinct violations over all campaigns", heads, tuple(rows), (len(rows),), notes)


def weaknesses(experiment: Experiment, summaries: Sequence[Summary]) -> Table:
    """Return the table of weaknesses: the number of campaigns that found each (the paper's table of diversity)."""
    known = sorted(frozenset[str]().union(*(summary.weaknesses() for summary in summaries)))
    rows: list[tuple[Value, ...]] = []
    for method in experiment.methods:
        found = [summary.weaknesses() for summary in summaries if summary.method == method]
        if not found:
            continue
        counts = [sum(name in names for names in found) for name in known]
        rows.append((method, len(found), *counts, sum(count > 0 for count in counts)))
    heads = tuple(map(Column, ("Method", "Campaigns", *known, "Distinct")))
    notes = (
        "Question: which weaknesses of the planner does each method reveal? (the paper's diversity)",
        "Number of campaigns in all scenarios with a failure whose signature is that weakness.",
        SIGNATURES,
        RARITY,
    )
    return Table("weaknesses", "Weaknesses of the planner found", heads, tuple(rows), (len(rows),), notes)


def times(experiment: Experiment, summaries: Sequence[Summary]) -> Table:
    """Return the table of execution and analysis times (the paper's table of performance)."""
    rows: list[tuple[Value, ...]] = []
    for method in experiment.methods:
        found = [s for s in summaries if s.method == method and not math.isnan(s.executing + s.analysing)]
        if not found:
            continue
        executing = estimate([s.executing for s in found])
        analysing = estimate([s.analysing for s in found])
        together = executing.mean + analysing.mean
        rate = sum(s.executions for s in found) / max(together * len(found), 1e-9)
        rows.append((method, len(found), executing, analysing, 100 * analysing.mean / max(together, 1e-9), rate))
    names = ("Method", "Campaigns", "Executing [s]", "Analysing [s]", "Analysing %", "Executions per s")
    heads = tuple(map(Column, names))
    notes = (
        "Question: what does each method cost? (the paper's performance)",
        "Means over the campaigns of all environments. Each ran on one core, possibly shared with other processes.",
    )
    return Table("times", "Time of a campaign", heads, tuple(rows), (len(rows),), notes)


def _labels(summaries: Sequence[Summary]) -> list[str]:
    """Return the labels of all specs, with "error" only if there were errors."""
    seen = {failure.label for summary in summaries for failure in summary.failures}
    return [label for label in all_labels(summaries) if label != LABELS[ERROR] or label in seen]
