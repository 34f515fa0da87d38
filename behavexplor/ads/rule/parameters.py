"""Every number of the rule planner that a person may want to change."""

import math
from collections import namedtuple
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

from behavexplor.errors import InputError


@dataclass(frozen=True, kw_only=True)
class Parameters:
    """The planner's numbers, all >= 0.

    Attributes:
        static_speed: NPCs slower than this are predicted to stand [m/s]; 0 for none (weakness R1-2).
        branch_turn: how far an NPC must have turned before another branch of a junction is predicted than straight on
            [rad]; 0 for all branches at once (weakness R1-8).
        match_offset: an NPC may be on a lane if its centre is this close to the centre line [m]
        match_heading: and its heading this close to the lane's [rad].
        acceleration_memory: how long an NPC's present acceleration may go on [s].
        side_gap: distance kept from others to the side [m].
        bumper_gap: distance from others ahead and behind that is never planned to be undercut [m].
        stop_gap: distance kept from others ahead and behind where possible [m],
        crossing_time: and the time kept to those who cross or merge [s],
        crossing_time_growth: growing with how far ahead their motion is predicted [s/s],
        following_time: and the time kept to those ahead on the own path [s].
        stop_line_gap: distance between the stop line and the front bumper of the waiting ego [m].
        line_overrun: how far behind the stop line the ego may still wait, out of the way of crossing traffic [m].
        firm_braking: a junction is still refused if this deceleration stops the ego before it [m/s2].
        clear_time: how long a junction must be free before the ego ends its yielding [s].
        comfortable_acceleration: on a free road [m/s2].
        lateral_acceleration: limit in curves [m/s2].
        approach_braking: deceleration before curves [m/s2].
        slow_speed: below it the ego counts as stopping inside a junction [m/s].
        delay_cost: per metre that the ego is behind one driving at the limit.
        acceleration_cost: per (m/s2)^2 s.
        braking_cost: per (m/s2)^2 s.
        jerk_cost: per (m/s2)^2 of change between the stages of a plan.
        overspeed_cost: per (m/s) s above the limit.
        crossing_cost: per s in the gap kept to those who cross or merge.
        following_cost: per s in the gap kept to those ahead.
        committed_caution: share of these two that counts when it is too late to wait before the junction.
        keep_clear_cost: per s of stopping inside a junction.
        look_ahead: least look-ahead distance of the steering [m],
        look_ahead_time: and what it grows by with the speed [s].
        jerk: limit of the change of acceleration [m/s3],
        emergency_jerk: and in an emergency or for more than firm braking [m/s3].
        steering_rate: limit of the change of the steering angle [rad/s].

    Raises:
        InputError: if a value is not a finite number >= 0.
    """

    static_speed: float = 0.0
    branch_turn: float = 0.0
    match_offset: float = 1.0
    match_heading: float = 0.35
    acceleration_memory: float = 2.0
    side_gap: float = 0.3
    bumper_gap: float = 0.5
    stop_gap: float = 2.0
    crossing_time: float = 0.6
    crossing_time_growth: float = 0.05
    following_time: float = 1.0
    stop_line_gap: float = 1.0
    line_overrun: float = 1.5
    firm_braking: float = 4.0
    clear_time: float = 0.3
    comfortable_acceleration: float = 2.0
    lateral_acceleration: float = 2.5
    approach_braking: float = 2.0
    slow_speed: float = 2.0
    delay_cost: float = 1.0
    acceleration_cost: float = 0.3
    braking_cost: float = 1.0
    jerk_cost: float = 0.2
    overspeed_cost: float = 20.0
    crossing_cost: float = 100.0
    following_cost: float = 10.0
    committed_caution: float = 0.2
    keep_clear_cost: float = 100.0
    look_ahead: float = 3.0
    look_ahead_time: float = 0.2
    jerk: float = 10.0
    emergency_jerk: float = 80.0
    steering_rate: float = 0.8

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not (isinstance(value, int | float) and 0 <= value < math.inf):
                raise InputError(f"{field.name}: expected a finite number >= 0, got {value!r}")


if TYPE_CHECKING:
    Numbers = Parameters
else:
    Numbers = namedtuple("Numbers", [field.name for field in fields(Parameters)])


def numbers(parameters: Parameters) -> Numbers:
    """The parameters as the named tuple of floats that kernels take."""
    return Numbers(**{field.name: float(getattr(parameters, field.name)) for field in fields(parameters)})
