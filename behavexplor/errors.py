"""The one exception that means "the input is wrong": a sentence for the user, never a traceback."""

from collections.abc import Iterable
from difflib import get_close_matches
from typing import Final

LONGEST: Final = 900  # characters of a sentence


class InputError(ValueError):
    """Something that the user gave cannot be used; the message says what is wrong and how to mend it.

    It is one line that a terminal can show, whatever of the input it repeats.
    """

    def __init__(self, message: str) -> None:
        super().__init__(sentence(message))


def sentence(text: str) -> str:
    """A text as one line of at most `LONGEST` characters, all of them printable."""
    line = " ".join(text.split())[: LONGEST + 1]
    shown = "".join(char if char.isprintable() else ascii(char)[1:-1] for char in line)
    return shown if len(shown) <= LONGEST else f"{shown[: LONGEST - 4].rstrip()} ..."


def brief(value: object) -> str:
    """A value for a sentence: the beginning of its `repr`."""
    try:
        return f"{value!r:.80}"
    except (ValueError, RecursionError):  # a number of thousands of digits, or lists within lists
        return f"a {type(value).__name__} that is too long to be shown"


def missing_library(what: str, library: str | None, extra: str) -> InputError:
    """The error for something that needs a library of one of this package's extras."""
    command = f"pip install -c constraints.txt -e '.[{extra}]'"
    return InputError(f"{what} needs {library}: install the extra {extra!r}, in a checkout with {command}")


def unknown_name(kind: str, name: str, known: Iterable[str]) -> InputError:
    """The error for a name that is not among `known`: it names the nearest, or else all of them."""
    known = sorted(known)
    begun = [other for other in known if len(name) > 2 and other.startswith(name)]
    close = begun or get_close_matches(name, known, n=1)
    hint = f"did you mean {' or '.join(map(repr, close))}?" if close else f"known are {', '.join(known)}."
    return InputError(f"Unknown {kind} {name!r}: {hint}")
