"""Every number of the rule planner that a person may want to change."""

import math
from collections import namedtuple
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

from behavexplor.ads.road.path import APPROACH_BRAKING, LATERAL_ACCELERATION
from behavexplor.errors import InputError


@dataclass(frozen=True, kw_only=True)
class Parameters:
    """The planner's numbers, all >= 0.

    The first sixteen are the severities of the weaknesses, see `behavexplor.ads.rule.weaknesses`; 0 is without. The
    six after them make the gate of one narrower.

    Attributes:
        occlusion: R1-1, share of a vehicle that may be in sight although it counts as hidden.
        static_speed: R1-2, NPCs slower than this are predicted to stand [m/s].
        restart: R1-3, for how long conflicts are not looked at after a stop before one [s].
        weak_braking: R1-4, what is missing of full braking [m/s2].
        cut_in: R1-5, share of the gaps in the target lane that is not asked for.
        no_abort: R1-6, share of the least gap that may be lost before a lane change is aborted.
        narrow_bus: R1-7, share of a large vehicle's excess over a car that is not seen while it turns.
        branch_turn: R1-8, how far an NPC must have turned before another branch is predicted than straight on [rad].
        slow_recovery: R2-1, share of the steering back that is missing at the end of a lane change.
        short_change: R2-2, share of a lane change's length that is missing at low speed.
        wrong_side: R2-3, leaders slower than this are overtaken in the lane of the other direction [m/s].
        held_steering: R2-4, how long the steering of a slow left turn is held [s].
        no_overtaking: R3-1, moving leaders slower than this are followed for ever [m/s].
        no_room: R3-2, share of the room for coming back from an overtaking that is not asked for.
        late_change: R3-3, share of the way to the destination on which a needed lane change is not begun.
        deadlock: R3-4, for NPCs in its way slower than this the ego waits for ever [m/s].
        occlusion_beyond: R1-1, only vehicles farther away than this count as hidden [m].
        branch_speed: R1-8, only vehicles faster than this are expected to go straight on [m/s].
        cut_in_below: R1-5, only an ego slower than this takes gaps that are too small [m/s].
        short_change_below: R2-2, only lane changes begun below this speed are too short [m/s].
        no_room_below: R3-2, only an ego slower than this overtakes without room to come back [m/s].
        deadlock_after: R3-4, only an ego that has stood for so long waits for ever [s].
        match_offset: an NPC may be on a lane if its center is this close to the center line [m]
        match_heading: and its heading this close to the lane's [rad].
        acceleration_memory: how long an NPC's present acceleration may go on [s].
        side_gap: distance kept from others to the side [m].
        bumper_gap: distance from others ahead and behind that is never planned to be undercut [m].
        stop_gap: distance kept from others ahead and behind where possible [m],
        crossing_time: and the time kept to those who cross or merge [s],
        crossing_time_growth: growing with how far ahead their motion is predicted [s/s],
        following_time: and the time kept to those ahead on the own path [s].
        standoff: distance kept from slow vehicles ahead where there is a lane to pass them [m].
        outlook: how far ahead lanes are compared [s].
        lane_cost: of every lane that lies between the ego and its route, when lanes are compared [m].
        lane_gain: by which another lane must be better than the present one [m].
        lane_rest: between two lane changes that are not needed [s].
        pass_gap: distance to those overtaken that allows to come back [m].
        change_time: that a change to the next lane takes [s],
        change_length: and its least length [m].
        gap: least distance from others in the target lane, ahead and behind [m],
        gap_ahead_time: more for how fast the ego closes up to those ahead [s],
        gap_behind_time: and for how fast those behind close up to the ego [s].
        abort_share: a lane change is aborted while the gaps are less than this share of those,
        abort_time: or if contact would come sooner than this [s].
        creep_after: an ego that stood for so long creeps forward a little [s].
        stop_line_gap: distance between the stop line and the front bumper of the waiting ego [m].
        line_overrun: how far behind the stop line the ego may still wait, out of the way of crossing traffic [m].
        firm_braking: a junction is still refused if this deceleration stops the ego before it [m/s2].
        clear_time: how long a junction must be free before the ego ends its yielding [s].
        comfortable_acceleration: on a free road [m/s2].
        lateral_acceleration: limit in curves [m/s2].
        approach_braking: deceleration before curves [m/s2].
        slow_speed: below it the ego counts as stopping inside a junction [m/s].
        delay_cost: per meter that the ego is behind one driving at the limit.
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

    occlusion: float = 0.0
    static_speed: float = 0.0
    restart: float = 0.0
    weak_braking: float = 0.0
    cut_in: float = 0.0
    no_abort: float = 0.0
    narrow_bus: float = 0.0
    branch_turn: float = 0.0
    slow_recovery: float = 0.0
    short_change: float = 0.0
    wrong_side: float = 0.0
    held_steering: float = 0.0
    no_overtaking: float = 0.0
    no_room: float = 0.0
    late_change: float = 0.0
    deadlock: float = 0.0
    occlusion_beyond: float = 0.0
    branch_speed: float = 0.0
    cut_in_below: float = 100.0
    short_change_below: float = 6.0
    no_room_below: float = 100.0
    deadlock_after: float = 0.0
    match_offset: float = 1.0
    match_heading: float = 0.35
    acceleration_memory: float = 2.0
    side_gap: float = 0.3
    bumper_gap: float = 0.5
    stop_gap: float = 2.0
    crossing_time: float = 0.6
    crossing_time_growth: float = 0.05
    following_time: float = 1.0
    standoff: float = 7.0
    outlook: float = 8.0
    lane_cost: float = 6.0
    lane_gain: float = 6.0
    lane_rest: float = 1.0
    pass_gap: float = 8.0
    change_time: float = 3.5
    change_length: float = 15.0
    gap: float = 3.0
    gap_ahead_time: float = 1.0
    gap_behind_time: float = 4.0
    abort_share: float = 0.5
    abort_time: float = 3.0
    creep_after: float = 12.0
    stop_line_gap: float = 2.0
    line_overrun: float = 1.5
    firm_braking: float = 4.0
    clear_time: float = 0.3
    comfortable_acceleration: float = 2.0
    lateral_acceleration: float = LATERAL_ACCELERATION
    approach_braking: float = APPROACH_BRAKING
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
