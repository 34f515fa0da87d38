"""A table of an experiment as values, and what the makers of tables share."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from behavexplor.bench.experiment import Experiment
from behavexplor.bench.statistics import Estimate, estimate
from behavexplor.bench.summaries import Summary

Value = str | int | float | Estimate | None
Figure = Callable[[Summary], float]
Group = tuple[str, str, str]  # environment, ADS, method


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


def of_group(summaries: Sequence[Summary], group: Group) -> list[Summary]:
    """Return the summaries of a method in an environment with an ADS."""
    return [summary for summary in summaries if (summary.env, summary.ads, summary.method) == group]


def place_cells(experiment: Experiment, env: str, ads: str) -> tuple[str, ...]:
    """Return the first cells of a row: the environment, and the ADS if an environment has several."""
    return (env, ads) if experiment.has_several_ads else (env,)


def place_columns(experiment: Experiment) -> tuple[Column, ...]:
    """Return the columns of `place_cells`."""
    return (Column("Scenario"), Column("ADS")) if experiment.has_several_ads else (Column("Scenario"),)


def mean(found: Sequence[Summary], figure: Figure) -> Estimate:
    """Return the mean of a figure over campaigns."""
    return estimate([figure(summary) for summary in found])


def p_text(value: float) -> str:
    """Return a p-value as text."""
    return "<0.001" if value < 0.001 else f"{value:.3f}"


def total(label: str | None) -> Figure:
    """Return the figure that counts the failures with a label; None for all failures."""
    return lambda summary: summary.total(label)


def unique(label: str | None) -> Figure:
    """Return the figure that counts the classes of the failures with a label; None for all failures."""
    return lambda summary: len(summary.kinds(label))


def n_at_fault(summary: Summary) -> int:
    """Return the number of failures for which the ADS was at fault."""
    return summary.at_fault()


def n_kinds_at_fault(summary: Summary) -> int:
    """Return the number of classes of failures for which the ADS was at fault."""
    return len(summary.kinds_at_fault())


def n_weaknesses(summary: Summary) -> int:
    """Return the number of weaknesses that a campaign found."""
    return len(summary.weaknesses())
