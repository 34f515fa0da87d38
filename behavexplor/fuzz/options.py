"""Validation of search options."""

from typing import Final

from behavexplor.errors import InputError, brief

LARGEST: Final = 100_000  # greatest value of any option: larger counts would take forever
MAX_POPULATION: Final = 1000  # greatest population of a method that compares all pairs of its members


def check_range(name: str, value: float, low: float, high: float = LARGEST) -> None:
    """Check that an option lies in its range.

    Args:
        name: name of the option.
        value: value of the option.
        low: least allowed value.
        high: greatest allowed value.

    Raises:
        InputError: if the value is out of range; the message names the option and the range.
    """
    if not low <= value <= high:
        raise InputError(f"{name}: must be a number from {low:g} to {high:g}, got {brief(value)}")
