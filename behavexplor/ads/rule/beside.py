"""Lanes beside the ego's route: where on them a vehicle is too far from the ego's path to be in its way."""

import math
from typing import Final, NamedTuple

import numpy as np

from behavexplor.ads.road.lane_arrays import COS, CURVATURE, LENGTH, SIN, pose_on_lane
from behavexplor.ads.road.path import Path, is_straight, locate_on_path, project_on_path
from behavexplor.ads.rule.control import LateralProfile, offset_at
from behavexplor.data.array_types import Bools, Floats
from behavexplor.jit import kernel_in_place, kernel_inner

PARALLEL: Final = 1e-6  # sine of the angle to the route below which a box is parallel to it
SLACK: Final = 1.0  # lateral distance by which a profile may overshoot its offsets [m]
LEAST, GREATEST = 0, 1  # offsets from the route within a meter of a lane [m]
SKEW = 2  # greatest sine of the angle to the route there; 1 on curves and beside them
BEYOND: Final = 130  # length for which lanes are continued beyond their ends [m]
AROUND: Final = 15.0  # half the longest vehicle's length and width, with some margin [m]


class Box(NamedTuple):
    """An oriented box."""

    x: float  # position of the center [m]
    y: float  # position of the center [m]
    cos: float  # cosine of the heading
    sin: float  # sine of the heading
    length: float  # length along the heading [m]
    width: float  # width across the heading [m]


@kernel_inner
def box_on_path(path: Path, profile: LateralProfile, box: Box, strip: float) -> tuple[float, float]:
    """Return the stations between which a box reaches into the strip along the path; (inf, -inf) if never.

    The profile is the path's offset from the route, and `strip` is half the width of the strip [m].
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


def beside_route(path: Path, lanes: Floats, near: Bools) -> Floats:
    """Compute where each meter of each lane is on the ego's route: the columns above, shape (lanes, meters, 3).

    The last lane can be anywhere. Lanes that are not `near` cannot be in the ego's way; offsets are infinite there.
    """
    table = np.empty((len(lanes), int(lanes[:, LENGTH].max()) + BEYOND, 3))
    _fill(path, lanes, table)
    table[~near, :, LEAST] = math.inf
    table[-1] = -math.inf, math.inf, 1.0
    return table


@kernel_in_place
def _fill(path: Path, lanes: Floats, table: Floats) -> None:
    for lane in range(len(lanes) - 1):
        last, last_skew = _offset(path, lanes, lane, 0.0)
        for meter in range(table.shape[1]):
            first, first_skew = last, last_skew
            last, last_skew = _offset(path, lanes, lane, meter + 1.0)
            skew = max(first_skew, last_skew)
            between = 0.5 if skew == 1.0 else 0.0  # an offset changes by a meter in each meter at most
            row = table[lane, meter]
            row[LEAST], row[GREATEST], row[SKEW] = min(first, last) - between, max(first, last) + between, skew


@kernel_inner
def _offset(path: Path, lanes: Floats, lane: int, station: float) -> tuple[float, float]:
    """Return the offset of a station of a lane from the route [m], and the sine of the angle there, 1 on curves."""
    x, y, _ = pose_on_lane(lanes, lane, station)
    nearest, there, offset = locate_on_path(path, x, y)
    if lanes[lane, CURVATURE] != 0.0 or not is_straight(path, nearest, there - AROUND, there + AROUND):
        return offset, 1.0
    along, across = path.lanes[nearest, COS], path.lanes[nearest, SIN]
    return offset, abs(lanes[lane, SIN] * along - lanes[lane, COS] * across)


@kernel_inner
def is_beside(place: Floats, profile: LateralProfile, length: float, width: float, strip: float) -> bool:
    """Return whether a vehicle at a place of `beside_route`, shape (3,), is surely beside the strip along the path."""
    reach = strip + (length * place[SKEW] + width) / 2 + (SLACK if profile.length > 0.0 else 0.0)
    away = max(place[LEAST] - max(profile.first, profile.last), min(profile.first, profile.last) - place[GREATEST])
    return bool(away > reach and (length + width) / 2 < AROUND)
