"""One decision: locate, choose a lane, plan the speed along it, wait before the junction or go, and command."""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behavexplor.ads.road.path import Path, pose_on_path, project_on_path
from behavexplor.ads.rule.control import PERIOD, accelerate, steer
from behavexplor.ads.rule.decision import (
    CREEP,
    EMERGENCY,
    STANDING,
    YIELD,
    creep,
    decision_code,
)
from behavexplor.ads.rule.lane_choice import (
    ABORT,
    CHANGE,
    KEEP,
    OVERTAKE,
    EgoState,
    accepts_gap,
    change_length,
    choose_lane,
    cuts_in,
    gap_share,
    wrong_side,
)
from behavexplor.ads.rule.lateral import LateralProfile, change_profile, keep_profile
from behavexplor.ads.rule.memory import (
    CLEAR,
    CREEPS,
    DECISION,
    FROM,
    IGNORES,
    LANE,
    LAST_ACCELERATION,
    LAST_STEERING,
    LENGTH,
    MANEUVER,
    ORIGIN,
    OVERRUN,
    OVERTAKING,
    REACHED,
    RESTARTED,
    SHARP,
    SINCE,
    SLOPE,
    START,
    STARTED,
    STOOD,
    SURVIVED,
    TRIGGERED,
    WAITED,
    WEAKENED,
)
from behavexplor.ads.rule.option import Option, Surroundings, plan_option
from behavexplor.ads.rule.station_time import INTERVAL, N_INTERVALS
from behavexplor.ads.rule.traffic import locate
from behavexplor.ads.rule.weaknesses import R1_4, R1_5, R1_6, R2_2, R3_2, R3_3, note
from behavexplor.ads.rule.weaknesses import TRIGGERED as CHANGED
from behavexplor.data.scene import EGO, HEADING, SPEED, WIDTH, X, Y
from behavexplor.data.scene import LENGTH as EGO_LENGTH
from behavexplor.jit import kernel_in_place

Floats = NDArray[np.float64]

HARD_LIMIT: Final = 8.0  # full braking [m/s2]
SUDDEN_TIME: Final = 3.0  # time of weak braking after another vehicle's sudden change of speed (R1-4) [s]
STRONGER: Final = 2.0  # additional acceleration of short lane changes at severity 1 (R2-2) [m/s2]
SHARP_WAY: Final = 20.0  # distance from the start of a short lane change to usual steering and acceleration (R2-2) [m]
STUCK: Final = 1.0  # time of standing in a lane change after which the ego decides anew [s]
CREEP_ACCELERATION: Final = 1.2  # acceleration while creeping [m/s2]


@kernel_in_place
def plan_once(world: Surroundings, memory: Floats) -> None:
    """Make one decision, and leave its commands in the memory."""
    path, scene, bits = world.path, world.scene, world.room.bits
    bits[:] = 0
    station, offset = project_on_path(path, scene[EGO, X], scene[EGO, Y])
    ego = EgoState(station, offset, max(scene[EGO, SPEED], 0.0), scene[EGO, EGO_LENGTH] / 2, scene[EGO, WIDTH] / 2)
    locate(path, scene, world.others)
    _remember(path, ego, memory)
    option = plan_option(world, ego, _present_profile(path, memory), int(memory[LANE]), memory)
    if memory[LENGTH] > 0.0:
        option = _abort_if_needed(world, ego, option, memory)
    else:
        option = _change_if_wanted(world, ego, option, memory)
    _settle(world, ego, option, memory)
    memory[REACHED], memory[TRIGGERED] = bits[0], bits[1]


@kernel_in_place
def _remember(path: Path, ego: EgoState, memory: Floats) -> None:
    """Update the memory with the ego's motion since the last decision."""
    if memory[STARTED] == 0.0:
        memory[STARTED] = 1.0
        memory[LANE] = memory[ORIGIN] = round(ego.offset / path.lane_width)
    memory[SINCE] += PERIOD
    ended = ego.station >= memory[START] + memory[LENGTH]
    if memory[STOOD] > STUCK:  # it may stand in the target lane before the end of the change
        ended = ended or abs(ego.offset - memory[LANE] * path.lane_width) < path.lane_width / 2
    if memory[LENGTH] > 0.0 and ended:
        memory[LENGTH] = memory[SINCE] = memory[IGNORES] = 0.0
        memory[MANEUVER] = KEEP
    if ego.station > memory[START] + SHARP_WAY:
        memory[SHARP] = 0.0
    if memory[LANE] == 0.0 and memory[LENGTH] == 0.0:
        memory[OVERRUN] = memory[OVERTAKING] = 0.0
    memory[STOOD] = memory[STOOD] + PERIOD if ego.speed < STANDING else 0.0
    memory[WAITED] = memory[WAITED] + PERIOD if ego.speed < STANDING and memory[DECISION] == YIELD else 0.0
    memory[RESTARTED] = max(memory[RESTARTED] - PERIOD, 0.0)


@kernel_in_place
def _present_profile(path: Path, memory: Floats) -> LateralProfile:
    last = memory[LANE] * path.lane_width
    if memory[LENGTH] == 0.0:
        return keep_profile(last)
    return LateralProfile(memory[START], memory[LENGTH], memory[FROM], memory[SLOPE], last)


@kernel_in_place
def _is_safe(option: Option) -> bool:
    return option.plan.survived == N_INTERVALS and option.plan.risk == 0.0


