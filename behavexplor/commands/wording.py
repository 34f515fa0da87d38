"""Numbers, times and texts as all commands print them. Nothing that is slow to import is needed for them."""

import re
import shutil
from typing import TextIO

from behavexplor.errors import printable

WIDEST = 100  # of a line of text [characters]


def counted(number: int, one: str) -> str:
    """Return a number of things in words, such as "1 class" or "2 classes"."""
    return f"{number} {one}" if number == 1 else f"{number} {one}{'es' if one.endswith('s') else 's'}"


def clock(seconds: float) -> str:
    """Return a time span as 1:02:03 or 2:03."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"


def wrapped(text: str) -> str:
    """Return a text on as many lines as it needs."""
    return hanging("", text)


def hanging(first: str, text: str) -> str:
    """Return a text that begins beside a first column, and stays right of it on as many lines as it needs.

    A word that is longer than a line, such as the id of a class, is broken after slashes.
    """
    room = min(shutil.get_terminal_size().columns, WIDEST) - len(first)
    lines = [""]
    for word in text.split():
        space = " " if lines[-1] else ""
        for piece in re.split(r"(?<=/)", word) if len(word) > room else [word]:
            if len(lines[-1] + space + piece) <= room or not lines[-1]:
                lines[-1] += space + piece
            else:
                lines.append(piece)
            space = ""
    return first + f"\n{' ' * len(first)}".join(lines)


def say(text: str, *, file: TextIO | None = None, end: str = "\n", flush: bool = False) -> None:
    """Print a text, which may quote files of others and messages of drivers, without control characters."""
    print(printable(text), file=file, end=end, flush=flush)
