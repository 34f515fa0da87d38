"""The exception for wrong input, which users see as one sentence instead of a traceback; and texts for messages."""

import sys
import traceback
from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path
from typing import Final

LONGEST: Final = 900  # greatest length of a message [characters]


class InputError(ValueError):
    """The user's input cannot be used. The message says what is wrong and how to fix it.

    The message is always a single printable line, even if it quotes the input.
    """

    def __init__(self, message: str) -> None:
        super().__init__(sentence(message))


def sentence(text: str) -> str:
    """Return a text as one line of at most `LONGEST` printable characters."""
    line = " ".join(text.split())[: LONGEST + 1]
    shown = printable(line)
    return shown if len(shown) <= LONGEST else f"{shown[: LONGEST - 4].rstrip()} ..."


def printable(text: str) -> str:
    r"""Return a text for a terminal: each character that is not printable becomes an escape, such as \x1b or \u202e.

    Newlines and tabs stay. Control characters, marks of direction and surrogates do not: they could change what the
    terminal shows, or what it is told to do.
    """
    if text.isprintable():
        return text
    return "".join(char if char.isprintable() or char in "\n\t" else ascii(char)[1:-1] for char in text)


def described(error: BaseException) -> str:
    """Return the type and message of an exception of foreign code. The message may be long, unprintable or missing."""
    try:
        message = str(error)[: LONGEST + 1]
    except Exception:  # its own `__str__` raises
        message = "it has no message"
    shown = printable(f"{_class_name(error):.80}: {message}")
    return shown if len(shown) <= LONGEST else f"{shown[: LONGEST - 4].rstrip()} ..."


def _class_name(value: object) -> str:
    """Return the name of an object's class, even if its metaclass raises an error when it is asked."""
    return str(type.__dict__["__name__"].__get__(type(value)))  # `type(value).__name__` asks the metaclass


def place_of(error: BaseException) -> str:
    """Return the file and line in which code of a user raised an exception, such as " (my_driver.py, line 12)"."""
    frames = traceback.extract_tb(error.__traceback__)
    return f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})" if len(frames) > 1 else ""


def brief(value: object) -> str:
    """Return a value for use in a message: the beginning of its `repr`."""
    try:
        return f"{value!r:.80}"
    except (ValueError, RecursionError):  # an integer with thousands of digits, or deeply nested lists
        return f"a {_class_name(value)} that is too long to be shown"
    except Exception:  # its own `__repr__` raises
        return f"a {_class_name(value)} that cannot be shown"


def missing_library(what: str, library: str | None, extra: str) -> InputError:
    """Return the error for a feature that needs a library of one of this package's extras."""
    in_checkout = (Path(__file__).parents[1] / "constraints.txt").is_file()
    command = f"-c constraints.txt -e '.[{extra}]'" if in_checkout else f"'behavexplor[{extra}]'"
    return InputError(
        f"{what} needs {library}: install the extra {extra!r} with {sys.executable} -m pip install {command}"
    )


def ignored_key(owner: str, key: str, known: Iterable[str]) -> str:
    """Return the warning that highway-env ignores a key of a configuration, with the most similar key that it knows."""
    close = get_close_matches(key, sorted(known), n=1, cutoff=0.8)
    hint = f": did you mean {close[0]!r}?" if close else ""
    return f"{owner} does not have the key {key!r} of the configuration, which highway-env ignores{hint}"


def unknown_name(kind: str, name: str, known: Iterable[str]) -> InputError:
    """Return the error for a name that is not among `known`. It suggests similar names, or else lists all of them."""
    known = sorted(known)
    begun = [other for other in known if len(name) > 2 and other.startswith(name)]
    close = begun or get_close_matches(name, known, n=1)
    hint = f"did you mean {' or '.join(map(repr, close))}?" if close else f"known are {', '.join(known)}."
    return InputError(f"Unknown {kind} {name!r}: {hint}")