@kernel_in_place
def _change_if_wanted(world: Surroundings, ego: EgoState, present: Option, memory: Floats) -> Option:
    """Begin a lane change if another lane is better and its gaps are accepted."""
    path, others, p, bits = world.path, world.others, world.p, world.room.bits
    lane = int(memory[LANE])
    option, begun = present, False
    wrong = wrong_side(path, others, ego, memory, bits, p)
    if wrong != lane:
        option, begun = _try_change(world, ego, present, wrong, memory)
    wanted = lane if begun else choose_lane(path, others, ego, memory, bits, p)
    if bits[CHANGED] & R3_3:
        memory[OVERRUN] = 1.0
    if wanted != lane:
        option, begun = _try_change(world, ego, present, wanted, memory)
    return option


@kernel_in_place
def _try_change(
    world: Surroundings, ego: EgoState, present: Option, wanted: int, memory: Floats
) -> tuple[Option, bool]:
    """Return the change to a lane if it is safe, else the present option; and whether the change is begun."""
    path, p, bits = world.path, world.p, world.room.bits
    lane = int(memory[LANE])
    if not accepts_gap(path, world.others, ego, wanted, bits, p):
        return present, False
    length = change_length(ego.speed, p)
    sharp = p.short_change > 0.0 and ego.speed < p.short_change_below
    if sharp:
        note(bits, R2_2, True)
        length *= 1.0 - p.short_change
    profile = change_profile(ego.station, ego.offset, _slope(world, ego), wanted * path.lane_width, length)
    option = plan_option(world, ego, profile, wanted, memory)
    if not _is_safe(option):
        if not cuts_in(ego, p) or option.plan.survived < N_INTERVALS // 2:
            return plan_option(world, ego, present.profile, lane, memory), False
        note(bits, R1_5, True)
    memory[MANEUVER], memory[ORIGIN] = CHANGE, lane
    if abs(wanted) > abs(lane):
        memory[MANEUVER] = OVERTAKE
        memory[OVERTAKING] = 1.0
        memory[OVERRUN] = 1.0 if bits[CHANGED] & R3_2 else 0.0
    memory[SHARP] = 1.0 if sharp else 0.0
    _adopt(profile, wanted, memory)
    return option, True


@kernel_in_place
def _abort_if_needed(world: Surroundings, ego: EgoState, present: Option, memory: Floats) -> Option:
    """Return to the original lane if a vehicle comes close in the target lane, and returning is possible and helps.

    It is possible while the ego's center is still in the original lane.
    """
    path, p, bits = world.path, world.p, world.room.bits
    lane, origin = int(memory[LANE]), int(memory[ORIGIN])
    inside = abs(ego.offset - origin * path.lane_width) < path.lane_width / 2
    share = gap_share(path, world.others, ego, lane, p)
    alarm = present.plan.survived * INTERVAL < p.abort_time
    if memory[MANEUVER] == ABORT or not inside or not (alarm or share < p.abort_share):
        return present
    if p.no_abort > 0.0:
        goes_on = share >= (1.0 - p.no_abort) * p.abort_share
        note(bits, R1_6, goes_on)
        if goes_on:
            memory[IGNORES] = 1.0
            return present
    length = change_length(ego.speed, p)
    profile = change_profile(ego.station, ego.offset, _slope(world, ego), origin * path.lane_width, length)
    option = plan_option(world, ego, profile, origin, memory)
    if option.plan.survived < present.plan.survived:
        return plan_option(world, ego, present.profile, lane, memory)
    memory[MANEUVER], memory[ORIGIN] = ABORT, memory[LANE]
    _adopt(profile, origin, memory)
    return option


@kernel_in_place
def _slope(world: Surroundings, ego: EgoState) -> float:
    """Return the slope of the ego's motion relative to its route."""
    _, _, along = pose_on_path(world.path, ego.station)
    return math.tan(min(max(math.sin(world.scene[EGO, HEADING] - along), -0.5), 0.5))


@kernel_in_place
def _adopt(profile: LateralProfile, lane: int, memory: Floats) -> None:
    memory[LANE] = lane
    memory[START], memory[LENGTH] = profile.start, profile.length
    memory[FROM], memory[SLOPE] = profile.first, profile.slope


@kernel_in_place
def _settle(world: Surroundings, ego: EgoState, option: Option, memory: Floats) -> None:
    """Store the decision and its commands in the memory."""
    path, p, bits, plan = world.path, world.p, world.room.bits, option.plan
    memory[CLEAR] = memory[CLEAR] + PERIOD if option.crosses else 0.0
    memory[DECISION] = decision_code(path, plan, ego.station, ego.half_length, option.yields)
    memory[SURVIVED] = plan.survived * INTERVAL
    acceleration = plan.acceleration
    if creep(world.room, ego.station, option.limit, memory, bits, p) and memory[DECISION] != EMERGENCY:
        memory[CREEPS] -= PERIOD
        memory[DECISION] = CREEP
        acceleration = CREEP_ACCELERATION
    if p.weak_braking > 0.0:
        memory[WEAKENED] = SUDDEN_TIME if bits[CHANGED] & R1_4 else max(memory[WEAKENED] - PERIOD, 0.0)
        if memory[WEAKENED] > 0.0:
            acceleration = max(acceleration, p.weak_braking - HARD_LIMIT)
    if memory[SHARP] == 1.0 and acceleration > 0.0:
        note(bits, R2_2, True)
        acceleration = p.comfortable_acceleration + STRONGER * p.short_change
    at_once = memory[DECISION] == EMERGENCY or acceleration < -p.firm_braking
    memory[LAST_ACCELERATION] = accelerate(acceleration, memory[LAST_ACCELERATION], ego.speed, at_once, p)
    memory[LAST_STEERING] = steer(path, option.profile, world.scene, ego.station, memory, bits, p)
