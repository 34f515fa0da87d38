"""The state of all episodes in lock-step, one row (slot) for each episode."""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from behavexplor.data.array_types import Floats, Ints
from behavexplor.data.conventions import EGO_SIZE, VEHICLE_SIZES
from behavexplor.data.npc_motion import (
    BEGIN,
    N_PHASE_COLUMNS,
    PHASE_ACCELERATION,
    Routes,
    fill_frames,
    fill_phases,
    npc_at,
    route_index,
)
from behavexplor.data.roadmap import RoadMap
from behavexplor.data.scripted import ScriptedScenario
from behavexplor.data.scripted_logical import ScriptedLogicalScenario
from behavexplor.envs.engine import state as engine_state
from behavexplor.envs.engine.contact import touches_line
from behavexplor.envs.engine.lane_geometry import closest_lane
from behavexplor.envs.engine.state import Records, Traits, Vehicle, record_type
from behavexplor.envs.tasks.scripted_outcome import POSE
from behavexplor.envs.tasks.scripted_world import ScriptedWorld
from behavexplor.jit import kernel_in_place, kernel_inner

Run: TypeAlias = np.record

RUNNING, IDLE = -1, -2  # `end` while an episode runs, and before the first one

RUN: Final = record_type(
    frame=np.int64,  # the latest one
    standing=np.int64,  # number of frames for which the ego has stood still
    line_frame=np.int64,  # at which it first touched an illegal line; -1: none
    end=np.int64,  # RUNNING, IDLE or an index of `behavexplor.data.trace.ENDS`
    progress=np.float64,  # along the route in the latest decision [m]
    mean_acceleration=np.float64,  # in the latest decision [m/s2]
    touched=np.bool_,  # whether the ego touched an illegal line for the first time in the latest decision
    rear_end=np.bool_,  # whether a faster NPC struck it from behind
)

SCRIPT: Final = record_type(route=np.int64, n_phases=np.int64, phase=np.int64)


class ScriptedSlots(NamedTuple):
    """B episodes in lock-step, each with an ego and at most N NPCs."""

    state: engine_state.Slots  # the vehicles, of which the ego is the first
    runs: Records  # shape (B,) of `RUN`
    scripts: Records  # route, number of phases and current phase of every NPC, shape (B, N) of `SCRIPT`
    # the NPCs' phases of constant acceleration, shape (B, N, phases, 4); see `behavexplor.data.npc_motion.fill_phases`
    phases: Floats
    poses: Records  # of the ego in every frame, shape (B, T) of `behavexplor.envs.tasks.scripted_outcome.POSE`
    actions: Floats  # the actions of each decision, shape (B, D, A)


def make_slots(
    n_slots: int, n_frames: int, shape_of_actions: tuple[int, int], logical: ScriptedLogicalScenario
) -> ScriptedSlots:
    """Create slots without episodes, for up to `n_frames` frames.

    `shape_of_actions` is the greatest number of decisions D, and the number A of values of an action.
    """
    npcs, routes = logical.n_npcs, logical.roadmap.npc_routes
    n_phases = 1 + max(len(logical.position_ranges(route)) for route in routes)
    n_steps = max(len(route.lanes) for route in (logical.roadmap.ego_route, *routes))
    runs = np.zeros(n_slots, RUN)
    runs["end"] = IDLE
    return ScriptedSlots(
        state=engine_state.make_slots(n_slots, 1 + npcs, n_steps),
        runs=runs,
        scripts=np.zeros((n_slots, npcs), SCRIPT),
        phases=np.zeros((n_slots, npcs, n_phases, N_PHASE_COLUMNS)),
        poses=np.zeros((n_slots, n_frames), POSE),
        actions=np.zeros((n_slots, *shape_of_actions)),
    )


@kernel_in_place
def begin_episodes(
    world: ScriptedWorld,
    slots: ScriptedSlots,
    chosen: Ints,
    counts: Ints,
    routes: Ints,
    sizes: Floats,
    waypoints: Floats,
) -> bool:
    """Begin an episode in each chosen slot. Return whether slots and NPCs fit the arrays; if not, nothing is changed.

    The NPCs of all episodes follow one another in the arrays with n_npcs rows.

    Args:
        world: the world.
        slots: slots, which are changed in place.
        chosen: numbers of the slots, shape (E,).
        counts: number of NPCs in each of them, shape (E,).
        routes: row of each NPC's route, shape (n_npcs,).
        sizes: length and width of each NPC, shape (n_npcs, 2) [m].
        waypoints: positions [m] and speeds [m/s] of each NPC, padded with copies of the last waypoint, shape (n_npcs,
            waypoints, 2).
    """
    n_npcs = 0
    for k in range(len(chosen)):
        if not (0 <= chosen[k] < len(slots.runs) and 0 <= counts[k] <= slots.scripts.shape[1]):
            return False
        n_npcs += counts[k]
    if n_npcs > min(len(routes), len(sizes), len(waypoints)) or waypoints.shape[1] >= slots.phases.shape[2]:
        return False
    first = 0
    for k in range(len(chosen)):
        b = chosen[k]
        _begin_ego(world, slots, b)
        slots.state.episodes[b].n_vehicles = 1 + counts[k]
        for i in range(counts[k]):
            n = first + i
            _begin_npc(world, slots, b, i, routes[n], waypoints[n])
            _set_size(slots.state.traits[b, 1 + i], sizes[n, 0], sizes[n, 1])
        vehicles, scripts = slots.state.vehicles[b], slots.scripts[b]
        move_npcs(world.npc_routes, vehicles, scripts, slots.phases[b], counts[k], 0.0)
        first += counts[k]
    return True


