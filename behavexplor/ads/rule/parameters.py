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

    Raises:
        InputError: if a value is not a finite number >= 0.
    """

    occlusion: float = 0.0  # R1-1, share of a vehicle that may be visible although the vehicle counts as hidden
    static_speed: float = 0.0  # R1-2, speed below which NPCs are predicted to stand [m/s]
    restart: float = 0.0  # R1-3, time for which conflicts are ignored after a stop before one [s]
    weak_braking: float = 0.0  # R1-4, deceleration missing from full braking [m/s2]
    cut_in: float = 0.0  # R1-5, share of the needed gaps in the target lane that is not demanded
    no_abort: float = 0.0  # R1-6, share of the least gap that may be lost before a lane change is aborted
    narrow_bus: float = 0.0  # R1-7, share of a large vehicle's excess over a car that is not seen while it turns
    # R1-8, angle that an NPC must have turned before a branch other than straight on is predicted [rad]
    branch_turn: float = 0.0
    slow_recovery: float = 0.0  # R2-1, share of the steering back that is missing at the end of a lane change
    short_change: float = 0.0  # R2-2, share of a lane change's length that is missing at low speed
    wrong_side: float = 0.0  # R2-3, speed below which leaders are overtaken in the oncoming lane [m/s]
    held_steering: float = 0.0  # R2-4, time for which the steering of a slow left turn is held [s]
    no_overtaking: float = 0.0  # R3-1, speed below which moving leaders are never overtaken [m/s]
    no_room: float = 0.0  # R3-2, share of the room to return from overtaking that is not demanded
    late_change: float = 0.0  # R3-3, share of the way to the destination on which a needed lane change is not begun
    deadlock: float = 0.0  # R3-4, speed below which NPCs in the ego's way make it wait without end [m/s]
    occlusion_beyond: float = 0.0  # R1-1, distance beyond which vehicles can count as hidden [m]
    branch_speed: float = 0.0  # R1-8, speed above which vehicles are expected to go straight on [m/s]
    cut_in_below: float = 100.0  # R1-5, speed below which the ego takes gaps that are too small [m/s]
    short_change_below: float = 6.0  # R2-2, speed below which a lane change that begins is too short [m/s]
    no_room_below: float = 100.0  # R3-2, speed below which the ego overtakes without room to return [m/s]
    deadlock_after: float = 0.0  # R3-4, time that the ego must have stood before it waits without end [s]
    # greatest distance of an NPC's center from the center line of a lane that it may be on [m]
    match_offset: float = 1.0
    match_heading: float = 0.35  # greatest angle between an NPC and a lane that it may be on [rad]
    acceleration_memory: float = 2.0  # time for which an NPC's present acceleration may go on [s]
    side_gap: float = 0.3  # lateral distance kept from other vehicles [m]
    bumper_gap: float = 0.5  # distance from vehicles ahead and behind that is never planned to be undercut [m]
    stop_gap: float = 2.0  # distance kept from vehicles ahead and behind where possible [m]
    crossing_time: float = 0.6  # time gap kept from vehicles that cross or merge [s]
    crossing_time_growth: float = 0.05  # growth of `crossing_time` with the time of the prediction [s/s]
    following_time: float = 1.0  # time gap kept from vehicles ahead on the ego's path [s]
    standoff: float = 7.0  # distance kept from slow vehicles ahead where a lane allows passing them [m]
    outlook: float = 8.0  # time over which lanes are compared [s]
    lane_cost: float = 6.0  # cost of each lane between the ego and its route when lanes are compared [m]
    lane_gain: float = 6.0  # least advantage of a lane farther from the route over the present one for a change [m]
    lane_rest: float = 1.0  # least time after a lane change before one farther from the route may begin [s]
    pass_gap: float = 8.0  # least distance to an overtaken vehicle for the return [m]
    change_time: float = 3.5  # duration of a change to the next lane [s]
    change_length: float = 15.0  # least length of a change to the next lane [m]
    gap: float = 3.0  # least distance from vehicles ahead and behind in the target lane [m]
    gap_ahead_time: float = 1.0  # growth of that distance with the closing speed of the ego to the vehicle ahead [s]
    gap_behind_time: float = 4.0  # growth of that distance with the closing speed of the vehicle behind to the ego [s]
    abort_share: float = 0.5  # share of these needed gaps below which a lane change is aborted
    abort_time: float = 3.0  # time to contact below which a lane change is aborted [s]
    creep_after: float = 12.0  # time of standing after which the ego creeps forward a little [s]
    stop_line_gap: float = 2.0  # distance between the stop line and the front bumper of the waiting ego [m]
    # greatest distance beyond the stop line at which the ego may still wait, out of the way of crossing traffic [m]
    line_overrun: float = 1.5
    # deceleration up to which the ego still stops before a junction instead of entering it [m/s2]
    firm_braking: float = 4.0
    clear_time: float = 0.3  # time for which a junction must be free before the ego stops yielding [s]
    comfortable_acceleration: float = 2.0  # acceleration on a free road [m/s2]
    lateral_acceleration: float = LATERAL_ACCELERATION  # greatest lateral acceleration in curves [m/s2]
    approach_braking: float = APPROACH_BRAKING  # deceleration before curves [m/s2]
    slow_speed: float = 2.0  # speed below which the ego counts as stopping inside a junction [m/s]
    delay_cost: float = 1.0  # cost per meter that the ego is behind one that drives at the speed limit
    acceleration_cost: float = 0.3  # cost of acceleration up to `comfortable_acceleration`, per (m/s2)^2 s
    braking_cost: float = 1.0  # cost of braking, and of acceleration beyond comfort, per (m/s2)^2 s
    jerk_cost: float = 0.2  # cost per (m/s2)^2 of change between the stages of a plan
    overspeed_cost: float = 20.0  # cost per (m/s) s above the speed limit
    crossing_cost: float = 100.0  # cost per s within the gap kept from vehicles that cross or merge
    following_cost: float = 10.0  # cost per s within the gap kept from vehicles ahead
    # share of `crossing_cost` and `following_cost` that counts when it is too late to wait before the junction
    committed_caution: float = 0.2
    keep_clear_cost: float = 100.0  # cost per s of stopping inside a junction
    look_ahead: float = 3.0  # least look-ahead distance of the steering [m]
    look_ahead_time: float = 0.2  # growth of the look-ahead distance with speed [s]
    jerk: float = 10.0  # greatest rate of change of the acceleration [m/s3]
    # greatest rate of change of the acceleration in an emergency or beyond firm braking [m/s3]
    emergency_jerk: float = 80.0
    steering_rate: float = 0.8  # greatest rate of change of the steering angle [rad/s]

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
