"""Control: profiles that keep or change the lane, and steering and acceleration with limited rates of change."""

import math
from typing import Final, NamedTuple

from behavexplor.ads.road.path import Path, point_beside, pose_on_path
from behavexplor.ads.rule.memory import Memory
from behavexplor.ads.rule.parameters import Numbers
from behavexplor.ads.rule.weaknesses import R2_1, R2_4, note
from behavexplor.ads.scene_io import ACCELERATION_RANGE, STEERING_RANGE
from behavexplor.data.array_types import Floats, Ints
from behavexplor.data.scene import EGO, HEADING, LENGTH, SPEED, X, Y
from behavexplor.jit import kernel_inner

PERIOD: Final = 0.1  # time between two decisions [s]
TWO_PI: Final = 2 * math.pi
RECOVERY_SPEED: Final = 4.0  # speed above which steering back is reduced (R2-1) [m/s]
HOLD_SPEED: Final = 4.0  # speed below which steering is held in turns (R2-4) [m/s]
HELD_STEERING: Final = 0.2  # angle beyond which steering is held (R2-4) [rad]
TURN_WAY, TURN = 15.0, 0.1  # a left turn: the route has turned by more than TURN [rad] on the last TURN_WAY [m]


class LateralProfile(NamedTuple):
    """Offset from the route (positive to the right) as a function of the station."""

    start: float  # station where the change begins [m]
    length: float  # length of the change along the route [m], 0 if the last offset is kept from the beginning
    first: float  # offset at the start and before it [m]
    slope: float  # slope of the offset at the start; before the start it is 0
    last: float  # offset at the end and after it [m]


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


@kernel_inner
def steer(
    path: Path, profile: LateralProfile, scene: Floats, station: float, memory: Memory, bits: Ints, p: Numbers
) -> float:
    """Return the steering angle [rad] by pure pursuit: the circle through a point ahead on the path.

    In highway-env's bicycle model, sin(slip) = length / (2 radius) and tan(steering) = 2 tan(slip). The vehicle turns
    about its center, and moves along heading + slip. Solved for the slip, the circle through the point is exact.
    """
    away = p.look_ahead + p.look_ahead_time * scene[EGO, SPEED]
    if memory.sharp == 1.0:  # a short lane change is steered with a short look-ahead (R2-2)
        away *= 1.0 - p.short_change
    there = station + away
    x, y = point_beside(path, there, offset_at(profile, there))
    ahead, aside = x - scene[EGO, X], y - scene[EGO, Y]
    bearing = math.atan2(aside, ahead) - scene[EGO, HEADING]
    share = scene[EGO, LENGTH] / math.hypot(ahead, aside)
    wanted = math.atan(2 * share * math.sin(bearing) / (1 + share * math.cos(bearing)))
    last: float = memory.last_steering
    if p.slow_recovery > 0.0 or p.held_steering > 0.0:
        _, _, here = pose_on_path(path, station)
        _, _, before = pose_on_path(path, station - TURN_WAY)
        turned = (here - before + math.pi) % TWO_PI - math.pi
        wanted = _worsened(profile, scene[EGO, SPEED], turned < -TURN, wanted, memory, bits, p)
    change = p.steering_rate * PERIOD
    wanted = min(max(wanted, last - change), last + change)
    return min(max(wanted, STEERING_RANGE[0]), STEERING_RANGE[1])


@kernel_inner
def _worsened(
    profile: LateralProfile, speed: float, turns: bool, wanted: float, memory: Memory, bits: Ints, p: Numbers
) -> float:
    """Return the steering angle of a planner that steers back too little (R2-1) or holds a large angle (R2-4)."""
    across = profile.last - profile.first
    overtakes = memory.overtaking == 1.0 and profile.length > 0.0
    if p.slow_recovery > 0.0 and overtakes and speed > RECOVERY_SPEED and wanted * across < 0.0:
        note(bits, R2_1, True)
        wanted *= 1.0 - p.slow_recovery
    last: float = memory.last_steering
    large = p.held_steering > 0.0 and turns and last < -HELD_STEERING
    if large and speed < HOLD_SPEED:
        memory.slow_turn = 1.0
    elif not large:
        memory.slow_turn = 0.0
    holds = memory.slow_turn == 1.0
    releases = holds and wanted > last
    memory.held = memory.held + PERIOD if releases else 0.0
    if holds:
        note(bits, R2_4, releases and memory.held <= p.held_steering)
    held: float = last if releases and memory.held <= p.held_steering else wanted
    return held


@kernel_inner
def accelerate(wanted: float, last: float, speed: float, at_once: bool, p: Numbers) -> float:
    """Return the acceleration [m/s2] within the limits of its change and of the vehicle, never into reverse."""
    change = (p.emergency_jerk if at_once else p.jerk) * PERIOD
    wanted = min(max(wanted, last - change), last + change)
    wanted = min(max(wanted, ACCELERATION_RANGE[0]), ACCELERATION_RANGE[1])
    return max(wanted, -speed / PERIOD)
