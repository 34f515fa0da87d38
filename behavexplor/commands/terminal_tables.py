"""Tables on a terminal."""

from rich.console import Console
from rich.table import Table as Grid

from behavexplor.bench.table import Table
from behavexplor.bench.writing import marked, shown

_WIDTH = 10_000  # wide enough that no line is broken


def text(table: Table) -> str:
    """Return a table as plain text, with a star at the best value of each block."""
    best = marked(table)
    columns = [i for i, column in enumerate(table.columns) if not column.only_csv]
    grid = Grid(box=None, pad_edge=False)
    for i in columns:
        is_text = bool(table.rows) and isinstance(table.rows[0][i], str)
        grid.add_column(table.columns[i].name, justify="left" if is_text else "right", no_wrap=True)
    ends = {sum(table.blocks[: i + 1]) for i in range(len(table.blocks) - 1)}
    for number, row in enumerate(table.rows, 1):
        cells = [f"{shown(row[i], table.columns[i])}{'*' * ((number - 1, i) in best)}" for i in columns]
        grid.add_row(*cells, end_section=number in ends)
        if number in ends:
            grid.add_row()
    console = Console(width=_WIDTH, highlight=False, no_color=True, markup=False, emoji=False)
    with console.capture() as captured:
        console.print(grid)
    lines = [table.title, *captured.get().splitlines(), *table.notes]
    return "\n".join(line.rstrip() for line in lines)
