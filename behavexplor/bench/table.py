"""A table of an experiment as values, its text as CSV and Markdown, and what the makers of tables share."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from behavexplor.bench.experiment import Experiment
from behavexplor.bench.statistics import Estimate, estimate
from behavexplor.bench.summaries import Summary
from behavexplor.data.csv_text import csv_text

Value = str | int | float | Estimate | None
Figure = Callable[[Summary], float]
Group = tuple[str, str, str]  # environment, ADS, method
Cells = Callable[[Sequence[Summary]], tuple[Value, ...]]  # makes cells of a row from campaigns; none for no row


@dataclass(frozen=True)
class Column:
    """A column of a table."""

    name: str  # heading of the column
    digits: int = 1  # number of digits after the decimal point
    interval: bool = False  # whether estimates are shown with their intervals. The CSV file always has the intervals.
    best: bool = False  # whether the greatest estimate of each block is marked
    only_csv: bool = False  # whether the column is only in the CSV file, because it is too wide for other formats


@dataclass(frozen=True)
class Table:
    """A table."""

    name: str  # name of its files
    title: str  # title of the table
    columns: tuple[Column, ...]  # columns of the table
    rows: tuple[tuple[Value, ...], ...] = ()  # rows, each with a value for each column
    blocks: tuple[int, ...] = ()  # numbers of rows in consecutive blocks, which are set apart
    notes: tuple[str, ...] = ()  # sentences below the table


def of_group(summaries: Sequence[Summary], group: Group) -> list[Summary]:
    """Return the summaries of a method in an environment with an ADS."""
    return [summary for summary in summaries if (summary.env, summary.ads, summary.method) == group]


def place_cells(experiment: Experiment, env: str, ads: str) -> tuple[str, ...]:
    """Return the first cells of a row: the environment, and the ADS if an environment has several."""
    return (env, ads) if experiment.has_several_ads else (env,)


def place_columns(experiment: Experiment) -> tuple[Column, ...]:
    """Return the columns of `place_cells`."""
    return (Column("Scenario"), Column("ADS")) if experiment.has_several_ads else (Column("Scenario"),)


def table_by_method(
    table: Table, experiment: Experiment, summaries: Sequence[Summary], cells: Cells, methods: Sequence[str] = ()
) -> Table:
    """Return a table with a row for each method in each environment, by default for all methods.

    The given table has the name, title, notes and further columns. `cells` makes the cells in these columns from the
    campaigns of a method in an environment, or returns none if they have no row.
    """
    rows: list[tuple[Value, ...]] = []
    blocks = []
    for place in experiment.places:
        groups = [(method, of_group(summaries, (*place, method))) for method in methods or experiment.methods]
        made = [(method, cells(found)) for method, found in groups if found]
        block = [(*place_cells(experiment, *place), method, *row) for method, row in made if row]
        rows += block
        blocks.append(len(block))
    columns = (*place_columns(experiment), Column("Method"), *table.columns)
    return replace(table, columns=columns, rows=tuple(rows), blocks=tuple(filter(None, blocks)))


def mean(found: Sequence[Summary], figure: Figure) -> Estimate:
    """Return the mean of a figure over campaigns. Of the figures, only `novelty` has a greatest value."""
    most = 100.0 if figure is novelty else math.inf
    return estimate([figure(summary) for summary in found], most=most)


def p_text(value: float) -> str:
    """Return a p-value as text."""
    return "<0.001" if value < 0.001 else f"{value:.3f}"


def total(label: str | None) -> Figure:
    """Return the figure that counts the failures with a label; None for all failures."""
    return lambda summary: summary.total(label)


def unique(label: str | None) -> Figure:
    """Return the figure that counts the classes of the failures with a label; None for all failures."""
    return lambda summary: len(summary.kinds(label))


def novelty(summary: Summary) -> float:
    """Return the share of executions with new behavior, in per cent."""
    return 100 * summary.novelty_rate


def n_weaknesses(summary: Summary) -> int:
    """Return the number of weaknesses that a campaign found."""
    return len(summary.weaknesses())


def shown(value: Value, column: Column) -> str:
    """Return a value as text for display."""
    if isinstance(value, Estimate):
        text = f"{value.mean:.{column.digits}f}"
        if not column.interval or math.isnan(value.low):
            return text
        return f"{text} [{value.low:.{column.digits}f}, {value.high:.{column.digits}f}]"
    if isinstance(value, float):
        return f"{value:.{column.digits}f}"
    return "" if value is None else str(value)


def marked(table: Table) -> set[tuple[int, int]]:
    """Return row and column of the greatest values of each block, for columns in which the greatest is the best.

    Values that equal the greatest after rounding are marked, too. If all values of a block are equal, none is marked.
    """
    found = set()
    for index, column in enumerate(table.columns):
        if not column.best:
            continue
        start = 0
        for length in table.blocks:
            rows = range(start, start + length)
            start += length
            means = {
                row: round(value.mean, column.digits)
                for row in rows
                if isinstance(value := table.rows[row][index], Estimate)
            }
            if len(set(means.values())) > 1:
                found |= {(row, index) for row, rounded in means.items() if rounded == max(means.values())}
    return found


def table_csv(table: Table) -> str:
    """Return a table as CSV. An estimate takes four columns."""
    estimates = [any(isinstance(row[i], Estimate) for row in table.rows) for i in range(len(table.columns))]
    head = []
    for column, is_estimate in zip(table.columns, estimates, strict=True):
        head += [f"{column.name} {part}" for part in ("mean", "low", "high", "n")] if is_estimate else [column.name]
    rows = []
    for row in table.rows:
        cells: list[object] = []
        for value in row:
            cells += _plain(value)
        rows.append(cells)
    return csv_text([head, *rows])


def _plain(value: Value) -> list[object]:
    if isinstance(value, Estimate):
        ends = (value.mean, value.low, value.high)
        return [*("" if math.isnan(end) else round(end, 6) for end in ends), value.n]
    return [round(value, 6) if isinstance(value, float) else "" if value is None else value]


def table_markdown(table: Table) -> str:
    """Return a table in Markdown. The best value of each block is bold, and the notes stand below the table."""
    columns = [i for i, column in enumerate(table.columns) if not column.only_csv]
    best = marked(table)
    lines = [[table.columns[i].name for i in columns], ["---"] * len(columns)]
    for number, row in enumerate(table.rows):
        cells = [shown(row[i], table.columns[i]) for i in columns]
        lines.append([f"**{cell}**" if (number, i) in best else cell for i, cell in zip(columns, cells, strict=True)])
    lines = [[cell.replace("|", r"\|") for cell in line] for line in lines]
    rows = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    return f"**{table.title}**\n\n{rows}\n\n{' '.join(table.notes)}\n"
