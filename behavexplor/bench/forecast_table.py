"""The table that compares the early forecasts of a campaign with what the campaign found later."""

from collections.abc import Sequence
from typing import Final

from behavexplor.bench.experiment import Experiment
from behavexplor.bench.statistics import estimate
from behavexplor.bench.summaries import Summary
from behavexplor.bench.table import Column, Table, Value, of_group, place_cells, place_columns, places

EARLY: Final = 0.1  # share of a campaign after which its estimates are taken
LEAST: Final = 50  # fewer executions tell nothing about the classes that are left


def forecasts(experiment: Experiment, summaries: Sequence[Summary]) -> Table | None:
    """Return the table of forecasts and later findings; None if all campaigns are too short.

    The forecasts are those of `behavexplor.judge.discovery` after a tenth of a campaign.
    """
    rows: list[tuple[Value, ...]] = []
    blocks = []
    for env, ads in places(experiment):
        block = [
            (*place_cells(experiment, env, ads), method, *_cells(found))
            for method in experiment.methods
            if (found := [one for one in of_group(summaries, (env, ads, method)) if _early(one) >= LEAST])
        ]
        rows += block
        blocks.append(len(block))
    if not rows:
        return None
    names = ("Method", "n", "After", "Classes", "Chance %", "Then new %", "Total, forecast", "Total, found", "Within")
    notes = (
        "Question: can the estimates of what is left to find be trusted?",
        f"After: number of executions before the forecast, {EARLY:.0%} of a campaign. Classes: those found by then.",
        "Chance %: forecast probability that the next execution shows a new class (Good-Turing). Then new %: number of "
        "new classes in the executions that followed, a tenth as many as before, as a percentage of these executions.",
        "Total: number of classes found by the whole campaign, and the forecast of all classes that there are (Chao1), "
        "which is a lower bound on average. Within: number of campaigns in which the total found lies in the 95 % "
        "interval of the forecast.",
        "Both forecasts are for independent executions, as uniform sampling makes them.",
    )
    title = "Forecasts of classes, and what came of them"
    heads = (*place_columns(experiment), *map(Column, names))
    return Table("forecasts", title, heads, tuple(rows), tuple(filter(None, blocks)), notes)


def _early(summary: Summary) -> int:
    return round(EARLY * summary.executions)


def _cells(found: Sequence[Summary]) -> tuple[Value, ...]:
    early = [summary.first(_early(summary)).discovery for summary in found]
    following = [max(round(EARLY * one.executions), 1) for one in early]
    new = [
        100 * (len(summary.kinds(before=one.executions + more)) - one.found) / more
        for summary, one, more in zip(found, early, following, strict=True)
    ]
    totals = [len(summary.kinds()) for summary in found]
    within = sum(
        one.unseen_low <= total - one.found <= one.unseen_high for one, total in zip(early, totals, strict=True)
    )
    return (
        len(found),
        estimate([one.executions for one in early]),
        estimate([one.found for one in early]),
        estimate([100 * one.new_chance for one in early]),
        estimate(new),
        estimate([one.found + one.unseen for one in early]),
        estimate(totals),
        within,
    )
