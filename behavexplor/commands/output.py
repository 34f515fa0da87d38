"""What the commands print: the one place from which text reaches a terminal."""

from typing import TextIO

from behavexplor.errors import printable


def say(text: str, *, file: TextIO | None = None, end: str = "\n", flush: bool = False) -> None:
    """Print a text, which may quote files of others and messages of drivers, without control characters.

    Args:
        text: the text, of one line or several.
        file: where to print it; None for standard output.
        end: what follows the text.
        flush: whether to print it at once.
    """
    print(printable(text), file=file, end=end, flush=flush)
