"""The colors of the pages' style sheet, for pictures."""

import re
from collections.abc import Mapping
from functools import cache

from behavexplor.data.vehicle_sizes import VEHICLE_SIZES
from behavexplor.report.rendering import source

Color = tuple[int, int, int]

_VARIABLE = re.compile(r"--(\w+): (?:light-dark\()?#([0-9a-f]{6})")


@cache
def page_colors() -> Mapping[str, Color]:
    """Return the colors of the style sheet's variables, as they are on light pages."""
    return {name: _rgb(value) for name, value in _VARIABLE.findall(source("page.css"))}


def type_color(name: str) -> int:
    """Return the number of a vehicle type's color, v0 to v5; the last one is that of all other types."""
    return list(VEHICLE_SIZES).index(name) if name in VEHICLE_SIZES else len(VEHICLE_SIZES)


def _rgb(value: str) -> Color:
    red, green, blue = bytes.fromhex(value)
    return red, green, blue
