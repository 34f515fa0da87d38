"""Checks of options, in the words of the user who set them."""

import math

from behavexplor.errors import InputError


def check_range(name: str, value: float, low: float, high: float = math.inf) -> None:
    """Refuse an option that is out of range.

    Args:
        name: of the option.
        value: what it was set to.
        low: least value allowed.
        high: greatest value allowed.

    Raises:
        InputError: naming the option and the range.
    """
    if not low <= value <= high or not math.isfinite(value):
        allowed = f"at least {low:g}" if high == math.inf else f"from {low:g} to {high:g}"
        raise InputError(f"{name}: must be a number {allowed}, got {value}")
