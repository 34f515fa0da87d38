"""Checks of options, in the words of the user who set them."""

from typing import Final

from behavexplor.errors import InputError, brief

LARGEST: Final = 100_000  # no count, share or distance makes sense beyond it, and many would never end
MAX_POPULATION: Final = 1000  # whose members are compared with one another


def check_range(name: str, value: float, low: float, high: float = LARGEST) -> None:
    """Refuse an option that is out of range.

    Args:
        name: of the option.
        value: what it was set to.
        low: least value allowed.
        high: greatest value allowed.

    Raises:
        InputError: naming the option and the range.
    """
    if not low <= value <= high:
        raise InputError(f"{name}: must be a number from {low:g} to {high:g}, got {brief(value)}")
