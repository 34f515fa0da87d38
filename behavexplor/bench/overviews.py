"""Tables with a row for each method: overviews with a column for each scenario, mutations, correlations, forecasts."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from operator import attrgetter
from typing import Final, NamedTuple

from behavexplor.bench.comparisons import EqualTime, compared_figures, families, samples
from behavexplor.bench.experiment import Experiment, slug
from behavexplor.bench.statistics import LEVEL, SampleComparison, compare, estimate
from behavexplor.bench.summaries import Summary, correlation
from behavexplor.bench.table import (
    Column,
    Figure,
    Table,
    Value,
    mean,
    novelty,
    of_group,
    p_text,
    place_cells,
    table_by_method,
)
from behavexplor.judge.discovery import Discovery

Pair = tuple[str, str, str, str]  # environment, ADS, and two methods
FORECAST_AFTER: Final = 0.1  # share of a campaign before its forecast
FORECAST_SPAN: Final = 0.1  # executions in which new classes are counted, as a share of those before the forecast
FORECAST_LEAST: Final = 50  # executions before a forecast; fewer tell nothing about the classes that are left
_FORECAST_COLUMNS = tuple(
    map(Column, ("n", "After", "Classes", "Chance %", "Then new %", "Total, forecast", "Total, found", "Within"))
)
_FORECAST_NOTES = (
    "Chance %: forecast probability that the next execution shows a new class (Good-Turing). Then new %: new classes "
    "in the executions that followed, a tenth as many as before, in per cent of these executions.",
    "Within: number of forecasts whose 95 % interval contains the total found. Chao1 is a lower bound on average.",
)


def overviews(experiment: Experiment, summaries: Sequence[Summary], cut: EqualTime | None) -> list[Table]:
    """Return the means of each figure in which methods are compared, and the effect sizes; none for one scenario.

    `cut` has the same campaigns in equal time, whose means get tables, too; None if a time was not measured.
    """
    if len(experiment.places) == 1:
        return []
    compared = [(key, f"Number of {words}", figure) for key, words, figure in compared_figures(summaries)]
    others: list[tuple[str, str, Figure]] = [
        ("npc-caused", "Number of collisions that an NPC caused", attrgetter("npc_caused")),
        ("novelty", "Executions with new behavior, in per cent", novelty),
    ]
    means = [_means(*figure, experiment, summaries) for figure in compared + others]
    if cut:
        means += [_in_equal_time(*figure, experiment, cut) for figure in compared]
    named = [family for family in families(experiment) if family[0] in (experiment.compared, experiment.baseline)]
    effects = [_effects(name, title, pairs, experiment, summaries) for name, title, pairs in named]
    return [*means, *effects]


def _scenario_columns(experiment: Experiment, *, best: bool) -> tuple[Column, ...]:
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
    heads = _scenario_columns(experiment, best=True)
    return Table(f"overview-{key}", title, heads, tuple(rows), (len(rows),), notes)


def _in_equal_time(key: str, title: str, figure: Figure, experiment: Experiment, cut: EqualTime) -> Table:
    """Return the table of the means of a figure in equal time."""
    table = _means(f"{key}-equal-time", f"{title}, in equal time", figure, experiment, cut.summaries)
    return replace(table, notes=(*table.notes, *cut.notes))


def _range(counts: set[int]) -> str:
    low, high = min(counts, default=0), max(counts, default=0)
    return str(low) if low == high else f"{low} to {high}"


def _effects(
    name: str, title: str, pairs: Sequence[tuple[str, str]], experiment: Experiment, summaries: Sequence[Summary]
) -> Table:
    """Return the table of the effect sizes of a family of comparisons with one method."""
    figures = compared_figures(summaries)
    found = [_compared(experiment, summaries, pairs, figure) for _, _, figure in figures]
    rows: list[tuple[Value, ...]] = []
    for one, other in pairs:
        cells = [_effect_cell(found, (*place, one, other)) for place in experiment.places]
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
    heads = _scenario_columns(experiment, best=False)
    return Table(f"effects-{slug(name).lower()}", f"Effect sizes: {title}", heads, tuple(rows), (len(rows),), notes)


def _compared(
    experiment: Experiment, summaries: Sequence[Summary], pairs: Sequence[tuple[str, str]], figure: Figure
) -> Mapping[Pair, SampleComparison]:
    """Return the comparisons of a figure, which are corrected as one family."""
    found = samples(experiment, summaries, pairs, figure)
    compared = compare([(first, second) for *_, first, second in found])
    return {sample[:4]: one for sample, one in zip(found, compared, strict=True)}


def _effect_cell(found: Sequence[Mapping[Pair, SampleComparison]], pair: Pair) -> str:
    """Return the effect sizes of all figures as text; empty if the pair was not compared."""
    known = [each[pair] for each in found if pair in each]
    return " / ".join(f"{one.effect:.2f}{'*' if one.corrected < LEVEL else ''}" for one in known)


def mutations(experiment: Experiment, summaries: Sequence[Summary]) -> Table:
    """Return the table of the mixture of mutations, for methods with the paper's mutations."""
    heads = (Column("n"), Column("Waypoint mutations %", interval=True), Column("Assignments", interval=True))
    notes = (
        "Question: which mutations does a method make? (RQ2: an ablation may change the mixture as well)",
        "Waypoint mutations %: share of waypoint mutations among waypoint and route mutations.",
        "Assignments: number of distinct assignments of types and routes to the NPCs. Only route mutations make new "
        "ones.",
    )
    table = Table("mutations", "Mixture of mutations", heads, notes=notes)
    return table_by_method(table, experiment, summaries, _mixture)


