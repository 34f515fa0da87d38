"""The tables of an experiment as values. `behavexplor.bench.writing` converts them to text."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from behavexplor.bench.experiment import Experiment, slug
from behavexplor.bench.statistics import LEVEL, Estimate, compare, estimate, least_p
from behavexplor.bench.summaries import LABELS, Summary, all_classified, all_labels, all_signed
from behavexplor.campaign.record import ERROR

Value = str | int | float | Estimate | None
Figure = Callable[[Summary], float]

_STRONG_P = 0.001  # significance level that the paper reports for its correlations
_SIGNATURES = (
    "Signatures are derived from a failure's trace and decision log alone; `triage` reports how often they agree with "
    "the cause that replays show."
)


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes:
        name: heading of the column.
        digits: number of digits after the decimal point.
        interval: whether estimates are shown with their intervals. The CSV file always has the intervals.
        best: whether the greatest estimate of each block is marked.
        only_csv: whether the column is only in the CSV file, because it is too wide for other formats.
    """

    name: str
    digits: int = 1
    interval: bool = False
    best: bool = False
    only_csv: bool = False


@dataclass(frozen=True)
class Table:
    """A table.

    Attributes:
        name: name of its files.
        title: title of the table.
        columns: columns of the table.
        rows: rows, each with a value for each column.
        blocks: numbers of rows in consecutive blocks, which are set apart.
        notes: sentences below the table.
    """

    name: str
    title: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Value, ...], ...]
    blocks: tuple[int, ...]
    notes: tuple[str, ...] = ()


Group = tuple[str, str, str]  # environment, ADS, method


def tables(experiment: Experiment, summaries: Sequence[Summary]) -> list[Table]:
    """Return all tables of an experiment.

    Args:
        experiment: the experiment.
        summaries: summaries of its finished campaigns.
    """
    made = [violations("violations", "Violations found", experiment, summaries, tuple(experiment.methods))]
    for name, methods in experiment.groups.items():
        made.append(violations(f"violations-{name}", f"Violations found: {name}", experiment, summaries, methods))
    if all_classified(summaries):
        made.append(distinct(experiment, summaries))
    if all_signed(summaries):
        made.append(weaknesses(experiment, summaries))
    made.append(times(experiment, summaries))
    if any(summary.r is not None for summary in summaries):
        made.append(correlations(experiment, summaries))
    return made + comparisons(experiment, summaries)


def violations(
    name: str, title: str, experiment: Experiment, summaries: Sequence[Summary], methods: Sequence[str]
) -> Table:
    """Return the table of total and unique violations by spec, means over the seeds (the paper's RQ1, RQ2 and RQ3)."""
    columns: list[tuple[Column, Figure]] = [
        *((Column(label), _total(label)) for label in _labels(summaries)),
        (Column("Sum", interval=True, best=True), _total(None)),
        (Column("R1 by NPC"), lambda summary: summary.npc_caused),
    ]
    if all_classified(summaries):
        columns += [(Column(f"Unique {label}"), _unique(label)) for label in _labels(summaries)]
        columns += [(Column("Unique sum", interval=True, best=True), _unique(None))]
    if all_signed(summaries):
        columns += [(Column("Weaknesses", interval=True, best=True), _weaknesses)]
    columns += [(Column("Novel %"), lambda summary: 100 * summary.novelty_rate)]
    rows: list[tuple[Value, ...]] = []
    blocks = []
    for env, ads in _places(experiment):
        of_methods = [(method, _of(summaries, (env, ads, method))) for method in methods]
        block: list[tuple[Value, ...]] = [
            (*_place(experiment, env, ads), method, len(found), *(_mean(found, figure) for _, figure in columns))
            for method, found in of_methods
            if found
        ]
        rows += block
        blocks.append(len(block))
    heads = (*_place_columns(experiment), Column("Method"), Column("n"), *(column for column, _ in columns))
    notes = (
        "Question: how many failures does each method find, and of how many kinds? (RQ1 of the paper for different "
        "methods, RQ2 for an ablation, RQ3 for windows)",
        f"Means over n campaigns of {experiment.budget} executions, with the 95 % interval in brackets (Student's t).",
        "Each failure is counted under its most severe type.",
        "R1 by NPC: collisions in which an NPC drove into the back of the ego, or into a standing ego.",
        *(("Weaknesses: number of the planner's sixteen. " + _SIGNATURES,) if all_signed(summaries) else ()),
    )
    return Table(name, title, heads, tuple(rows), tuple(filter(None, blocks)), notes)


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
        _SIGNATURES,
    )
    return Table("weaknesses", "Weaknesses of the planner found", heads, tuple(rows), (len(rows),), notes)


def times(experiment: Experiment, summaries: Sequence[Summary]) -> Table:
    """Return the table of execution and analysis times (the paper's table of performance)."""
    rows: list[tuple[Value, ...]] = []
    for method in experiment.methods:
        found = [s for s in summaries if s.method == method and not math.isnan(s.executing + s.analysing)]
        if not found:
            continue
        executing, analysing = (estimate([getattr(s, name) for s in found]) for name in ("executing", "analysing"))
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


def correlations(experiment: Experiment, summaries: Sequence[Summary]) -> Table:
    """Return the table of correlations of violation degree and behavior distance (the paper's r_BF)."""
    rows: list[tuple[Value, ...]] = []
    blocks = []
    for env, ads in _places(experiment):
        block = [
            (*_place(experiment, env, ads), method, *_correlation(_of(summaries, (env, ads, method))))
            for method in experiment.methods
            if any(summary.r is not None for summary in _of(summaries, (env, ads, method)))
        ]
        rows += block
        blocks.append(len(block))
    heads = (*_place_columns(experiment), Column("Method"), Column("n"), Column("r_BF", digits=2, interval=True))
    heads += (Column(f"p < {_STRONG_P:g}"),)
    notes = (
        "Question: does new behavior come nearer to a violation?",
        "Pearson's r of the violation degree of a mutant and its distance to the known behaviors, in each campaign.",
        "A lower degree is nearer to a violation, so a negative r means that new behavior came nearer to one.",
    )
    title = "Correlation of violation degree and behavior distance"
    return Table("correlations", title, heads, tuple(rows), tuple(filter(None, blocks)), notes)


