"""Kinds of configuration values, with their descriptions for error messages."""

from collections.abc import Callable, Mapping
from numbers import Integral, Real
from typing import Any, NamedTuple

import numpy as np

from behavexplor.errors import InputError

MOST = 10_000  # limit of every count, size, frequency [Hz] and time [s]
LARGEST = 1e9  # limit of every other number, so that none can become infinite


class Kind(NamedTuple):
    """A kind of configuration value.

    Attributes:
        wanted: description of the kind, as the end of the message "expected ...".
        accepts: function that returns whether a value is of this kind.
    """

    wanted: str
    accepts: Callable[[Any], bool]


def check_value(name: str, value: object, kind: Kind) -> None:
    """Check that a value is of a kind.

    Raises:
        InputError: if it is not; the message names the key and the expected kind.
    """
    if not kind.accepts(value):
        raise InputError(f"{name}: expected {kind.wanted}, got {shown(value)}")


def shown(value: object) -> str:
    """Return a value as a short text for an error message."""
    return " ".join(repr(value).split())[:80]


def _is_number(value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, Real):
        return False
    try:
        return abs(float(value)) <= LARGEST
    except OverflowError:  # an int beyond all floats
        return False


def _numbers(value: object) -> list[float] | None:
    """Return the elements of a list or tuple of numbers, or None if the value is something else."""
    if isinstance(value, list | tuple) and all(_is_number(number) for number in value):
        return [float(number) for number in value]
    return None


def _has_numbers(value: object, count: int) -> bool:
    return len(_numbers(value) or []) == count


def _is_whole(value: object, least: int) -> bool:
    return not isinstance(value, bool) and isinstance(value, Integral) and least <= int(value) <= MOST


def _is_range(value: object) -> bool:
    numbers = _numbers(value) or []
    return len(numbers) == 2 and numbers[0] < numbers[1]


def _is_even(value: object) -> bool:
    numbers = _numbers(value.tolist() if isinstance(value, np.ndarray) else value) or []
    steps = np.diff(numbers)
    return len(numbers) >= 2 and steps[0] > 0 and np.allclose(steps, steps[0])


def _is_pair_of(kind: Kind, value: object) -> bool:
    return isinstance(value, list | tuple) and len(value) == 2 and all(map(kind.accepts, value))


def optional(kind: Kind) -> Kind:
    """Return the kind that also accepts None."""
    return Kind(f"{kind.wanted}, or None", lambda value: value is None or kind.accepts(value))


def names(known: tuple[str, ...]) -> Kind:
    """Return the kind of non-empty lists of known names."""

    def accepts(value: object) -> bool:
        return isinstance(value, list | tuple) and len(value) > 0 and all(name in known for name in value)

    return Kind(f"a list of names among {', '.join(known)}", accepts)


def one_of(known: tuple[str, ...]) -> Kind:
    """Return the kind of single known names."""
    return Kind(f"one of {', '.join(known)}", lambda value: isinstance(value, str) and value in known)


NUMBER = Kind(f"a number of at most {LARGEST:g}", _is_number)
POSITIVE = Kind(f"a number above 0 and up to {MOST}", lambda value: _is_number(value) and 0 < value <= MOST)
NOT_NEGATIVE = Kind(f"a number from 0 to {MOST}", lambda value: _is_number(value) and 0 <= value <= MOST)
WHOLE = Kind(f"a whole number from 0 to {MOST}", lambda value: _is_whole(value, 0))
COUNT = Kind(f"a whole number from 1 to {MOST}", lambda value: _is_whole(value, 1))
FLAG = Kind("True or False", lambda value: isinstance(value, bool | np.bool_))
RANGE = Kind("two numbers, the lower first", _is_range)
TWO_NUMBERS = Kind("two numbers", lambda value: _has_numbers(value, 2))
THREE_NUMBERS = Kind("three numbers", lambda value: _has_numbers(value, 3))
TWO_POSITIVE = Kind("two numbers above 0", lambda value: _is_pair_of(POSITIVE, value))
TWO_RANGES = Kind("two pairs of numbers, the lower first in each", lambda value: _is_pair_of(RANGE, value))
IMAGE_SHAPE = Kind("a tuple of two whole numbers", lambda value: isinstance(value, tuple) and _is_pair_of(COUNT, value))
EVEN_NUMBERS = Kind("at least two numbers in even steps upwards", _is_even)
NUMBER_RANGES = Kind(
    "a pair of numbers for each name, the lower first",
    lambda value: isinstance(value, Mapping) and all(map(RANGE.accepts, value.values())),
)