def _mixture(campaigns: Sequence[Summary]) -> tuple[Value, ...]:
    """Return the cells on the mutations in some campaigns; none if they have no mutations."""
    found = [summary for summary in campaigns if sum(summary.mutations)]
    if not found:
        return ()
    shares = [100 * summary.mutations[0] / sum(summary.mutations) for summary in found]
    return len(found), estimate(shares, most=100.0), estimate([summary.assignments for summary in found])


def correlations(experiment: Experiment, summaries: Sequence[Summary]) -> Table:
    """Return the table of correlations of violation degree and behavior distance (the paper's r_BF).

    As in the paper, the mutants of all campaigns of a method in a scenario are pooled, with one p-value.
    """
    heads: tuple[Column, ...] = (Column("n"), Column("Mutants"), Column("r_BF", digits=2), Column("p"))
    heads += (Column("of a campaign", digits=2, interval=True), Column("Passed"))
    heads += (Column("r_BF passed", digits=2), Column("p passed"))
    notes = (
        "Question: does new behavior come nearer to a violation?",
        "Pearson's r of the violation degree of a mutant and its distance to the known behaviors, over the mutants of "
        "all n campaigns together, as in the paper; of a campaign: the mean of the campaigns' own correlations.",
        "A lower degree is nearer to a violation, so a negative r means that new behavior came nearer to one.",
        "Passed: over mutants that did not fail. A failing run ends early at a collision or late at a standstill, so "
        "that its length makes it far from other behaviors, and its violation makes its degree low.",
        "The p-values treat mutants as independent. They are not, since one is made from another.",
    )
    table = Table("correlations", "Correlation of violation degree and behavior distance", heads, notes=notes)
    return table_by_method(table, experiment, summaries, _correlated)


def _correlated(found: Sequence[Summary]) -> tuple[Value, ...]:
    """Return the cells on the correlation in some campaigns; none if they have no correlation."""
    mutants = [mutant for summary in found for mutant in summary.mutants]
    pooled, passed = correlation(mutants), correlation(mutants, passed=True)
    own = [one.r for summary in found if (one := correlation(summary.mutants))]
    if pooled is None or not own:
        return ()
    cells: tuple[Value, ...] = (len(own), pooled.n, pooled.r, p_text(pooled.p), estimate(own, least=-1.0, most=1.0))
    return (*cells, *((passed.n, passed.r, p_text(passed.p)) if passed else (None, None, None)))


