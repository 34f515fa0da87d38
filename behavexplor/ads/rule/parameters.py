"""Parameters of the rule planner: every number that a user may want to change."""

import math
from collections import namedtuple
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

from behavexplor.ads.road.path import APPROACH_BRAKING, LATERAL_ACCELERATION
from behavexplor.errors import InputError


@dataclass(frozen=True, kw_only=True)
class Parameters:
    """The planner's numbers, all >= 0.

    The first sixteen are the severities of the weaknesses, see `behavexplor.ads.rule.weaknesses`; 0 turns a weakness
    off. Each of the next six narrows the gate of one weakness.

    Attributes:
        occlusion: R1-1, share of a vehicle that may be visible although the vehicle counts as hidden.
        static_speed: R1-2, speed below which NPCs are predicted to stand [m/s].
        restart: R1-3, time for which conflicts are ignored after a stop before one [s].
        weak_braking: R1-4, deceleration missing from full braking [m/s2].
        cut_in: R1-5, share of the needed gaps in the target lane that is not demanded.
        no_abort: R1-6, share of the least gap that may be lost before a lane change is aborted.
        narrow_bus: R1-7, share of a large vehicle's excess over a car that is not seen while it turns.
        branch_turn: R1-8, angle that an NPC must have turned before a branch other than straight on is predicted [rad].
        slow_recovery: R2-1, share of the steering back that is missing at the end of a lane change.
        short_change: R2-2, share of a lane change's length that is missing at low speed.
        wrong_side: R2-3, speed below which leaders are overtaken in the oncoming lane [m/s].
        held_steering: R2-4, time for which the steering of a slow left turn is held [s].
        no_overtaking: R3-1, speed below which moving leaders are never overtaken [m/s].
        no_room: R3-2, share of the room to return from overtaking that is not demanded.
        late_change: R3-3, share of the way to the destination on which a needed lane change is not begun.
        deadlock: R3-4, speed below which NPCs in the ego's way make it wait without end [m/s].
        occlusion_beyond: R1-1, distance beyond which vehicles can count as hidden [m].
        branch_speed: R1-8, speed above which vehicles are expected to go straight on [m/s].
        cut_in_below: R1-5, speed below which the ego takes gaps that are too small [m/s].
        short_change_below: R2-2, speed below which a lane change that begins is too short [m/s].
        no_room_below: R3-2, speed below which the ego overtakes without room to return [m/s].
        deadlock_after: R3-4, time that the ego must have stood before it waits without end [s].
        match_offset: greatest distance of an NPC's center from the center line of a lane that it may be on [m].
        match_heading: greatest angle between an NPC and a lane that it may be on [rad].
        acceleration_memory: time for which an NPC's present acceleration may go on [s].
        side_gap: lateral distance kept from other vehicles [m].
        bumper_gap: distance from vehicles ahead and behind that is never planned to be undercut [m].
        stop_gap: distance kept from vehicles ahead and behind where possible [m].
        crossing_time: time gap kept from vehicles that cross or merge [s].
        crossing_time_growth: growth of `crossing_time` with the time of the prediction [s/s].
        following_time: time gap kept from vehicles ahead on the ego's path [s].
        standoff: distance kept from slow vehicles ahead where a lane allows passing them [m].
        outlook: time over which lanes are compared [s].
        lane_cost: cost of each lane between the ego and its route when lanes are compared [m].
        lane_gain: least advantage of another lane over the present one for a change [m].
        lane_rest: least time between two lane changes that are not needed [s].
        pass_gap: least distance to an overtaken vehicle for the return [m].
        change_time: duration of a change to the next lane [s].
        change_length: least length of a change to the next lane [m].
        gap: least distance from vehicles ahead and behind in the target lane [m].
        gap_ahead_time: growth of that distance with the closing speed of the ego to the vehicle ahead [s].
        gap_behind_time: growth of that distance with the closing speed of the vehicle behind to the ego [s].
        abort_share: share of these needed gaps below which a lane change is aborted.
        abort_time: time to contact below which a lane change is aborted [s].
        creep_after: time of standing after which the ego creeps forward a little [s].
        stop_line_gap: distance between the stop line and the front bumper of the waiting ego [m].
        line_overrun: greatest distance beyond the stop line at which the ego may still wait, out of the way of crossing
            traffic [m].
        firm_braking: deceleration up to which the ego still stops before a junction instead of entering it [m/s2].
        clear_time: time for which a junction must be free before the ego stops yielding [s].
        comfortable_acceleration: acceleration on a free road [m/s2].
        lateral_acceleration: greatest lateral acceleration in curves [m/s2].
        approach_braking: deceleration before curves [m/s2].
        slow_speed: speed below which the ego counts as stopping inside a junction [m/s].
        delay_cost: cost per meter that the ego is behind one that drives at the speed limit.
        acceleration_cost: cost of acceleration per (m/s2)^2 s.
        braking_cost: cost of braking per (m/s2)^2 s.
        jerk_cost: cost per (m/s2)^2 of change between the stages of a plan.
        overspeed_cost: cost per (m/s) s above the speed limit.
        crossing_cost: cost per s within the gap kept from vehicles that cross or merge.
        following_cost: cost per s within the gap kept from vehicles ahead.
        committed_caution: share of `crossing_cost` and `following_cost` that counts when it is too late to wait before
            the junction.
        keep_clear_cost: cost per s of stopping inside a junction.
        look_ahead: least look-ahead distance of the steering [m].
        look_ahead_time: growth of the look-ahead distance with speed [s].
        jerk: greatest rate of change of the acceleration [m/s3].
        emergency_jerk: greatest rate of change of the acceleration in an emergency or beyond firm braking [m/s3].
        steering_rate: greatest rate of change of the steering angle [rad/s].

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
    """Convert the parameters to the named tuple of floats that kernels take."""
    return Numbers(**{field.name: float(getattr(parameters, field.name)) for field in fields(parameters)})
