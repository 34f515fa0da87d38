"""Tables as plain text, for all commands."""

from collections.abc import Collection

from rich.table import Table as Grid

from behavexplor.api.observers import PlainConsole
from behavexplor.bench.table import Table, marked, shown

_WIDTH = 10_000  # wide enough that no line is broken


def text(table: Table) -> str:
    """Return a table as plain text, with a star at the best value of each block."""
    best = marked(table)
    columns = [i for i, column in enumerate(table.columns) if not column.only_csv]
    lines = Grid(box=None, pad_edge=False)
    for i in columns:
        is_text = bool(table.rows) and isinstance(table.rows[0][i], str)
        lines.add_column(table.columns[i].name, justify="left" if is_text else "right", no_wrap=True)
    ends = {sum(table.blocks[: i + 1]) for i in range(len(table.blocks) - 1)}
    for number, row in enumerate(table.rows, 1):
        cells = [f"{shown(row[i], table.columns[i])}{'*' if (number - 1, i) in best else ''}" for i in columns]
        lines.add_row(*cells, end_section=number in ends)
        if number in ends:
            lines.add_row()
    return "\n".join([table.title, plain_text(lines), *table.notes])


def grid(*columns: str, numbers: Collection[str] = ()) -> Grid:
    """Return an empty table without lines.

    The cells of the columns whose headings are in `numbers` are aligned to the right.
    """
    made = Grid(box=None, pad_edge=False)
    for column in columns:
        made.add_column(column, justify="right" if column in numbers else "left", no_wrap=True)
    return made


def plain_text(table: Grid) -> str:
    """Return a table as plain text, in which no line is broken."""
    console = PlainConsole(width=_WIDTH, force_terminal=False, no_color=True)
    with console.capture() as captured:
        console.print(table)
    return "\n".join(line.rstrip() for line in captured.get().splitlines())
