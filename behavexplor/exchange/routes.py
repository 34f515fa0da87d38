"""Scripted vehicles as routes with speed profiles, as OpenSCENARIO has them."""

import numpy as np

from behavexplor.data.array_types import Floats
from behavexplor.data.npc_motion import BEGIN, N_PHASE_COLUMNS, PHASE_SPEED, fill_phases, waypoint_array
from behavexplor.data.roadmap import RoadMap
from behavexplor.data.scripted import NPC
from behavexplor.exchange.axes import DIGITS, mirrored_points


def route_points(npc: NPC, roadmap: RoadMap) -> Floats:
    """Return points of a vehicle's route as they are written, shape (P, 2) [m].

    They are the start, the ends of the lanes that it passes, and the place where it parks.
    """
    route = roadmap.routes[npc.route]
    first, last = npc.waypoints[0].position, npc.waypoints[-1].position
    between = [end for end in route.bounds.tolist() if first < end < last]
    points = route.pose(np.array([first, *between, last]))[:, :2]
    return np.asarray(np.round(mirrored_points(points), DIGITS) + 0.0)


def speed_profile(npc: NPC) -> Floats:
    """Return the speed at the end of each phase [m/s] and the duration of the phase [s], shape (P, 2)."""
    waypoints = waypoint_array(npc)
    phases = np.empty((len(waypoints) + 1, N_PHASE_COLUMNS))
    phases = phases[: fill_phases(waypoints, phases)]
    profile = np.column_stack([phases[1:, PHASE_SPEED], np.diff(phases[:, BEGIN])])
    return np.asarray(np.round(profile, DIGITS))
