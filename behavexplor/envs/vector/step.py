"""Simulate one decision of every ego, from its command to the outcome.

Functions take numbers and single arrays instead of `World` and `Slots`. Those have dozens of fields, and every call
would copy all of them.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behavexplor.data.conventions import is_rear_end
from behavexplor.data.npc_motion import ACCELERATION, HEADING, SPEED, X, Y
from behavexplor.data.trace import ENDS
from behavexplor.data.vehicle_sizes import EGO_SIZE
from behavexplor.envs.vector.contact import RADIUS, boxes_touch, corners, touches_line
from behavexplor.envs.vector.meta import changed_lane, changed_speed, follow_road, steering, throttle
from behavexplor.envs.vector.slots import (
    END,
    FRAME,
    LINE_FRAME,
    MEAN_ACCELERATION,
    N_NPCS,
    PROGRESS,
    REAR_END,
    ROUTE_POSITION,
    RUNNING,
    SPEED_INDEX,
    STANDING,
    STEERING,
    TARGET_LANE,
    TOUCHED,
    VX,
    VY,
    Slots,
    move_npcs,
)
from behavexplor.envs.vector.world import (
    EGO_BEGIN,
    EGO_COS,
    EGO_CURVATURE,
    EGO_LENGTH,
    EGO_SIN,
    EGO_X,
    EGO_Y,
    Rules,
    World,
)
from behavexplor.jit import kernel_in_place, kernel_inner

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

COLLISION, ARRIVED, PASSED, STANDSTILL, TIMEOUT = (
    ENDS.index(end) for end in ("collision", "arrived", "passed", "standstill", "timeout")
)
LENGTH: Final = float(EGO_SIZE[0])  # [m]

_is_rear_end = kernel_inner(is_rear_end)


@kernel_in_place
def step(  # noqa: C901 - one branch more, for the check
    world: World, slots: Slots, actions: Floats, commands: Floats, active: Bools, ends: Bools
) -> int:
    """Simulate until the next decision, or until an episode ends. Return the number of episodes that have ended now.

    If the record of an episode has no room for another decision, nothing is changed, and -1 is returned.

    Args:
        world: the environment's map and rules.
        slots: the slots, changed in place.
        actions: the actions, which are only recorded, shape (B, A).
        commands: acceleration [m/s2] and steering [rad], shape (B, 2). For meta-actions, the first column is the code
            of the maneuver.
        active: whether each slot is stepped, shape (B,).
        ends: whether each episode is terminated, and whether it is truncated, shape (2, B); all False at first.
    """
    if not _have_room(world, slots, actions, active):
        return -1
    ended = 0
    rules, ego, numbers, record = world.rules, slots.ego, slots.numbers, slots.record
    for b in range(len(active)):
        if not active[b]:
            _note_end(world.terminal, numbers[b, END], b, ends)
            continue
        x, y, heading, speed = ego[b, X], ego[b, Y], ego[b, HEADING], ego[b, SPEED]
        acceleration, angle = commands[b, 0], commands[b, 1]
        lane, position, index = numbers[b, TARGET_LANE], numbers[b, ROUTE_POSITION], numbers[b, SPEED_INDEX]
        if world.is_meta:
            maneuver = int(commands[b, 0])
            index = changed_speed(world.target_speeds, index, maneuver, speed)
            lane, position = follow_road(world.network, position, lane, x, y)
            lane = changed_lane(world.network, lane, maneuver, x, y)
        decided = frame = numbers[b, FRAME]
        for k in range(actions.shape[1]):  # numba would make an array to copy a row
            slots.actions[b, decided // rules.substeps, k] = actions[b, k]
        for _ in range(rules.substeps):
            if world.is_meta:
                lane, position = follow_road(world.network, position, lane, x, y)
                angle = steering(world.network.lanes, lane, x, y, heading, speed)
                acceleration = throttle(world.target_speeds[index], speed)
            acceleration = _within_speeds(rules, speed, acceleration)
            slip = math.atan(0.5 * math.tan(angle))
            x, y, heading, speed = _bicycle(rules, x, y, heading, speed, acceleration, slip)
            frame += 1
            record[b, frame, X], record[b, frame, Y], record[b, frame, HEADING] = x, y, heading
            record[b, frame, VX], record[b, frame, VY] = (
                speed * math.cos(heading + slip),
                speed * math.sin(heading + slip),
            )
            if numbers[b, LINE_FRAME] < 0 and touches_line(world.illegal_lines, x, y, heading):
                numbers[b, LINE_FRAME] = frame
            time = frame / rules.frequency
            move_npcs(world.npc_routes, numbers, slots.npc, slots.npc_numbers, slots.phases, b, time)
            is_slow = math.hypot(record[b, frame, VX], record[b, frame, VY]) < rules.standstill_speed
            numbers[b, STANDING] = numbers[b, STANDING] + 1 if is_slow else 0
            end = _find_end(rules, frame, numbers[b, STANDING], x, y)
            if _touched(slots.npc, slots.size, b, 0, numbers[b, N_NPCS], x, y, heading) >= 0:
                end = COLLISION
            if end != RUNNING:
                break
        ego[b, X], ego[b, Y], ego[b, HEADING], ego[b, SPEED] = x, y, heading, speed
        ego[b, ACCELERATION], ego[b, STEERING] = acceleration, angle
        numbers[b, TARGET_LANE], numbers[b, ROUTE_POSITION], numbers[b, SPEED_INDEX] = lane, position, index
        numbers[b, FRAME], numbers[b, END] = frame, end
        _appraise(rules, world.ego_lanes, record, slots.outcome, b, decided, frame)
        slots.outcome[b, TOUCHED] = 1.0 if numbers[b, LINE_FRAME] > decided else 0.0
        rear_end = end == COLLISION and _struck_from_behind(record, frame, slots.npc, slots.size, b, numbers[b, N_NPCS])
        slots.outcome[b, REAR_END] = 1.0 if rear_end else 0.0
        _note_end(world.terminal, end, b, ends)
        ended += end != RUNNING
    return ended


@kernel_inner
def _have_room(world: World, slots: Slots, actions: Floats, active: Bools) -> bool:
    """Return whether the slots have room for another decision of the active episodes."""
    rules, (n_decisions, n_values) = world.rules, slots.actions.shape[1:]
    for b in range(len(active)):
        frame, n_npcs = slots.numbers[b, FRAME], slots.numbers[b, N_NPCS]
        goes_on = 0 <= frame < rules.max_frames and frame // rules.substeps < n_decisions
        if active[b] and not (goes_on and 0 <= n_npcs <= slots.npc.shape[1]):
            return False
    return bool(rules.max_frames <= slots.record.shape[1] - 1 and actions.shape[1] <= n_values)


@kernel_inner
def _note_end(terminal: Bools, end: int, b: int, ends: Bools) -> None:
    if end >= 0:
        ends[0, b], ends[1, b] = terminal[end], not terminal[end]


@kernel_inner
def _within_speeds(rules: Rules, speed: float, acceleration: float) -> float:
    """Limit the acceleration to keep the ego within its speed range: `Vehicle.clip_actions`."""
    if speed > rules.max_speed:
        return min(acceleration, rules.max_speed - speed)
    if speed < rules.min_speed:
        return max(acceleration, rules.min_speed - speed)
    return acceleration


@kernel_inner
def _bicycle(
    rules: Rules, x: float, y: float, heading: float, speed: float, acceleration: float, slip: float
) -> tuple[float, float, float, float]:
    """Advance the ego by one step of highway-env's bicycle model: `Vehicle.step`."""
    dt = 1 / rules.frequency
    x += speed * math.cos(heading + slip) * dt
    y += speed * math.sin(heading + slip) * dt
    heading += speed * math.sin(slip) / (LENGTH / 2) * dt
    return x, y, heading, speed + acceleration * dt


