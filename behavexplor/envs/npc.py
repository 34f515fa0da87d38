"""The motion of NPCs, computed from the scenario before the episode begins.

NPCs follow their waypoints blindly, so where they are is a function of the scenario and of time alone.
Between two waypoints the acceleration is constant, so that the square of the speed is linear in the
position, and within limits: a speed that cannot be reached in the distance is approached as far as the
limits allow. After its last waypoint a vehicle brakes as hard as it may and parks.
"""

import numpy as np
from numpy.typing import NDArray

from behavexplor.roadmap import RoadMap, Route
from behavexplor.scenario import NPC, Scenario

Floats = NDArray[np.float64]

MIN_ACCELERATION = -8.0  # [m/s2]
MAX_ACCELERATION = 4.0  # [m/s2]

X, Y, HEADING, SPEED, ACCELERATION = range(5)  # columns of a motion table
N_COLUMNS = 5


def motion_table(scenario: Scenario, roadmap: RoadMap, time: Floats) -> Floats:
    """Where every NPC is at given times.

    Args:
        scenario: checked against the logical scenario of `roadmap`.
        roadmap: the place.
        time: shape (T,) [s], each >= 0.

    Returns:
        x [m], y [m], heading [rad], speed [m/s] and acceleration [m/s2], shape (T, n_npcs, 5).
    """
    table = np.empty((len(time), len(scenario.npcs), N_COLUMNS))
    for i, npc in enumerate(scenario.npcs):
        table[:, i] = _motion(npc, roadmap.routes[npc.route], time)
    return table


def _motion(npc: NPC, route: Route, time: Floats) -> Floats:
    begin, station, speed, acceleration = _phases(npc)
    phase = np.searchsorted(begin, time, side="right") - 1
    since = time - begin[phase]
    travelled = station[phase] + since * (speed[phase] + 0.5 * acceleration[phase] * since)
    motion = np.empty((len(time), N_COLUMNS))
    motion[:, :SPEED] = route.pose(travelled)
    motion[:, SPEED] = np.maximum(speed[phase] + acceleration[phase] * since, 0.0)
    motion[:, ACCELERATION] = acceleration[phase]
    return motion


def _phases(npc: NPC) -> tuple[Floats, Floats, Floats, Floats]:
    """Phases of constant acceleration, the last one standing.

    Returns:
        Time of beginning [s], station [m] and speed [m/s] there, and acceleration [m/s2]; each (phases,).
    """
    phases = []
    time, station, speed = 0.0, npc.waypoints[0].position, npc.waypoints[0].speed
    for waypoint in npc.waypoints[1:]:
        distance = waypoint.position - station
        if distance <= 0:
            continue
        wanted = (waypoint.speed**2 - speed**2) / (2 * distance)
        acceleration = min(max(wanted, MIN_ACCELERATION), MAX_ACCELERATION)
        reached = waypoint.speed if acceleration == wanted else (speed**2 + 2 * acceleration * distance) ** 0.5
        phases.append((time, station, speed, acceleration))
        time += 2 * distance / (speed + reached)
        station, speed = waypoint.position, reached
    if speed > 0:
        phases.append((time, station, speed, MIN_ACCELERATION))
        time -= speed / MIN_ACCELERATION
        station -= speed**2 / (2 * MIN_ACCELERATION)
    phases.append((time, station, 0.0, 0.0))
    begin, stations, speeds, accelerations = np.array(phases).T
    return begin, stations, speeds, accelerations
