"""Kinds of configuration values: types that pydantic checks, with their descriptions for error messages."""

from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, Strict, TypeAdapter, ValidationError

from behavexplor.errors import InputError

MOST = 10_000  # limit of every count, size, frequency [Hz] and time [s]
LARGEST = 1e9  # limit of every other number, so that none can become infinite


class Kind:
    """A kind of configuration value.

    Attributes:
        wanted: description of the kind, as the end of the message "expected ...".
        type: the values of this kind, as a type annotation.
    """

    def __init__(self, wanted: str, type_: Any) -> None:
        self.wanted = wanted
        self.type = type_

    @cached_property
    def _adapter(self) -> TypeAdapter[Any]:
        return TypeAdapter(self.type)

    def check(self, name: str, value: object) -> None:
        """Check that a value is of this kind.

        Raises:
            InputError: if it is not; the message names the key and this kind.
        """
        try:
            self._adapter.validate_python(value)
        except ValidationError:
            raise InputError(f"{name}: expected {self.wanted}, got {shown(value)}") from None


def shown(value: object) -> str:
    """Return a value as a short text for an error message."""
    return " ".join(repr(value).split())[:80]


def _plain(value: object) -> object:
    """Return a value of numpy as a plain value, but for an unsigned number, which wraps around in highway-env."""
    if isinstance(value, np.unsignedinteger) or not isinstance(value, np.generic | np.ndarray):
        return value
    return value.tolist()


def _listed(value: object) -> object:
    """Refuse arrays and sets, which pydantic takes for lists, but highway-env does not."""
    if not isinstance(value, list | tuple):
        raise ValueError  # noqa: TRY004 - pydantic lets a TypeError through
    return value


def _rising(numbers: tuple[float, float]) -> tuple[float, float]:
    if numbers[0] >= numbers[1]:
        raise ValueError
    return numbers


def _even(numbers: list[float]) -> list[float]:
    steps = np.diff(numbers)
    if steps[0] <= 0 or not np.allclose(steps, steps[0]):
        raise ValueError
    return numbers


_FromNumpy = BeforeValidator(_plain)
_Listed = BeforeValidator(_listed)
_Number = Annotated[float, Strict(), Field(ge=-LARGEST, le=LARGEST), _FromNumpy]
_Positive = Annotated[float, Strict(), Field(gt=0, le=MOST), _FromNumpy]
_Count = Annotated[int, Strict(), Field(ge=1, le=MOST), _FromNumpy]
_Range = Annotated[tuple[_Number, _Number], AfterValidator(_rising), _Listed]

NUMBER = Kind(f"a number of at most {LARGEST:g}", _Number)
POSITIVE = Kind(f"a number above 0 and up to {MOST}", _Positive)
NOT_NEGATIVE = Kind(f"a number from 0 to {MOST}", Annotated[float, Strict(), Field(ge=0, le=MOST), _FromNumpy])
WHOLE = Kind(f"a whole number from 0 to {MOST}", Annotated[int, Strict(), Field(ge=0, le=MOST), _FromNumpy])
COUNT = Kind(f"a whole number from 1 to {MOST}", _Count)
FLAG = Kind("True or False", Annotated[bool, Strict(), _FromNumpy])
RANGE = Kind("two numbers, the lower first", _Range)
TWO_NUMBERS = Kind("two numbers", Annotated[tuple[_Number, _Number], _Listed])
THREE_NUMBERS = Kind("three numbers", Annotated[tuple[_Number, _Number, _Number], _Listed])
TWO_POSITIVE = Kind("two numbers above 0", Annotated[tuple[_Positive, _Positive], _Listed])
TWO_RANGES = Kind("two pairs of numbers, the lower first in each", Annotated[tuple[_Range, _Range], _Listed])
IMAGE_SHAPE = Kind("a tuple of two whole numbers", Annotated[tuple[_Count, _Count], Strict()])
EVEN_NUMBERS = Kind(
    "at least two numbers in even steps upwards",
    Annotated[list[_Number], Field(min_length=2), AfterValidator(_even), _FromNumpy],
)
NUMBER_RANGES = Kind("a pair of numbers for each name, the lower first", dict[str, _Range])


def optional(kind: Kind) -> Kind:
    """Return the kind that also accepts None."""
    return Kind(f"{kind.wanted}, or None", kind.type | None)


def one_of(known: tuple[str, ...]) -> Kind:
    """Return the kind of single known names."""
    return Kind(f"one of {', '.join(known)}", Literal.__getitem__(known))


def names(known: tuple[str, ...]) -> Kind:
    """Return the kind of non-empty lists of known names."""
    names: Any = list[one_of(known).type]  # type: ignore[misc]
    return Kind(f"a list of names among {', '.join(known)}", Annotated[names, Field(min_length=1), _Listed])