class Forecast(NamedTuple):
    """A forecast and what came of it."""

    early: Discovery  # estimates when the forecast was made
    new: float  # new classes in the following executions, as a share of these executions
    total: int  # number of classes that were found in the end

    @property
    def holds(self) -> bool:
        """True if the interval of the forecast contains the total."""
        return self.early.unseen_low <= self.total - self.early.found <= self.early.unseen_high


def forecasts(experiment: Experiment, summaries: Sequence[Summary]) -> Table:
    """Return the table of forecasts after a tenth of each campaign, for campaigns that are long enough."""
    notes = (
        "Question: can the estimates of what is left to find be trusted?",
        f"After: number of executions, {FORECAST_AFTER:.0%} of a campaign. Classes: those found until then. Total: "
        "forecast of all classes that there are (Chao1), and number found by the whole campaign.",
        *_FORECAST_NOTES,
        "The estimates are for independent executions, as uniform sampling makes them.",
    )
    table = Table("forecasts", "Forecasts of classes after a tenth of a campaign", _FORECAST_COLUMNS, notes=notes)

    def cells(found: Sequence[Summary]) -> tuple[Value, ...]:
        return _forecast_cells([_after_a_tenth(summary) for summary in found])

    return table_by_method(table, experiment, summaries, cells)


def pooled_forecasts(experiment: Experiment, summaries: Sequence[Summary]) -> Table:
    """Return the table of forecasts after each whole campaign, by what all campaigns of its method found together."""
    notes = (
        "Question: do the estimates of one campaign foretell what all campaigns find together?",
        "After: number of executions of a campaign. Classes: those found in it. Total: forecast of all classes that "
        "there are (Chao1), and number found by the n campaigns of the method together.",
        *_FORECAST_NOTES,
        "Only for uniform sampling are further campaigns the same as further executions of one campaign. A guided "
        "search begins anew in each.",
    )
    title = "Forecasts of classes after a campaign, and all campaigns"
    table = Table("forecasts-pooled", title, _FORECAST_COLUMNS, notes=notes)
    return table_by_method(table, experiment, summaries, lambda found: _forecast_cells(_after_each(found)))


def _after_a_tenth(summary: Summary) -> Forecast:
    """Return the forecast after a tenth of a campaign."""
    early = summary.first(round(FORECAST_AFTER * summary.executions)).discovery
    more = _following(early)
    new = len(summary.kinds(before=early.executions + more)) - early.found
    return Forecast(early, new / more, len(summary.kinds()))


def _after_each(found: Sequence[Summary]) -> list[Forecast]:
    """Return the forecast after each of several campaigns. The next campaign has the executions that follow."""
    total = len(frozenset[str]().union(*(summary.kinds() for summary in found)))
    made = []
    for summary, following in zip(found, [*found[1:], *found[:1]], strict=True):
        more = _following(summary.discovery)
        new = following.kinds(before=more) - summary.kinds()
        made.append(Forecast(summary.discovery, len(new) / more, total))
    return made if len(found) > 1 else []


def _following(early: Discovery) -> int:
    return max(round(FORECAST_SPAN * early.executions), 1)


def _forecast_cells(made: Sequence[Forecast]) -> tuple[Value, ...]:
    """Return the cells on some forecasts; none if all were made too early."""
    found = [one for one in made if one.early.executions >= FORECAST_LEAST]
    if not found:
        return ()
    early = [one.early for one in found]
    return (
        len(found),
        estimate([one.executions for one in early]),
        estimate([one.found for one in early]),
        estimate([100 * one.new_chance for one in early], most=100.0),
        estimate([100 * one.new for one in found], most=100.0),
        estimate([one.found + one.unseen for one in early]),
        estimate([one.total for one in found]),
        sum(one.holds for one in found),
    )
