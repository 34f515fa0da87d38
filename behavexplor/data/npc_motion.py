"""The motion of NPCs, computed from the scenario before the episode begins.

NPCs follow their waypoints blindly, so their positions depend on the scenario and on time alone. The acceleration
between two waypoints is constant, so the square of the speed is linear in the position. Accelerations are limited: if
a waypoint's speed cannot be reached within the distance, the vehicle comes as close to it as the limits allow. After
its last waypoint, a vehicle brakes at the limit and parks.

The functions are compiled and shared by the single and the vector environment, so both compute the same motion, bit
for bit.
"""

import math
from collections.abc import Sequence
from functools import cache
from typing import Final, NamedTuple

import numpy as np

from behavexplor.data.array_types import Floats
from behavexplor.data.roadmap import RoadMap, Route
from behavexplor.data.scenario import Scenario
from behavexplor.data.scripted import NPC
from behavexplor.jit import kernel, kernel_in_place, kernel_inner

MIN_ACCELERATION: Final = -8.0  # [m/s2]
MAX_ACCELERATION: Final = 4.0  # [m/s2]

X, Y, HEADING, SPEED, ACCELERATION = range(5)  # columns of the motion table
N_COLUMNS = 5

BEGIN, STATION, PHASE_SPEED, PHASE_ACCELERATION = range(4)  # columns of a table of phases
N_PHASE_COLUMNS = 4

_X, _Y, _HEADING, _COS, _SIN, _CURVATURE = range(6)  # columns of a route's lanes


class Routes(NamedTuple):
    """Routes as plain arrays, padded to the largest number of lanes.

    Attributes:
        lanes: start x [m], start y [m], heading at the start [rad], its cosine and sine, and curvature [1/m] of every
            lane, shape (routes, lanes, 6).
        begin: station at which each lane begins [m], infinite where the route has no such lane, shape
            (routes, lanes + 1).
    """

    lanes: Floats
    begin: Floats


def motion_table(scenario: Scenario, roadmap: RoadMap, time: Floats) -> Floats:
    """Compute x [m], y [m], heading [rad], speed [m/s] and acceleration [m/s2] of every NPC, shape (T, n_npcs, 5).

    The scenario is valid on the map. The times are >= 0 and never decrease, shape (T,) [s].
    """
    table = np.empty((len(time), len(scenario.npcs), N_COLUMNS))
    index = route_index(roadmap)
    for i, npc in enumerate(scenario.npcs):
        fill_motion(route_arrays(roadmap), index[npc.route], waypoint_array(npc), time, table[:, i])
    return table


def motion_on_route(roadmap: RoadMap, route: Route, waypoints: Floats, time: Floats) -> Floats:
    """Compute x [m], y [m] and heading [rad] of K vehicles on one route, each as if it were alone, shape (K, T, 3).

    Their waypoints are positions [m] and speeds [m/s], shape (K, waypoints, 2). The times are >= 0 and never decrease,
    shape (T,) [s].
    """
    table = np.empty((len(waypoints), len(time), N_COLUMNS))
    for i in range(len(waypoints)):
        fill_motion(route_arrays(roadmap), route_index(roadmap)[route.name], waypoints[i], time, table[i])
    return table[..., : HEADING + 1]


def waypoint_array(npc: NPC) -> Floats:
    """Return the position [m] and speed [m/s] of each waypoint, shape (waypoints, 2)."""
    return np.array([(waypoint.position, waypoint.speed) for waypoint in npc.waypoints])


@cache
def route_index(roadmap: RoadMap) -> dict[str, int]:
    """Return the row of each NPC route in `route_arrays`, by the route's name."""
    return {route.name: i for i, route in enumerate(roadmap.npc_routes)}


@cache
def route_arrays(roadmap: RoadMap) -> Routes:
    """Return the NPC routes of a map as plain arrays. They are computed once, since a map never changes."""
    return routes_as_arrays(roadmap.npc_routes)


