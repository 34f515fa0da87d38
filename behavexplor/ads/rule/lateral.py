"""Lateral motion in Frenet coordinates of the route: keep a lane, or change it along a quintic polynomial."""

import math
from typing import NamedTuple

from behavexplor.jit import kernel_inner


class LateralProfile(NamedTuple):
    """Offset from the route (positive to the right) as a function of the station.

    Attributes:
        start: station where the change begins [m].
        length: length of the change along the route [m], 0 if the last offset is kept from the beginning.
        first: offset at the start and before it [m].
        slope: slope of the offset at the start; before the start it is 0.
        last: offset at the end and after it [m].
    """

    start: float
    length: float
    first: float
    slope: float
    last: float


@kernel_inner
def offset_at(profile: LateralProfile, station: float) -> float:
    """Return the offset at a station [m]: between start and end, a quintic without curvature at its ends."""
    if station >= profile.start + profile.length:
        return profile.last
    if station <= profile.start:
        return profile.first
    u = (station - profile.start) / profile.length
    across, slope = profile.last - profile.first, profile.slope * profile.length
    cubic, quartic, quintic = 10 * across - 6 * slope, 8 * slope - 15 * across, 6 * across - 3 * slope
    return profile.first + u * (slope + u * u * (cubic + u * (quartic + u * quintic)))


@kernel_inner
def change_profile(station: float, offset: float, slope: float, target: float, length: float) -> LateralProfile:
    """Return the profile of a change from the ego's position to another offset."""
    return LateralProfile(station, length, offset, min(max(slope, -0.5), 0.5), target)


@kernel_inner
def keep_profile(offset: float) -> LateralProfile:
    """Return the profile of an offset that is kept."""
    return LateralProfile(-math.inf, 0.0, offset, 0.0, offset)
