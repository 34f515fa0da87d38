"""Simulate one decision of every ego, from its command to the outcome, and observe it."""

import math
from typing import Final

from behavexplor.data import scene
from behavexplor.data.array_types import Bools, Floats, Singles
from behavexplor.data.box_kernels import boxes_touch, corners
from behavexplor.data.conventions import EGO_SIZE, is_rear_end
from behavexplor.data.trace import ENDS
from behavexplor.envs.engine.bicycle import move
from behavexplor.envs.engine.contact import touches_line
from behavexplor.envs.engine.lane_geometry import closest_lane, lane_coordinates
from behavexplor.envs.engine.lane_keeping import keep_lane_and_speed, take_maneuver
from behavexplor.envs.engine.lane_network import Network
from behavexplor.envs.engine.observing import LONG_OFF, View, observe
from behavexplor.envs.engine.state import Records, Scene, Scratch, Traits, Vehicle
from behavexplor.envs.tasks.scripted_outcome import Pose
from behavexplor.envs.tasks.scripted_slots import RUNNING, Run, ScriptedSlots, move_npcs
from behavexplor.envs.tasks.scripted_world import ScriptedRules, ScriptedWorld
from behavexplor.jit import kernel_in_place, kernel_inner

COLLISION, ARRIVED, PASSED, STANDSTILL, TIMEOUT = (
    ENDS.index(end) for end in ("collision", "arrived", "passed", "standstill", "timeout")
)
LENGTH: Final = float(EGO_SIZE[0])  # [m]

_is_rear_end = kernel_inner(is_rear_end)


@kernel_in_place
def step(
    world: ScriptedWorld,
    slots: ScriptedSlots,
    actions: Floats,
    commands: Floats,
    active: Bools,
    ends: Bools,
    n_frames: int,
) -> int:
    """Simulate until the next decision, or until an episode ends. Return the number of episodes that have ended now.

    If the record of an episode has no room for another decision, nothing is changed, and -1 is returned.

    Actions, shape (B, A), are only recorded. Commands are acceleration [m/s2] and steering [rad], shape (B, 2); for
    meta-actions, the first column is the code of the maneuver. `active`, shape (B,), says which slots are simulated.
    `ends`, shape (2, B), is all False at first. Then its first row says which episodes are terminated, and its second
    row which are truncated. At most `n_frames` are simulated; if a decision has more, the next call with the same
    actions goes on.
    """
    if not _have_room(world, slots, actions, active):
        return -1
    ended = 0
    for b in range(len(active)):
        run = slots.runs[b]
        if active[b]:
            _decide(world, slots, b, actions[b], commands[b], n_frames)
            ended += run.end != RUNNING
        if run.end >= 0:
            ends[0, b], ends[1, b] = world.terminal[run.end], not world.terminal[run.end]
    return ended