@kernel_inner
def _find_end(rules: Rules, frame: int, standing: int, x: float, y: float) -> int:
    """Return the end of the episode other than a collision, or `RUNNING`: `DrivingEnv._find_end`."""
    dx, dy = x - rules.destination_x, y - rules.destination_y
    if math.hypot(dx, dy) <= rules.arrival_distance:
        return ARRIVED
    if dx * rules.destination_cos + dy * rules.destination_sin > rules.passed_distance:
        return PASSED
    if standing >= rules.standstill_frames:
        return STANDSTILL
    return TIMEOUT if frame >= rules.max_frames else RUNNING


@kernel_inner
def _touched(npc: Floats, size: Floats, b: int, first: int, n_npcs: int, x: float, y: float, heading: float) -> int:
    """Return the first NPC of slot b, from `first` on, that the ego's box touches, or -1 if there is none."""
    for i in range(first, n_npcs):
        length, width = size[b, 1 + i, 0], size[b, 1 + i, 1]
        reach = RADIUS + math.hypot(length, width) / 2
        dx, dy = npc[b, i, X] - x, npc[b, i, Y] - y
        if abs(dx) > reach or abs(dy) > reach or math.hypot(dx, dy) > reach:
            continue
        box = corners(x, y, heading, EGO_SIZE[0], EGO_SIZE[1])
        if boxes_touch(box, corners(npc[b, i, X], npc[b, i, Y], npc[b, i, HEADING], length, width)):
            return i
    return -1


