"""Compact tables with a row for each method and a column for each scenario."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from behavexplor.bench.comparisons import compared_figures, families, samples
from behavexplor.bench.equal_time import EqualTime
from behavexplor.bench.experiment import Experiment, slug
from behavexplor.bench.statistics import LEVEL, Comparison, compare
from behavexplor.bench.summaries import Summary
from behavexplor.bench.table import Column, Figure, Table, Value, mean, of_group, place_cells

Pair = tuple[str, str, str, str]  # environment, ADS, and two methods


def overviews(experiment: Experiment, summaries: Sequence[Summary], cut: EqualTime | None) -> list[Table]:
    """Return the means of each figure in which methods are compared, and the effect sizes; none for one scenario.

    Args:
        experiment: the experiment.
        summaries: summaries of its finished campaigns.
        cut: these campaigns in equal time, whose means get tables, too; None if a time was not measured.
    """
    if len(experiment.places) == 1:
        return []
    compared = [(key, f"Number of {words}", figure) for key, words, figure in compared_figures(summaries)]
    others: list[tuple[str, str, Figure]] = [
        ("npc-caused", "Number of collisions that an NPC caused", _npc_caused),
        ("novelty", "Executions with new behavior, in per cent", _novelty),
    ]
    means = [_means(*figure, experiment, summaries) for figure in compared + others]
    if cut:
        means += [_in_equal_time(*figure, experiment, cut) for figure in compared]
    named = [family for family in families(experiment) if family[0] in (experiment.compared, experiment.baseline)]
    effects = [_effects(name, title, pairs, experiment, summaries) for name, title, pairs in named]
    return [table for table in (*means, *effects) if table.rows]


def _npc_caused(summary: Summary) -> float:
    return summary.npc_caused


def _novelty(summary: Summary) -> float:
    return 100 * summary.novelty_rate


def _columns(experiment: Experiment, *, best: bool) -> tuple[Column, ...]:
    names = [" ".join(place_cells(experiment, *place)) for place in experiment.places]
    return (Column("Method"), *(Column(name, interval=True, best=best) for name in names))


def _means(key: str, title: str, figure: Figure, experiment: Experiment, summaries: Sequence[Summary]) -> Table:
    """Return the table of the means of a figure."""
    rows: list[tuple[Value, ...]] = []
    counts = set()
    for method in experiment.methods:
        found = [of_group(summaries, (*place, method)) for place in experiment.places]
        if any(found):
            rows.append((method, *(mean(group, figure) if group else None for group in found)))
            counts |= set(map(len, found))
    most = "" if all(summary.executions == experiment.budget for summary in summaries) else "at most "
    notes = (
        "Question: how do methods differ in this figure, and does it depend on the scenario?",
        f"Means over {_range(counts)} campaigns of {most}{experiment.budget} executions, with the 95 % interval in "
        "brackets (Student's t).",
    )
    heads = _columns(experiment, best=True)
    return Table(f"overview-{key}", title, heads, tuple(rows), (len(rows),), notes)


def _in_equal_time(key: str, title: str, figure: Figure, experiment: Experiment, cut: EqualTime) -> Table:
    """Return the table of the means of a figure in equal time."""
    table = _means(f"{key}-equal-time", f"{title}, in equal time", figure, experiment, cut.summaries)
    return replace(table, notes=(*table.notes, *cut.notes))


def _range(counts: set[int]) -> str:
    low, high = min(counts, default=0), max(counts, default=0)
    return str(low) if low == high else f"{low} to {high}"


def _effects(
    name: str,
    title: str,
    pairs: Sequence[tuple[str, str]],
    experiment: Experiment,
    summaries: Sequence[Summary],
) -> Table:
    """Return the table of the effect sizes of a family of comparisons with one method."""
    figures = compared_figures(summaries)
    found = [_compared(experiment, summaries, pairs, figure) for _, _, figure in figures]
    rows: list[tuple[Value, ...]] = []
    for one, other in pairs:
        cells = [_cell(found, (*place, one, other)) for place in experiment.places]
        if any(cells):
            rows.append((other if one == name else one, *cells))
    finds = (
        f"{name} finds more than the method" if name == experiment.compared else f"the method finds more than {name}"
    )
    notes = (
        f"Question: how probable is it that a campaign of {finds}? (A12; 0.5 is no difference)",
        f"In this order: {' / '.join(words for _, words, _ in figures)}.",
        f"*: significant at {LEVEL:g} by a two-sided Mann-Whitney U test, with Holm's correction over the comparisons "
        "of the same figure.",
    )
    heads = _columns(experiment, best=False)
    return Table(f"effects-{slug(name).lower()}", f"Effect sizes: {title}", heads, tuple(rows), (len(rows),), notes)


def _compared(
    experiment: Experiment, summaries: Sequence[Summary], pairs: Sequence[tuple[str, str]], figure: Figure
) -> Mapping[Pair, Comparison]:
    """Return the comparisons of a figure, which are corrected as one family."""
    found = samples(experiment, summaries, pairs, figure)
    compared = compare([(first, second) for *_, first, second in found])
    return {sample[:4]: one for sample, one in zip(found, compared, strict=True)}


def _cell(found: Sequence[Mapping[Pair, Comparison]], pair: Pair) -> str:
    """Return the effect sizes of all figures as text; empty if the pair was not compared."""
    known = [each[pair] for each in found if pair in each]
    return " / ".join(f"{one.effect:.2f}{'*' if one.corrected < LEVEL else ''}" for one in known)