@kernel_inner
def _decide(world: ScriptedWorld, slots: ScriptedSlots, b: int, action: Floats, command: Floats, n_frames: int) -> None:
    """Record the action of slot b, simulate its decision, and compute what is rewarded.

    `action` and `command` are rows of those of `step`.
    """
    run, poses, rules = slots.runs[b], slots.poses[b], world.rules[0]
    vehicles, traits, n_npcs = slots.state.vehicles[b], slots.state.traits[b], slots.state.episodes[b].n_vehicles - 1
    ego, route = vehicles[0], slots.state.routes[b, 0]
    first = run.frame
    decided = first // rules.substeps * rules.substeps  # before `first` if the last call ended within the decision
    for k in range(len(action)):  # numba would make an array to copy a row
        slots.actions[b, decided // rules.substeps, k] = action[k]
    if not rules.is_meta:
        ego.acceleration, ego.steering = command[0], command[1]
    elif first == decided:
        take_maneuver(world.network, world.target_speeds, ego, route, int(command[0]))
    last = min(decided + rules.substeps, first + n_frames)
    while run.end == RUNNING and run.frame < last:
        run.frame += 1
        _drive(world.network, rules, ego, route, traits[0], poses[run.frame])
        if run.line_frame < 0 and touches_line(world.illegal_lines, ego.x, ego.y, ego.cos, ego.sin):
            run.line_frame = run.frame
        time = run.frame / rules.frequency
        move_npcs(world.npc_routes, vehicles, slots.scripts[b], slots.phases[b], n_npcs, time)
        _update_end(rules, run, poses[run.frame])
        if first_touched(vehicles, traits, 0, n_npcs) >= 0:
            run.end = COLLISION
    _appraise(world.ego_route, rules, run, poses, decided)
    run.rear_end = run.end == COLLISION and _struck_from_behind(poses[run.frame], vehicles, traits, n_npcs)


@kernel_inner
def _have_room(world: ScriptedWorld, slots: ScriptedSlots, actions: Floats, active: Bools) -> bool:
    """Return whether the slots have room for another decision of the active episodes."""
    rules = world.rules[0]
    n_decisions, n_values = slots.actions.shape[1:]
    if rules.max_frames >= slots.poses.shape[1] or actions.shape[1] > n_values:
        return False
    for b in range(len(active)):
        frame, n_npcs = slots.runs[b].frame, slots.state.episodes[b].n_vehicles - 1
        is_within = 0 <= frame < rules.max_frames and frame // rules.substeps < n_decisions
        if active[b] and not (is_within and 0 <= n_npcs <= slots.scripts.shape[1]):
            return False
    return True


@kernel_inner
def _drive(network: Network, rules: ScriptedRules, ego: Vehicle, route: Records, traits: Traits, pose: Pose) -> None:
    """Move the ego by one step, and record its pose. Its velocity is that of its center, so it includes the slip."""
    if rules.is_meta:
        station, offset = lane_coordinates(network.lanes[ego.target_lane], ego.x, ego.y)
        keep_lane_and_speed(network, ego, route, traits.length, station, offset)
    slip = move(ego, traits, rules.dt)
    cos, sin = ego.cos, ego.sin
    if slip != 0.0:
        cos, sin = math.cos(ego.heading + slip), math.sin(ego.heading + slip)
    pose.x, pose.y, pose.heading, pose.vx, pose.vy = ego.x, ego.y, ego.heading, ego.speed * cos, ego.speed * sin


@kernel_inner
def _update_end(rules: ScriptedRules, run: Run, pose: Pose) -> None:
    """Note how long the ego has stood, and any end of the episode but a collision: `PlainSimulation._find_end`."""
    run.standing = run.standing + 1 if math.hypot(pose.vx, pose.vy) < rules.standstill_speed else 0
    dx, dy = pose.x - rules.destination_x, pose.y - rules.destination_y
    if math.hypot(dx, dy) <= rules.arrival_distance:
        run.end = ARRIVED
    elif dx * rules.destination_cos + dy * rules.destination_sin > rules.passed_distance:
        run.end = PASSED
    elif run.standing >= rules.standstill_frames:
        run.end = STANDSTILL
    elif run.frame >= rules.max_frames:
        run.end = TIMEOUT


@kernel_inner
def first_touched(vehicles: Records, traits: Records, first: int, n_npcs: int) -> int:
    """Return the first NPC, from `first` on, that the ego's box touches, or -1 if there is none."""
    ego, own = vehicles[0], traits[0]
    for i in range(first, n_npcs):
        npc, size = vehicles[1 + i], traits[1 + i]
        reach = own.diameter / 2 + size.diameter / 2
        dx, dy = npc.x - ego.x, npc.y - ego.y
        if abs(dx) > reach or abs(dy) > reach or math.hypot(dx, dy) > reach:
            continue
        box = corners(ego.x, ego.y, ego.cos, ego.sin, own.length, own.width)
        cos, sin = math.cos(npc.heading), math.sin(npc.heading)  # `move_npcs` does not update those of the NPC
        if boxes_touch(box, corners(npc.x, npc.y, cos, sin, size.length, size.width)):
            return i
    return -1


@kernel_inner
def _appraise(ego_route: Records, rules: ScriptedRules, run: Run, poses: Records, decided: int) -> None:
    """Compute progress, mean acceleration and first touch of a line in the latest decision: `Recorder.reward_terms`."""
    before, now = poses[decided], poses[run.frame]
    elapsed = run.frame / rules.frequency - decided / rules.frequency
    run.mean_acceleration = (math.hypot(now.vx, now.vy) - math.hypot(before.vx, before.vy)) / elapsed
    run.progress = _station(ego_route, now.x, now.y) - _station(ego_route, before.x, before.y)
    run.touched = run.line_frame > decided


@kernel_inner
def _struck_from_behind(pose: Pose, vehicles: Records, traits: Records, n_npcs: int) -> bool:
    """Return whether every NPC that touches the ego ran into its back."""
    ego, speed = vehicles[0], math.hypot(pose.vx, pose.vy)
    i = first_touched(vehicles, traits, 0, n_npcs)
    while i >= 0:
        npc = vehicles[1 + i]
        ahead = (npc.x - ego.x) * math.cos(ego.heading) + (npc.y - ego.y) * math.sin(ego.heading)
        turned = (npc.heading - ego.heading + math.pi) % (2 * math.pi) - math.pi
        if not _is_rear_end(ahead, turned, LENGTH, speed, npc.speed):
            return False
        i = first_touched(vehicles, traits, i + 1, n_npcs)
    return True


@kernel_inner
def _station(ego_route: Records, x: float, y: float) -> float:
    """Compute the station of a point on the ego's route [m]: `behavexplor.data.roadmap.Route.project`."""
    best, nearest = 0.0, math.inf
    last = len(ego_route) - 1
    for i in range(last + 1):
        piece = ego_route[i]
        dx, dy = x - piece.x, y - piece.y
        station, offset = dx * piece.cos + dy * piece.sin, dy * piece.cos - dx * piece.sin
        if piece.curvature != 0.0:
            radius = 1 / piece.curvature
            side = math.copysign(1.0, radius)
            ahead, to_center = station, radius - offset
            station = math.atan2(side * ahead, side * to_center) * radius
            offset = radius - side * math.hypot(ahead, to_center)
        before = max(-station, 0.0) if i > 0 else 0.0
        behind = max(station - piece.length, 0.0) if i < last else 0.0
        gap = math.hypot(offset, before + behind)
        if gap < nearest:
            best, nearest = piece.begin + station, gap
    return best


@kernel_in_place
def observe_scene(slots: ScriptedSlots, chosen: Bools, observations: Floats) -> None:
    """Fill the `Scene` observations of the chosen slots, shape (B, 1 + N, 8); see `behavexplor.data.scene`."""
    for b in range(len(chosen)):
        if not chosen[b]:
            continue
        observations[b] = 0.0
        vehicles, traits = slots.state.vehicles[b], slots.state.traits[b]
        for i in range(slots.state.episodes[b].n_vehicles):
            row, vehicle, size = observations[b, i], vehicles[i], traits[i]
            row[scene.PRESENT] = 1.0
            row[scene.X], row[scene.Y], row[scene.HEADING] = vehicle.x, vehicle.y, vehicle.heading
            row[scene.SPEED], row[scene.ACCELERATION] = vehicle.speed, vehicle.acceleration
            row[scene.LENGTH], row[scene.WIDTH] = size.length, size.width


@kernel_in_place
def observe_kinematics(
    world: ScriptedWorld, slots: ScriptedSlots, view: View, scratch: Scratch, chosen: Bools, observations: Singles
) -> None:
    """Fill the Kinematics observations of the chosen slots, shape (B, vehicles_count, features)."""
    shows_lanes = False
    for k in range(len(view.columns)):
        shows_lanes |= view.columns[k].feature >= LONG_OFF  # the features from there on tell the place in the lane
    state = slots.state
    for b in range(len(chosen)):
        if not chosen[b]:
            continue
        watched = Scene(state.episodes[b], state.vehicles[b], state.traits[b], state.routes[b], scratch)
        _update_lane(world.network, watched.vehicles[0])
        for i in range(1, watched.episode.n_vehicles):
            npc = watched.vehicles[i]
            npc.cos, npc.sin = math.cos(npc.heading), math.sin(npc.heading)
            if shows_lanes:
                _update_lane(world.network, npc)
        observe(world.network, view, watched, observations[b])


@kernel_inner
def _update_lane(network: Network, vehicle: Vehicle) -> None:
    vehicle.lane = closest_lane(network, vehicle.lane, vehicle.x, vehicle.y, vehicle.heading)[0]
