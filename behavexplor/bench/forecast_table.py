"""Tables that compare forecasts of the classes that are left to find with the classes that were found later."""

from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

from behavexplor.bench.experiment import Experiment
from behavexplor.bench.statistics import estimate
from behavexplor.bench.summaries import Summary
from behavexplor.bench.table import Column, Table, Value, of_group, place_cells, place_columns
from behavexplor.judge.discovery import Discovery

EARLY: Final = 0.1  # share of a campaign before its forecast
NEXT: Final = 0.1  # number of executions in which new classes are counted, as a share of those before the forecast
LEAST: Final = 50  # fewer executions tell nothing about the classes that are left

_COLUMNS = ("Method", "n", "After", "Classes", "Chance %", "Then new %", "Total, forecast", "Total, found", "Within")
_MEANING = (
    "Chance %: forecast probability that the next execution shows a new class (Good-Turing). Then new %: new classes "
    "in the executions that followed, a tenth as many as before, in per cent of these executions.",
    "Within: number of forecasts whose 95 % interval contains the total found. Chao1 is a lower bound on average.",
)


class Forecast(NamedTuple):
    """A forecast and what came of it.

    Attributes:
        early: estimates when the forecast was made.
        new: new classes in the following executions, as a share of these executions.
        total: number of classes that were found in the end.
    """

    early: Discovery
    new: float
    total: int

    @property
    def holds(self) -> bool:
        """True if the interval of the forecast contains the total."""
        return self.early.unseen_low <= self.total - self.early.found <= self.early.unseen_high


def forecasts(experiment: Experiment, summaries: Sequence[Summary]) -> Table | None:
    """Return the table of forecasts after a tenth of each campaign; None if all campaigns are too short."""
    notes = (
        "Question: can the estimates of what is left to find be trusted?",
        f"After: number of executions, {EARLY:.0%} of a campaign. Classes: those found until then. Total: forecast of "
        "all classes that there are (Chao1), and number found by the whole campaign.",
        *_MEANING,
        "The estimates are for independent executions, as uniform sampling makes them.",
    )
    table = Table("forecasts", "Forecasts of classes after a tenth of a campaign", (), (), (), notes)
    return _filled(table, experiment, summaries, lambda found: list(map(_within, found)))


def pooled_forecasts(experiment: Experiment, summaries: Sequence[Summary]) -> Table | None:
    """Return the table of forecasts after each whole campaign, by what all campaigns of its method found together."""
    notes = (
        "Question: do the estimates of one campaign foretell what all campaigns find together?",
        "After: number of executions of a campaign. Classes: those found in it. Total: forecast of all classes that "
        "there are (Chao1), and number found by the n campaigns of the method together.",
        *_MEANING,
        "Only for uniform sampling are further campaigns the same as further executions of one campaign. A guided "
        "search begins anew in each.",
    )
    table = Table("forecasts-pooled", "Forecasts of classes after a campaign, and all campaigns", (), (), (), notes)
    return _filled(table, experiment, summaries, _across)


def _within(summary: Summary) -> Forecast:
    """Return the forecast after a tenth of a campaign."""
    early = summary.first(round(EARLY * summary.executions)).discovery
    more = _following(early)
    new = len(summary.kinds(before=early.executions + more)) - early.found
    return Forecast(early, new / more, len(summary.kinds()))


def _across(found: Sequence[Summary]) -> list[Forecast]:
    """Return the forecast after each of several campaigns. The next campaign has the executions that follow."""
    total = len(frozenset[str]().union(*(summary.kinds() for summary in found)))
    made = []
    for summary, following in zip(found, [*found[1:], *found[:1]], strict=True):
        more = _following(summary.discovery)
        new = following.kinds(before=more) - summary.kinds()
        made.append(Forecast(summary.discovery, len(new) / more, total))
    return made if len(found) > 1 else []


def _following(early: Discovery) -> int:
    return max(round(NEXT * early.executions), 1)


def _filled(
    table: Table,
    experiment: Experiment,
    summaries: Sequence[Summary],
    foretell: Callable[[Sequence[Summary]], list[Forecast]],
) -> Table | None:
    """Return the table with a row for each method in each environment; None if it would be empty."""
    rows: list[tuple[Value, ...]] = []
    blocks = []
    for env, ads in experiment.places:
        block: list[tuple[Value, ...]] = []
        for method in experiment.methods:
            found = [one for one in foretell(of_group(summaries, (env, ads, method))) if one.early.executions >= LEAST]
            if found:
                block.append((*place_cells(experiment, env, ads), method, *_cells(found)))
        rows += block
        blocks.append(len(block))
    if not rows:
        return None
    heads = (*place_columns(experiment), *map(Column, _COLUMNS))
    return Table(table.name, table.title, heads, tuple(rows), tuple(filter(None, blocks)), table.notes)


def _cells(found: Sequence[Forecast]) -> tuple[Value, ...]:
    early = [one.early for one in found]
    return (
        len(found),
        estimate([one.executions for one in early]),
        estimate([one.found for one in early]),
        estimate([100 * one.new_chance for one in early]),
        estimate([100 * one.new for one in found]),
        estimate([one.found + one.unseen for one in early]),
        estimate([one.total for one in found]),
        sum(one.holds for one in found),
    )
