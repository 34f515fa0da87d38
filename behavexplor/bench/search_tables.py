"""The tables on what happens in a search: its mutations, and the correlation of degree and distance."""

from collections.abc import Sequence

from behavexplor.bench.experiment import Experiment
from behavexplor.bench.mutants import correlation
from behavexplor.bench.statistics import estimate
from behavexplor.bench.summaries import Summary
from behavexplor.bench.table import Column, Table, Value, of_group, p_text, place_cells, place_columns


def mutations(experiment: Experiment, summaries: Sequence[Summary]) -> Table | None:
    """Return the table of the mixture of mutations, for methods with the paper's mutations; None without any."""
    rows: list[tuple[Value, ...]] = []
    blocks = []
    for env, ads in experiment.places:
        block: list[tuple[Value, ...]] = []
        for method in experiment.methods:
            found = [summary for summary in of_group(summaries, (env, ads, method)) if sum(summary.mutations)]
            if found:
                shares = [100 * summary.mutations[0] / sum(summary.mutations) for summary in found]
                assignments = [summary.assignments for summary in found]
                cells = (len(found), estimate(shares), estimate(assignments))
                block.append((*place_cells(experiment, env, ads), method, *cells))
        rows += block
        blocks.append(len(block))
    if not rows:
        return None
    heads = (*place_columns(experiment), Column("Method"), Column("n"), Column("Waypoint mutations %", interval=True))
    heads += (Column("Assignments", interval=True),)
    notes = (
        "Question: which mutations does a method make? (RQ2: an ablation may change the mixture as well)",
        "Waypoint mutations %: share of waypoint mutations among waypoint and route mutations.",
        "Assignments: number of distinct assignments of types and routes to the NPCs. Only route mutations make new "
        "ones.",
    )
    return Table("mutations", "Mixture of mutations", heads, tuple(rows), tuple(filter(None, blocks)), notes)


def correlations(experiment: Experiment, summaries: Sequence[Summary]) -> Table | None:
    """Return the table of correlations of violation degree and behavior distance (the paper's r_BF); None without any.

    As in the paper, the mutants of all campaigns of a method in a scenario are pooled, with one p-value.
    """
    rows: list[tuple[Value, ...]] = []
    blocks = []
    for env, ads in experiment.places:
        block = [
            (*place_cells(experiment, env, ads), method, *cells)
            for method in experiment.methods
            if (cells := _correlated(of_group(summaries, (env, ads, method))))
        ]
        rows += block
        blocks.append(len(block))
    if not rows:
        return None
    heads = (*place_columns(experiment), *map(Column, ("Method", "n", "Mutants")), Column("r_BF", digits=2))
    heads += (Column("p"), Column("of a campaign", digits=2, interval=True), Column("Passed"))
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
    title = "Correlation of violation degree and behavior distance"
    return Table("correlations", title, heads, tuple(rows), tuple(filter(None, blocks)), notes)


def _correlated(found: Sequence[Summary]) -> tuple[Value, ...]:
    """Return the cells on the correlation in some campaigns; none if they have no correlation."""
    mutants = [mutant for summary in found for mutant in summary.mutants]
    pooled, passed = correlation(mutants), correlation(mutants, passed=True)
    own = [one.r for summary in found if (one := correlation(summary.mutants))]
    if pooled is None or not own:
        return ()
    cells: tuple[Value, ...] = (len(own), pooled.n, pooled.r, p_text(pooled.p), estimate(own))
    return (*cells, *((passed.n, passed.r, p_text(passed.p)) if passed else (None, None, None)))
