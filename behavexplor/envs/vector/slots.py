"""The state of all episodes in lock-step, one row (slot) for each episode."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from behavexplor.data.npc_motion import (
    ACCELERATION,
    BEGIN,
    HEADING,
    N_COLUMNS,
    N_PHASE_COLUMNS,
    PHASE_ACCELERATION,
    PHASE_SPEED,
    SPEED,
    STATION,
    Routes,
    X,
    Y,
    fill_frames,
    fill_phases,
    npc_at,
    route_index,
)
from behavexplor.data.roadmap import RoadMap
from behavexplor.data.scripted import ScriptedScenario
from behavexplor.data.scripted_logical import ScriptedLogicalScenario
from behavexplor.data.vehicle_sizes import EGO_SIZE, VEHICLE_SIZES
from behavexplor.envs.vector.contact import touches_line
from behavexplor.envs.vector.lanes import closest_lane
from behavexplor.envs.vector.world import World
from behavexplor.jit import kernel_in_place, kernel_inner

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

STEERING = N_COLUMNS  # column of `ego` after those of a motion table
N_EGO = N_COLUMNS + 1
VX, VY = 3, 4  # columns of `record` after X, Y and HEADING
N_RECORD = 5

FRAME, STANDING, LINE_FRAME, END, N_NPCS = range(5)  # columns of `numbers`
TARGET_LANE, ROUTE_POSITION, SPEED_INDEX = range(5, 8)  # columns of `numbers` for meta-actions
N_COUNT = 8
RUNNING, IDLE = -1, -2  # `END` if no episode has ended; otherwise it is an index of `behavexplor.data.trace.ENDS`

ROUTE, N_PHASES, PHASE = range(3)  # columns of `npc_numbers`

PROGRESS, MEAN_ACCELERATION, TOUCHED, REAR_END = range(4)  # columns of `outcome`


class Slots(NamedTuple):
    """B episodes in lock-step, each with at most N NPCs.

    Attributes:
        ego: the egos' motion, with the columns of a motion table, and the steering command [rad], shape (B, 6). The
            acceleration is the commanded one.
        numbers: whole numbers, shape (B, 8): the latest frame, the number of frames for which the ego has stood still,
            the frame at which it first touched an illegal line (-1: none), the end of the episode, the number of NPCs,
            and for meta-actions the target lane, the position on the route and the index of the target speed.
        record: x [m], y [m], heading [rad] and velocity [m/s] of the ego in every frame, shape (B, T, 5).
        actions: the actions of each decision, shape (B, D, A).
        outcome: result of the latest decision, shape (B, 4): progress along the route [m], mean acceleration [m/s2],
            whether the ego touched an illegal line for the first time, and whether a faster NPC struck it from behind.
        size: length and width of every vehicle [m], the ego first, shape (B, 1 + N, 2).
        npc: current motion of the NPCs, with the columns of a motion table, shape (B, N, 5).
        npc_numbers: route, number of phases and current phase of every NPC, shape (B, N, 3).
        phases: the NPCs' phases of constant acceleration, shape (B, N, phases, 4); see
            `behavexplor.data.npc_motion.fill_phases`.
    """

    ego: Floats
    numbers: Ints
    record: Floats
    actions: Floats
    outcome: Floats
    size: Floats
    npc: Floats
    npc_numbers: Ints
    phases: Floats


def make_slots(
    n_slots: int, n_frames: int, shape_of_actions: tuple[int, int], logical: ScriptedLogicalScenario
) -> Slots:
    """Create slots without episodes.

    Args:
        n_slots: number of slots.
        n_frames: greatest number of frames of an episode.
        shape_of_actions: greatest number of decisions of an episode, and the number of values of an action.
        logical: logical scenario of the scenarios to run.
    """
    npcs = logical.n_npcs
    routes = logical.roadmap.npc_routes
    n_phases = 1 + max(len(logical.position_ranges(route)) for route in routes)
    numbers = np.zeros((n_slots, N_COUNT), dtype=np.int64)
    numbers[:, END] = IDLE
    return Slots(
        ego=np.zeros((n_slots, N_EGO)),
        numbers=numbers,
        record=np.empty((n_slots, n_frames, N_RECORD)),
        actions=np.zeros((n_slots, *shape_of_actions)),
        outcome=np.zeros((n_slots, 4)),
        size=np.zeros((n_slots, 1 + npcs, 2)),
        npc=np.zeros((n_slots, npcs, N_COLUMNS)),
        npc_numbers=np.zeros((n_slots, npcs, 3), dtype=np.int64),
        phases=np.zeros((n_slots, npcs, n_phases, N_PHASE_COLUMNS)),
    )


@kernel_in_place
def begin_episodes(
    world: World, slots: Slots, chosen: Ints, counts: Ints, routes: Ints, sizes: Floats, waypoints: Floats
) -> bool:
    """Begin an episode in each chosen slot. The NPCs of all these episodes follow one another in the arrays.

    Return whether they have room in the slots. If not, nothing is changed.

    Args:
        world: the environment's map and rules.
        slots: the slots, changed in place.
        chosen: the slots, shape (E,).
        counts: number of NPCs in each episode, shape (E,).
        routes: row of each NPC's route, shape (n_npcs,), with the NPCs of all episodes.
        sizes: length and width of each NPC [m], shape (n_npcs, 2).
        waypoints: position [m] and speed [m/s] of each waypoint, padded with copies of the last one, shape
            (n_npcs, waypoints, 2).
    """
    n_npcs = 0
    for k in range(len(chosen)):
        if not (0 <= chosen[k] < len(slots.numbers) and 0 <= counts[k] <= slots.npc.shape[1]):
            return False
        n_npcs += counts[k]
    if n_npcs > min(len(routes), len(sizes), len(waypoints)) or waypoints.shape[1] >= slots.phases.shape[2]:
        return False
    first = 0
    for k in range(len(chosen)):
        end = first + counts[k]
        _begin(world, slots, chosen[k], routes[first:end], sizes[first:end], waypoints[first:end])
        first = end
    return True


@kernel_inner
def _begin(world: World, slots: Slots, b: int, routes: Ints, sizes: Floats, waypoints: Floats) -> None:
    numbers, ego = slots.numbers[b], slots.ego[b]
    ego[:] = 0.0
    ego[X], ego[Y], ego[HEADING] = world.start[0], world.start[1], world.start[2]
    numbers[:] = 0
    numbers[LINE_FRAME], numbers[END], numbers[N_NPCS] = -1, RUNNING, len(routes)
    numbers[TARGET_LANE] = closest_lane(world.network.lanes, ego[X], ego[Y], ego[HEADING])
    slots.size[b] = 0.0
    slots.size[b, 0, 0], slots.size[b, 0, 1] = EGO_SIZE
    slots.npc[b] = 0.0
    for i in range(len(routes)):
        # Numba would make an array to copy a row.
        slots.size[b, 1 + i, 0], slots.size[b, 1 + i, 1] = sizes[i, 0], sizes[i, 1]
        slots.npc_numbers[b, i, ROUTE] = routes[i]
        slots.npc_numbers[b, i, N_PHASES] = fill_phases(waypoints[i], slots.phases[b, i])
        slots.npc_numbers[b, i, PHASE] = 0
    move_npcs(world.npc_routes, slots.numbers, slots.npc, slots.npc_numbers, slots.phases, b, 0.0)
    if touches_line(world.illegal_lines, ego[X], ego[Y], ego[HEADING]):
        numbers[LINE_FRAME] = 0
    row = slots.record[b, 0]
    row[X], row[Y], row[HEADING], row[VX], row[VY] = ego[X], ego[Y], ego[HEADING], 0.0, 0.0


@kernel_inner
def move_npcs(
    routes: Routes, numbers: Ints, npc: Floats, npc_numbers: Ints, phases: Floats, b: int, time: float
) -> None:
    """Move the NPCs of slot b to their positions at a time [s], which never decreases. Arrays are those of `Slots`."""
    for i in range(numbers[b, N_NPCS]):
        n = npc_numbers[b, i, PHASE]
        while n + 1 < npc_numbers[b, i, N_PHASES] and phases[b, i, n + 1, BEGIN] <= time:
            n += 1
        npc_numbers[b, i, PHASE] = n
        npc[b, i, X], npc[b, i, Y], npc[b, i, HEADING], npc[b, i, SPEED] = npc_at(
            routes,
            npc_numbers[b, i, ROUTE],
            time - phases[b, i, n, BEGIN],
            phases[b, i, n, STATION],
            phases[b, i, n, PHASE_SPEED],
            phases[b, i, n, PHASE_ACCELERATION],
        )
        npc[b, i, ACCELERATION] = phases[b, i, n, PHASE_ACCELERATION]


@kernel_in_place
def fill_table(routes: Routes, npc_numbers: Ints, phases: Floats, time: Floats, table: Floats) -> None:
    """Fill in the NPCs' motion table of a slot at given times; see `behavexplor.data.npc_motion.motion_table`.

    Args:
        routes: routes of NPCs.
        npc_numbers: numbers of the slot's NPCs, shape (N, 3).
        phases: their phases, shape (N, phases, 4).
        time: times [s], shape (T,).
        table: table of the NPCs that are there, shape (T, n_npcs, 5); changed in place.
    """
    for i in range(table.shape[1]):
        fill_frames(routes, npc_numbers[i, ROUTE], phases[i], npc_numbers[i, N_PHASES], time, table[:, i])


class NPCArrays(NamedTuple):
    """The NPCs of scenarios, as `begin_episodes` takes them."""

    counts: Ints
    routes: Ints
    sizes: Floats
    waypoints: Floats


def npc_arrays(scenarios: Sequence[ScriptedScenario], roadmap: RoadMap, n_waypoints: int) -> NPCArrays:
    """Return the NPCs of scenarios as arrays.

    Args:
        scenarios: the scenarios, of which each has any number of NPCs.
        roadmap: their map.
        n_waypoints: number of waypoints to which those of each NPC are padded.
    """
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