def routes_as_arrays(routes: Sequence[Route]) -> Routes:
    """Convert routes to plain arrays."""
    most = max(len(route.lanes) for route in routes)
    lanes, begin = np.zeros((len(routes), most, 6)), np.full((len(routes), most + 1), np.inf)
    for i, route in enumerate(routes):
        begin[i, : len(route.lanes)] = route.bounds[:-1]
        for j, lane in enumerate(route.lanes):
            cos, sin = math.cos(lane.heading), math.sin(lane.heading)
            lanes[i, j] = lane.x, lane.y, lane.heading, cos, sin, lane.curvature
    return Routes(lanes, begin)


@kernel
def fill_motion(routes: Routes, route: int, waypoints: Floats, time: Floats, table: Floats) -> None:
    """Fill one NPC's columns of a motion table, shape (T, 5)."""
    phases = np.empty((len(waypoints) + 1, N_PHASE_COLUMNS))
    fill_frames(routes, route, phases, fill_phases(waypoints, phases), time, table)


@kernel_inner
def fill_frames(routes: Routes, route: int, phases: Floats, n_phases: int, time: Floats, table: Floats) -> None:
    """Fill one NPC's columns of a motion table, shape (T, 5), from its phases; see `fill_phases`."""
    phase = 0
    for frame in range(len(time)):
        while phase + 1 < n_phases and phases[phase + 1, BEGIN] <= time[frame]:
            phase += 1
        x, y, heading, speed = npc_at(routes, route, phases[phase], time[frame])
        table[frame, X], table[frame, Y], table[frame, HEADING], table[frame, SPEED] = x, y, heading, speed
        table[frame, ACCELERATION] = phases[phase, PHASE_ACCELERATION]


@kernel_in_place
def fill_phases(waypoints: Floats, phases: Floats) -> int:
    """Fill in an NPC's phases of constant acceleration, and return their number. It stands still in the last one.

    A row of `phases`, of which there must be at least one more than waypoints, has the time at which the phase begins
    [s], the station [m] and speed [m/s] at that time, and the acceleration [m/s2]. Waypoints: see `waypoint_array`.
    """
    n = 0
    time, station, speed = 0.0, waypoints[0, 0], waypoints[0, 1]
    for i in range(1, len(waypoints)):
        distance = waypoints[i, 0] - station
        if distance <= 0:
            continue
        wanted = (waypoints[i, 1] * waypoints[i, 1] - speed * speed) / (2 * distance)
        acceleration = min(max(wanted, MIN_ACCELERATION), MAX_ACCELERATION)
        reached = waypoints[i, 1]
        if acceleration != wanted:
            reached = math.sqrt(speed * speed + 2 * acceleration * distance)
        phases[n] = (time, station, speed, acceleration)
        n += 1
        time += 2 * distance / (speed + reached)
        station, speed = waypoints[i, 0], reached
    if speed > 0:
        phases[n] = (time, station, speed, MIN_ACCELERATION)
        n += 1
        time -= speed / MIN_ACCELERATION
        station -= speed * speed / (2 * MIN_ACCELERATION)
    phases[n] = (time, station, 0.0, 0.0)
    return n + 1


@kernel_inner
def npc_at(routes: Routes, route: int, phase: Floats, time: float) -> tuple[float, float, float, float]:
    """Compute the position x and y [m], heading [rad] and speed [m/s] of an NPC at a time in a phase [s].

    `route` is the row of its route, and `phase` a row of `fill_phases`.
    """
    since, speed, acceleration = time - phase[BEGIN], phase[PHASE_SPEED], phase[PHASE_ACCELERATION]
    station = phase[STATION] + since * (speed + 0.5 * acceleration * since)
    i = 0
    while station >= routes.begin[route, i + 1]:
        i += 1
    station -= routes.begin[route, i]
    x, y, curvature = routes.lanes[route, i, _X], routes.lanes[route, i, _Y], routes.lanes[route, i, _CURVATURE]
    cos, sin = routes.lanes[route, i, _COS], routes.lanes[route, i, _SIN]
    heading = routes.lanes[route, i, _HEADING] + curvature * station
    if curvature == 0.0:
        x, y = x + station * cos, y + station * sin
    else:
        x, y = x + (math.sin(heading) - sin) / curvature, y - (math.cos(heading) - cos) / curvature
    return x, y, heading, max(speed + acceleration * since, 0.0)