@kernel_inner
def _begin_ego(world: ScriptedWorld, slots: ScriptedSlots, b: int) -> None:
    run, ego, traits = slots.runs[b], slots.state.vehicles[b, 0], slots.state.traits[b, 0]
    run.frame = run.standing = 0
    run.line_frame, run.end = -1, RUNNING
    ego.x, ego.y, ego.heading = world.start[0], world.start[1], world.start[2]
    ego.cos, ego.sin = math.cos(ego.heading), math.sin(ego.heading)
    ego.speed = ego.steering = ego.acceleration = 0.0
    ego.speed_index, ego.target_speed = 0, world.target_speeds[0]
    ego.lane = closest_lane(world.network, 0, ego.x, ego.y, ego.heading)[0]
    ego.target_lane = ego.lane
    _set_route(world, slots.state.routes[b, 0], ego, 0)
    _set_size(traits, EGO_SIZE[0], EGO_SIZE[1])
    traits.min_speed, traits.max_speed = world.rules[0].min_speed, world.rules[0].max_speed
    if touches_line(world.illegal_lines, ego.x, ego.y, ego.cos, ego.sin):
        run.line_frame = 0
    pose = slots.poses[b, 0]
    pose.x, pose.y, pose.heading, pose.vx, pose.vy = ego.x, ego.y, ego.heading, 0.0, 0.0


@kernel_inner
def _begin_npc(world: ScriptedWorld, slots: ScriptedSlots, b: int, i: int, route: int, waypoints: Floats) -> None:
    script = slots.scripts[b, i]
    script.route, script.phase = route, 0
    script.n_phases = fill_phases(waypoints, slots.phases[b, i])
    _set_route(world, slots.state.routes[b, 1 + i], slots.state.vehicles[b, 1 + i], 1 + route)


@kernel_inner
def _set_route(world: ScriptedWorld, steps: Records, vehicle: Vehicle, route: int) -> None:
    vehicle.route_position, vehicle.route_length = 0, world.route_lengths[route]
    for k in range(world.route_lengths[route]):
        steps[k] = world.routes[route, k]


@kernel_inner
def _set_size(traits: Traits, length: float, width: float) -> None:
    traits.length, traits.width, traits.diameter = length, width, math.hypot(length, width)


@kernel_inner
def move_npcs(routes: Routes, vehicles: Records, scripts: Records, phases: Floats, n_npcs: int, time: float) -> None:
    """Move the NPCs of a slot to where they are at a time [s], which never decreases.

    Neither the cosine and sine of their headings nor their lanes are updated.
    """
    for i in range(n_npcs):
        script, npc, n = scripts[i], vehicles[1 + i], scripts[i].phase
        while n + 1 < script.n_phases and phases[i, n + 1, BEGIN] <= time:
            n += 1
        script.phase = n
        npc.x, npc.y, npc.heading, npc.speed = npc_at(routes, script.route, phases[i, n], time)
        npc.acceleration = phases[i, n, PHASE_ACCELERATION]


@kernel_in_place
def fill_table(routes: Routes, scripts: Records, phases: Floats, time: Floats, table: Floats) -> None:
    """Fill in the motion table, (T, n_npcs, 5), of a slot's NPCs at T times [s]; see `behavexplor.data.npc_motion`."""
    for i in range(table.shape[1]):
        fill_frames(routes, scripts[i].route, phases[i], scripts[i].n_phases, time, table[:, i])


class NPCArrays(NamedTuple):
    """The NPCs of scenarios, as `begin_episodes` takes them."""

    counts: Ints
    routes: Ints
    sizes: Floats
    waypoints: Floats


def npc_arrays(scenarios: Sequence[ScriptedScenario], roadmap: RoadMap, n_waypoints: int) -> NPCArrays:
    """Return the NPCs of scenarios as arrays, the waypoints of each padded to `n_waypoints`."""
    index = route_index(roadmap)
    npcs = [npc for scenario in scenarios for npc in scenario.npcs]
    padded = [npc.waypoints + npc.waypoints[-1:] * (n_waypoints - len(npc.waypoints)) for npc in npcs]
    values = [value for waypoints in padded for waypoint in waypoints for value in (waypoint.position, waypoint.speed)]
    return NPCArrays(
        counts=np.array([len(scenario.npcs) for scenario in scenarios], dtype=np.int64),
        routes=np.array([index[npc.route] for npc in npcs], dtype=np.int64),
        sizes=np.array([VEHICLE_SIZES[npc.type] for npc in npcs], dtype=np.float64).reshape(-1, 2),
        waypoints=np.array(values, dtype=np.float64).reshape(len(npcs), n_waypoints, 2),
    )