def _correlation(found: Sequence[Summary]) -> tuple[Value, ...]:
    measured = [summary for summary in found if summary.r is not None]
    strong = sum(summary.r_p is not None and summary.r_p < _STRONG_P for summary in measured)
    return len(measured), estimate([summary.r or 0.0 for summary in measured]), f"{strong} of {len(measured)}"


def comparisons(experiment: Experiment, summaries: Sequence[Summary]) -> list[Table]:
    """Return tables that compare the reference with each other method, and each method with the baseline.

    There is one table for each of the two and each figure: failures, unique violations and weaknesses.
    """
    figures: list[tuple[str, str, Figure]] = [("failures", "failures", _total(None))]
    if all_classified(summaries):
        figures.append(("unique", "unique violations", _unique(None)))
    if all_signed(summaries):
        figures.append(("weaknesses", "weaknesses of the planner", _weaknesses))
    others = [method for method in experiment.methods if method != experiment.compared]
    families = [(experiment.compared, [(experiment.compared, other) for other in others])]
    if experiment.baseline and experiment.baseline != experiment.compared:
        rivals = [method for method in experiment.methods if method != experiment.baseline]
        families.append((experiment.baseline, [(rival, experiment.baseline) for rival in rivals]))
    return [
        _compared(f"{key}-{slug(against).lower()}", f"Number of {words}: {against} compared", experiment, rows)
        for against, pairs in families
        for key, words, figure in figures
        if (rows := _samples(experiment, summaries, pairs, figure))
    ]


Sample = tuple[str, str, str, str, list[float], list[float]]


def _samples(
    experiment: Experiment, summaries: Sequence[Summary], pairs: Sequence[tuple[str, str]], figure: Figure
) -> list[Sample]:
    """Return the samples of each pair of methods, for each environment and ADS in which both have finished campaigns.

    A sample is the environment, the ADS, the names of both methods, and the values of a figure in their campaigns.
    """

    def values(env: str, ads: str, method: str) -> list[float]:
        return [figure(summary) for summary in _of(summaries, (env, ads, method))]

    found = [
        (env, ads, one, other, values(env, ads, one), values(env, ads, other))
        for env, ads in _places(experiment)
        for one, other in pairs
    ]
    return [sample for sample in found if sample[4] and sample[5]]


def _compared(name: str, title: str, experiment: Experiment, samples: Sequence[Sample]) -> Table:
    """Return a table of comparisons, which form one family for the correction."""
    found = compare([(first, second) for *_, first, second in samples])
    rows: list[tuple[Value, ...]] = [
        (*_place(experiment, env, ads), one, other, *c.n, *c.means, c.effect, _p(c.p), _p(c.corrected), c.verdict)
        for (env, ads, one, other, _, _), c in zip(samples, found, strict=True)
    ]
    places = [sample[:2] for sample in samples]
    blocks = tuple(places.count(place) for place in dict.fromkeys(places))
    heads = (*_place_columns(experiment), Column("Method"), Column("Against"), Column("n"), Column("m"))
    heads += (Column("Mean"), Column("Mean against"), Column("A12", digits=2), Column("p"), Column("p Holm"))
    heads += (Column("Verdict"),)
    notes = [
        "Question: does the method find more than the one that it is compared with, beyond chance?",
        f"Two-sided Mann-Whitney U test with Holm's correction for {len(found)} comparisons, level {LEVEL:g}.",
        "A12: probability that a campaign of the method finds more than one of the other method; 0.5: no difference.",
    ]
    least = min(least_p(*c.n) for c in found) * len(found)
    if least >= LEVEL:
        notes.append(f"So few seeds cannot be significant here: the least corrected p is {_p(min(1.0, least))}.")
    return Table(name, title, (*heads,), tuple(rows), blocks, tuple(notes))


def _p(value: float) -> str:
    return "<0.001" if value < 0.001 else f"{value:.3f}"


def _total(label: str | None) -> Figure:
    return lambda summary: summary.total(label)


def _unique(label: str | None) -> Figure:
    return lambda summary: len(summary.kinds(label))


def _weaknesses(summary: Summary) -> int:
    return len(summary.weaknesses())


def _mean(found: Sequence[Summary], figure: Figure) -> Estimate:
    return estimate([figure(summary) for summary in found])


def _labels(summaries: Sequence[Summary]) -> list[str]:
    """Return the labels of all specs, with "error" only if there were errors."""
    seen = {failure.label for summary in summaries for failure in summary.failures}
    return [label for label in all_labels(summaries) if label != LABELS[ERROR] or label in seen]


def _of(summaries: Sequence[Summary], group: Group) -> list[Summary]:
    return [summary for summary in summaries if (summary.env, summary.ads, summary.method) == group]


def _places(experiment: Experiment) -> list[tuple[str, str]]:
    return [(env, ads) for env in experiment.envs for ads in experiment.ads]


def _place(experiment: Experiment, env: str, ads: str) -> tuple[str, ...]:
    """Return the first cells of a row: the environment, and the ADS if the experiment has several."""
    return (env, ads) if len(experiment.ads) > 1 else (env,)


def _place_columns(experiment: Experiment) -> tuple[Column, ...]:
    return (Column("Scenario"), Column("ADS")) if len(experiment.ads) > 1 else (Column("Scenario"),)
