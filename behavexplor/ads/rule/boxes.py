"""Boxes on the path: the stretch of the ego's path that a vehicle occupies."""

import math
from typing import Final, NamedTuple

from behavexplor.ads.road.lane_arrays import COS, SIN
from behavexplor.ads.road.path import Path, is_straight, locate_on_path, project_on_path
from behavexplor.ads.rule.lateral import LateralProfile, offset_at
from behavexplor.jit import kernel_inner

PARALLEL: Final = 1e-6  # sine of the angle to the route below which a box is parallel to it
SLACK: Final = 1.0  # lateral distance by which a profile may overshoot its offsets [m]


class Box(NamedTuple):
    """An oriented box.

    Attributes:
        x: position of the center [m].
        y: position of the center [m].
        cos: cosine of the heading.
        sin: sine of the heading.
        length: length along the heading [m].
        width: width across the heading [m].
    """

    x: float
    y: float
    cos: float
    sin: float
    length: float
    width: float


@kernel_inner
def box_on_path(path: Path, profile: LateralProfile, box: Box, strip: float) -> tuple[float, float]:
    """Return the stations between which a box reaches into the strip along the path; (inf, -inf) if it does not.

    Args:
        path: path of the ego.
        profile: offset of the planned path from the route.
        box: box of a vehicle.
        strip: half the width of the strip [m].
    """
    x, y, cos, sin, length, width = box
    lane, station, aside = locate_on_path(path, x, y)
    beyond = max(aside - max(profile.first, profile.last), min(profile.first, profile.last) - aside)
    diagonal = (length + width) / 2  # an upper bound of half the diagonal
    if beyond > strip + diagonal + SLACK:
        return math.inf, -math.inf
    straight = is_straight(path, lane, station - diagonal, station + diagonal)
    if straight:  # the box keeps its shape in the route's coordinates
        along, across = path.lanes[lane, COS], path.lanes[lane, SIN]
        cos, sin = cos * along + sin * across, sin * along - cos * across
        if beyond > strip + (length * abs(sin) + width * abs(cos)) / 2 + (SLACK if profile.length > 0.0 else 0.0):
            return math.inf, -math.inf
        if profile.length == 0.0 and abs(sin) < PARALLEL:
            return station - length / 2, station + length / 2
        x, y = station, aside
    low, high = math.inf, -math.inf
    last_s, last_d = _on_path(
        path, profile, x - (length * cos + width * sin) / 2, y - (length * sin - width * cos) / 2, straight
    )
    for front, right in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
        ahead, aside = front * length / 2, right * width / 2
        s, d = _on_path(path, profile, x + ahead * cos - aside * sin, y + ahead * sin + aside * cos, straight)
        if abs(d) <= strip:
            low, high = min(low, s), max(high, s)
        for edge in (-strip, strip):
            if (d - edge) * (last_d - edge) < 0.0:
                crossing = s + (last_s - s) * (edge - d) / (last_d - d)
                low, high = min(low, crossing), max(high, crossing)
        last_s, last_d = s, d
    return low, high


@kernel_inner
def _on_path(path: Path, profile: LateralProfile, x: float, y: float, straight: bool) -> tuple[float, float]:
    """Return the station of a point [m] and its offset from the profile [m].

    If `straight`, x and y are the point's coordinates along and across the route.
    """
    station, aside = (x, y) if straight else project_on_path(path, x, y)
    return station, aside - offset_at(profile, station)
