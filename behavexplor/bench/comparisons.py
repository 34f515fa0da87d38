"""The comparisons of an experiment's methods: tables, campaigns in equal time, and curves of what they find."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from behavexplor.bench.experiment import Experiment, slug
from behavexplor.bench.statistics import LEVEL, Estimate, compare, compare_together, least_p
from behavexplor.bench.summaries import Summary, all_signed
from behavexplor.bench.table import (
    Column,
    Figure,
    Table,
    Value,
    mean,
    n_weaknesses,
    of_group,
    p_text,
    place_cells,
    place_columns,
    total,
    unique,
)
from behavexplor.data.csv_text import csv_text

_AT_FAULT_CLASSES: Final = ("at-fault-classes", "classes of failures at fault", Summary.classes_at_fault)
UNDECIDED: Final = "undecided"
POINTS: Final = 50  # approximate number of points of a curve
_CURVE_COLUMNS: Final = ("figure", "env", "ads", "method", "executions", "n", "mean", "low", "high")
_HEADLINE_NOTE: Final = (
    "Means of the campaigns, also of the method that names a column. A12: probability that a campaign of the first "
    f"method finds more. Verdict: two-sided Mann-Whitney U test with Holm's correction, level {LEVEL:g}; undecided: "
    "not distinguishable."
)
Sample = tuple[str, str, str, str, list[float], list[float]]  # environment, ADS, two methods and the values of each


def comparisons(experiment: Experiment, summaries: Sequence[Summary]) -> list[Table]:
    """Return tables that compare the reference with each other method, and each method with the baseline.

    Each figure has one table for each of the two, and one for each of the experiment's contrasts. The figures are
    failures at fault and their classes, all failures, unique violations and weaknesses.
    """
    return [
        _compared(f"{key}-{slug(name).lower()}", f"Number of {words}: {title}", experiment, rows)
        for name, title, pairs in families(experiment)
        for key, words, figure in compared_figures(summaries)
        if (rows := samples(experiment, summaries, pairs, figure))
    ]


def compared_figures(summaries: Sequence[Summary]) -> list[tuple[str, str, Figure]]:
    """Return the figures in which methods are compared: their keys, their names, and the figures."""
    figures = [
        ("at-fault", "failures at fault", Summary.at_fault),
        _AT_FAULT_CLASSES,
        ("unique", "unique violations", unique(None)),
        ("failures", "failures", total(None)),
    ]
    if all_signed(summaries):
        figures.append(("weaknesses", "weaknesses of the planner", n_weaknesses))
    return figures


def families(experiment: Experiment) -> list[tuple[str, str, list[tuple[str, str]]]]:
    """Return the families of comparisons: their names, titles and pairs of methods."""
    others = [method for method in experiment.methods if method != experiment.compared]
    reference, baseline = experiment.compared, experiment.baseline
    made = [(reference, f"{reference} compared", [(reference, other) for other in others])]
    if baseline and baseline != reference:
        rivals = [method for method in experiment.methods if method != baseline]
        made.append((baseline, f"{baseline} compared", [(rival, baseline) for rival in rivals]))
    return made + [(f"contrast-{name}", name, list(pairs)) for name, pairs in experiment.contrasts.items()]


def samples(
    experiment: Experiment, summaries: Sequence[Summary], pairs: Sequence[tuple[str, str]], figure: Figure
) -> list[Sample]:
    """Return the samples of each pair of methods, for each environment and ADS in which both have finished campaigns.

    A sample is the environment, the ADS, the names of both methods, and the values of a figure in their campaigns.
    """

    def values(env: str, ads: str, method: str) -> list[float]:
        return [figure(summary) for summary in of_group(summaries, (env, ads, method))]

    found = [
        (env, ads, one, other, values(env, ads, one), values(env, ads, other))
        for env, ads in experiment.places
        for one, other in pairs
    ]
    return [sample for sample in found if sample[4] and sample[5]]


def headline(experiment: Experiment, summaries: Sequence[Summary]) -> list[Table]:
    """Return what an experiment says first: a narrow table of verdicts, with a sentence on each method as a note.

    Each method is compared with the baseline, or the reference with each other method if no other is the baseline, by
    the classes of failures at fault. Without two methods, there is no table.
    """
    named = {name: pairs for name, _, pairs in families(experiment)}
    pairs = named[experiment.baseline or experiment.compared]
    _, words, figure = _AT_FAULT_CLASSES
    found = samples(experiment, summaries, pairs, figure)
    if not found:
        return []
    compared = compare([sample[4:] for sample in found])
    by_baseline = experiment.baseline not in ("", experiment.compared)  # or else by the reference, see `families`
    rows = []
    for (*place, one, other, _, _), c in zip(found, compared, strict=True):
        scenario, method = " ".join(place_cells(experiment, *place)), one if by_baseline else other
        rows.append((scenario, method, *c.means, c.effect, UNDECIDED if c.corrected >= LEVEL else c.verdict))
    places = [row[0] for row in rows]
    blocks = tuple(places.count(place) for place in dict.fromkeys(places))
    middle = ["Method", "Mean", experiment.baseline] if by_baseline else ["Against", experiment.compared, "Mean"]
    heads = tuple(Column(name, digits=2 if name == "A12" else 1) for name in ("Scenario", *middle, "A12", "Verdict"))
    notes = [_HEADLINE_NOTE]
    for one, other in pairs:
        said = [
            c.verdict.partition(",")[0]
            for sample, c in zip(found, compared, strict=True)
            if sample[2:4] == (one, other)
        ]
        counts = ", ".join(f"{word} in {said.count(word)}" for word in sorted(set(said)))
        notes += [f"{one} against {other}: {counts} of {len(said)} scenarios."] if said else []
    return [Table("headline", f"Number of {words}", heads, tuple(rows), blocks, tuple(notes))]


def joint_comparisons(experiment: Experiment, summaries: Sequence[Summary]) -> list[Table]:
    """Return a table for each family of comparisons, over all scenarios together; none for one scenario.

    A pair of methods is compared over the scenarios in which both have finished campaigns.
    """
    if len(experiment.places) == 1:
        return []
    made = [_together(name, title, pairs, experiment, summaries) for name, title, pairs in families(experiment)]
    return [table for table in made if table.rows]


def _together(
    name: str, title: str, pairs: Sequence[tuple[str, str]], experiment: Experiment, summaries: Sequence[Summary]
) -> Table:
    """Return the table of a family of comparisons over all scenarios together."""
    figures = compared_figures(summaries)
    met = [pair for pair in pairs if samples(experiment, summaries, [pair], figures[0][2])]
    found = [
        compare_together([[sample[4:] for sample in samples(experiment, summaries, [pair], figure)] for pair in met])
        for _, _, figure in figures
    ]
    rows: list[tuple[Value, ...]] = []
    for pair, *compared in zip(met, *found, strict=True):
        shown = [f"{one.effect:.2f}{'*' if one.corrected < LEVEL else ''}" for one in compared]
        rows.append((*pair, *shown, *(one.corrected for one in compared)))
    names = [words for _, words, _ in figures]
    heads = [Column("Method"), Column("Against"), *map(Column, names)]
    heads += [Column(f"p Holm: {words}", only_csv=True) for words in names]
    notes = (
        "Question: does the method find more than the one that it is compared with, over all scenarios together?",
        "A12, the mean over the scenarios: probability that a campaign of the method finds more than one of the other "
        "method; 0.5: no difference.",
        f"*: significant at {LEVEL:g} by van Elteren's test, which is the Mann-Whitney U test stratified by scenario, "
        "with Holm's correction over the comparisons of the same figure.",
    )
    return Table(f"together-{slug(name).lower()}", f"All scenarios: {title}", (*heads,), (*rows,), (len(rows),), notes)


def _compared(name: str, title: str, experiment: Experiment, found: Sequence[Sample]) -> Table:
    """Return a table of comparisons, which form one family for the correction."""
    compared = compare([(first, second) for *_, first, second in found])
    rows: list[tuple[Value, ...]] = []
    for (env, ads, one, other, _, _), c in zip(found, compared, strict=True):
        ps = p_text(c.p), p_text(c.corrected)
        rows.append((*place_cells(experiment, env, ads), one, other, *c.n, *c.means, c.effect, *ps, c.verdict))
    places = [sample[:2] for sample in found]
    blocks = tuple(places.count(place) for place in dict.fromkeys(places))
    heads = (*place_columns(experiment), Column("Method"), Column("Against"), Column("n"), Column("m"))
    heads += (Column("Mean"), Column("Mean against"), Column("A12", digits=2), Column("p"), Column("p Holm"))
    heads += (Column("Verdict"),)
    notes = [
        "Question: does the method find more than the one that it is compared with, beyond chance?",
        f"Two-sided Mann-Whitney U test with Holm's correction for {len(compared)} comparisons, level {LEVEL:g}.",
        "A12: probability that a campaign of the method finds more than one of the other method; 0.5: no difference.",
    ]
    least = min(least_p(*c.n) for c in compared) * len(compared)
    if least >= LEVEL:
        notes.append(f"So few seeds cannot be significant here: the least corrected p is {p_text(min(1.0, least))}.")
    return Table(name, title, (*heads,), tuple(rows), blocks, tuple(notes))


@dataclass(frozen=True)
class EqualTime:
    """The campaigns of an experiment, cut off at the same time."""

    summaries: tuple[Summary, ...]  # summaries of what the campaigns found until then
    notes: tuple[str, ...]  # sentences that say which time it is


def in_equal_time(experiment: Experiment, summaries: Sequence[Summary]) -> EqualTime | None:
    """Return the campaigns of an experiment in equal time; None if a time was not measured.

    The time is that of the paper's budget: the simulated time of the executions, and the time for everything else. In
    each environment, all campaigns are cut off at the time that the shortest one took.
    """
    if any(math.isnan(summary.time) for summary in summaries):
        return None
    cut, limits = [], []
    for env, ads in experiment.places:
        here = [summary for summary in summaries if (summary.env, summary.ads) == (env, ads)]
        if here:
            limit = min(summary.time for summary in here)
            cut += [summary.within(limit) for summary in here]
            limits.append(f"{' with '.join(place_cells(experiment, env, ads))} {limit / 3600:.2f} h")
    notes = (
        f"The time of the shortest campaign: {', '.join(limits)}. It is the simulated time of the executions, "
        "and the measured time for everything else, spread evenly over the executions.",
    )
    return EqualTime(tuple(cut), notes)


@dataclass(frozen=True)
class Curve:
    """The mean over campaigns of a count of findings, by number of executions."""

    figure: str  # counted findings, such as "failures at fault"; see `compared_figures`
    env: str  # environment
    ads: str  # driving system under test
    method: str  # name of the search method in the experiment
    executions: tuple[int, ...]  # numbers of executions, increasing up to the budget
    found: tuple[Estimate, ...]  # estimates of the count, one for each number of executions
    ends: tuple[float, ...]  # the count of each campaign at the end


def curves(experiment: Experiment, summaries: Sequence[Summary]) -> list[Curve]:
    """Return all curves of an experiment, for the figures in which its methods are compared."""
    step = max(1, math.ceil(experiment.budget / POINTS))
    at = tuple(sorted({*range(step, experiment.budget, step), experiment.budget}))
    groups = dict.fromkeys((summary.env, summary.ads, summary.method) for summary in summaries)
    early = {  # what each campaign had found after each number of executions
        group: [[one.first(min(count, one.executions)) for one in of_group(summaries, group)] for count in at]
        for group in groups
    }
    return [
        Curve(
            name,
            *group,
            at,
            tuple(mean(found, figure) for found in early[group]),
            tuple(float(figure(one)) for one in early[group][-1]),
        )
        for _, name, figure in compared_figures(summaries)
        for group in groups
    ]


def curves_csv(found: Sequence[Curve]) -> str:
    """Return the curves as CSV, with a row for each point."""
    rows: list[tuple[object, ...]] = [_CURVE_COLUMNS]
    for curve in found:
        for count, point in zip(curve.executions, curve.found, strict=True):
            ends = ("" if math.isnan(end) else round(end, 6) for end in (point.low, point.high))
            rows.append((curve.figure, curve.env, curve.ads, curve.method, count, point.n, round(point.mean, 6), *ends))
    return csv_text(rows)
