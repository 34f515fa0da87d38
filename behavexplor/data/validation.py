"""Validation of plain values against dataclasses by pydantic, with errors as sentences for the user."""

from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from functools import wraps
from typing import Any, Final, TypeVar, dataclass_transform, get_type_hints

import pydantic
from pydantic import AfterValidator, TypeAdapter, ValidationError, ValidationInfo

from behavexplor.errors import InputError, brief, unknown_name

T = TypeVar("T")

LARGEST: Final = 100_000  # no count, share or distance makes sense beyond it, and many would never end


def between(low: float, high: float = LARGEST) -> AfterValidator:
    """Return an annotation that limits a number to a range, whose ends are allowed."""

    def check(value: float, info: ValidationInfo) -> float:
        if not low <= value <= high:
            raise InputError(f"{info.field_name}: must be a number from {low:g} to {high:g}, got {brief(value)}")
        return value

    return AfterValidator(check)


@dataclass_transform(frozen_default=True)
def validated(kind: type[T]) -> type[T]:
    """Make a class a frozen dataclass whose values are validated when it is made.

    Making one raises an `InputError` that names the first value that is wrong.
    """
    made: Any = pydantic.dataclasses.dataclass(frozen=True)(kind)
    init: Callable[..., None] = made.__init__

    @wraps(init)
    def checked_init(self: Any, *values: Any, **named: Any) -> None:
        try:
            init(self, *values, **named)
        except ValidationError as error:
            raise _sentence(error, made.__name__) from None

    made.__init__ = checked_init
    result: type[T] = made
    return result


def checked(kind: type[T], values: Mapping[str, Any], what: str) -> T:
    """Return an instance of a dataclass made from plain values, none of them unknown or of a wrong type.

    Args:
        kind: the dataclass.
        values: plain values by field.
        what: name of the values for error messages, such as "configuration".

    Raises:
        InputError: naming the first value that is wrong.
    """
    _refuse_unknown(kind, values, what)
    try:
        return TypeAdapter(kind).validate_python(dict(values))
    except ValidationError as error:
        raise _sentence(error, what) from None


def _sentence(error: ValidationError, what: str) -> InputError:
    """Return the first error of a validation as a sentence."""
    first = error.errors(include_url=False)[0]
    cause = first.get("ctx", {}).get("error")
    if isinstance(cause, InputError):
        return cause
    place = ".".join(str(part) for part in first["loc"])
    message = first["msg"].replace("valid tuple", "list")  # as YAML and JSON have it
    return InputError(f"{place} of the {what}: {message}, got {brief(first['input'])}")


def _refuse_unknown(kind: type[Any], values: Mapping[str, Any], what: str) -> None:
    """Refuse a key that is not a field of the dataclass, or of the dataclass that a field holds."""
    kinds = get_type_hints(kind)
    known = [entry.name for entry in fields(kind)]
    for key, value in values.items():
        if key not in known and not known:
            raise InputError(f"Unknown key of the {what} {key!r}: there are none")
        if key not in known:
            raise unknown_name(f"key of the {what}", str(key), known)
        if is_dataclass(kinds[key]) and isinstance(value, Mapping):
            _refuse_unknown(kinds[key], value, f"{key} of the {what}")
