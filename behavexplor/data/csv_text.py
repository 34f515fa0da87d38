"""Tables as CSV, which people open in spreadsheets."""

import csv
import io
from collections.abc import Iterable
from typing import Final

from behavexplor.errors import printable

_FORMULA: Final = ("=", "+", "-", "@", "\t")  # a spreadsheet computes a text that begins so


def csv_text(rows: Iterable[Iterable[object]]) -> str:
    """Return rows of texts and numbers as CSV. Texts are made printable, and formulas get an apostrophe in front."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    for row in rows:
        writer.writerow([_inert(cell) if isinstance(cell, str) else cell for cell in row])
    return text.getvalue()


def _inert(cell: str) -> str:
    return f"'{printable(cell)}" if cell.startswith(_FORMULA) else printable(cell)
