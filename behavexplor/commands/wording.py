"""Numbers, times and lists in words, for all commands."""

import shutil
import textwrap
from collections.abc import Collection
from typing import TextIO

from rich.table import Table as Grid

from behavexplor.api.observers import PlainConsole
from behavexplor.bench.table import Table, marked, shown
from behavexplor.errors import printable

WIDEST = 100  # of a line of text [characters]
_WIDTH = 10_000  # wide enough that no line is broken


def counted(number: int, one: str) -> str:
    """Return a number of things in words, such as "1 class" or "2 classes"."""
    return f"{number} {one}" if number == 1 else f"{number} {one}{'es' if one.endswith('s') else 's'}"


def class_count(number: int) -> str:
    """Return a number of classes in words."""
    return counted(number, "class")


def clock(seconds: float) -> str:
    """Return a time span as 1:02:03 or 2:03."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"


def hanging(first: str, text: str) -> str:
    """Return a text that begins beside a first column, and stays right of it on as many lines as it needs."""
    width = min(shutil.get_terminal_size().columns, WIDEST)
    return textwrap.fill(
        text,
        width,
        initial_indent=first,
        subsequent_indent=" " * len(first),
        break_long_words=False,
        break_on_hyphens=False,
    )


def say(text: str, *, file: TextIO | None = None, end: str = "\n", flush: bool = False) -> None:
    """Print a text, which may quote files of others and messages of drivers, without control characters.

    Args:
        text: the text, of one line or several.
        file: where to print it; None for standard output.
        end: what follows the text.
        flush: whether to print it at once.
    """
    print(printable(text), file=file, end=end, flush=flush)


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
        cells = [f"{shown(row[i], table.columns[i])}{'*' * ((number - 1, i) in best)}" for i in columns]
        lines.add_row(*cells, end_section=number in ends)
        if number in ends:
            lines.add_row()
    return "\n".join([table.title, plain_text(lines), *table.notes])


def grid(*columns: str, numbers: Collection[str] = ()) -> Grid:
    """Return an empty table without lines.

    Args:
        columns: headings of the columns.
        numbers: headings of those whose cells are aligned to the right.
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