@kernel_inner
def _appraise(
    rules: Rules, ego_lanes: Floats, record: Floats, outcome: Floats, b: int, decided: int, frame: int
) -> None:
    """Compute the ego's progress and mean acceleration since the latest decision: `Recorder.reward_terms`."""
    elapsed = frame / rules.frequency - decided / rules.frequency
    before = math.hypot(record[b, decided, VX], record[b, decided, VY])
    outcome[b, MEAN_ACCELERATION] = (math.hypot(record[b, frame, VX], record[b, frame, VY]) - before) / elapsed
    start = _station(ego_lanes, record[b, decided, X], record[b, decided, Y])
    outcome[b, PROGRESS] = _station(ego_lanes, record[b, frame, X], record[b, frame, Y]) - start


@kernel_inner
def _struck_from_behind(record: Floats, frame: int, npc: Floats, size: Floats, b: int, n_npcs: int) -> bool:
    """Return whether every NPC that touches the ego ran into its back."""
    x, y, heading = record[b, frame, X], record[b, frame, Y], record[b, frame, HEADING]
    speed = math.hypot(record[b, frame, VX], record[b, frame, VY])
    i = _touched(npc, size, b, 0, n_npcs, x, y, heading)
    while i >= 0:
        ahead = (npc[b, i, X] - x) * math.cos(heading) + (npc[b, i, Y] - y) * math.sin(heading)
        turned = (npc[b, i, HEADING] - heading + math.pi) % (2 * math.pi) - math.pi
        if not _is_rear_end(ahead, turned, LENGTH, speed, npc[b, i, SPEED]):
            return False
        i = _touched(npc, size, b, i + 1, n_npcs, x, y, heading)
    return True


@kernel_inner
def _station(lanes: Floats, x: float, y: float) -> float:
    """Compute the station of a point on the ego's route [m]: `behavexplor.data.roadmap.Route.project`."""
    best, nearest = 0.0, math.inf
    last = len(lanes) - 1
    for i in range(last + 1):
        dx, dy = x - lanes[i, EGO_X], y - lanes[i, EGO_Y]
        cos, sin = lanes[i, EGO_COS], lanes[i, EGO_SIN]
        station, offset = dx * cos + dy * sin, dy * cos - dx * sin
        if lanes[i, EGO_CURVATURE] != 0.0:
            radius = 1 / lanes[i, EGO_CURVATURE]
            side = math.copysign(1.0, radius)
            ahead, to_center = station, radius - offset
            station = math.atan2(side * ahead, side * to_center) * radius
            offset = radius - side * math.hypot(ahead, to_center)
        before = max(-station, 0.0) if i > 0 else 0.0
        behind = max(station - lanes[i, EGO_LENGTH], 0.0) if i < last else 0.0
        gap = math.hypot(offset, before + behind)
        if gap < nearest:
            best, nearest = lanes[i, EGO_BEGIN] + station, gap
    return best
