"""The one place where coordinates are converted.

This package has y down and headings from x toward y, as highway-env does. The exchanged files have y up and headings
counterclockwise, as ASAM's standards do. The conversion is a mirror, so it is its own inverse.

The reference point of a vehicle is its center here, and the middle of its rear axle in OpenSCENARIO.
"""

from dataclasses import replace
from typing import Final

import numpy as np

from behavexplor.data.array_types import Floats
from behavexplor.data.npc_motion import BEGIN, N_PHASE_COLUMNS, PHASE_SPEED, fill_phases, waypoint_array
from behavexplor.data.road_shape import SineLane
from behavexplor.data.roadmap import Lane, RoadMap
from behavexplor.data.scripted import NPC, Waypoint
from behavexplor.errors import InputError, brief

REAR_AXLE: Final = 0.3  # distance of the rear axle behind the center of a written vehicle, as a share of its length
DIGITS: Final = 9  # decimals of written positions and headings, the resolution of a trace

_MIRROR: Final = np.array([1.0, -1.0, -1.0])
ENVIRONMENT: Final = "behavexplor:environment"  # properties of the file
ENV_CONFIG: Final = "behavexplor:env_config"
SCENARIO: Final = "behavexplor:scenario"
VEHICLES: Final = "behavexplor:vehicles"
ROUTE: Final = "behavexplor:route"  # properties of a vehicle
WAYPOINTS: Final = "behavexplor:waypoints"
RECORDED: Final = "behavexplor:recorded"


def mirrored(pose: Floats) -> Floats:
    """Return poses in the other frame: x [m], y [m] and heading [rad], shape (..., 3)."""
    return np.asarray(pose * _MIRROR)


def mirrored_points(points: Floats) -> Floats:
    """Return points, or vectors, in the other frame, shape (..., 2)."""
    return np.asarray(points * _MIRROR[:2])


def mirrored_lane(lane: Lane) -> Lane:
    """Return a lane in the other frame."""
    other = replace(lane, y=-lane.y, heading=-lane.heading, curvature=-lane.curvature)
    return replace(other, amplitude=-other.amplitude) if isinstance(other, SineLane) else other


def shifted(pose: Floats, ahead: float) -> Floats:
    """Return poses, shape (..., 3), in either frame, whose points are moved along their headings [m]."""
    heading = pose[..., 2]
    moved = pose[..., :2] + ahead * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    return np.concatenate([moved, heading[..., None]], axis=-1)


def waypoint_text(script: NPC) -> str:
    """Return the position [m] and speed [m/s] of each waypoint as a text, from which `read_script` restores them."""
    return ", ".join(f"{waypoint.position!r} {waypoint.speed!r}" for waypoint in script.waypoints)


def read_script(name: str, kind: str, route: str, text: str) -> NPC:
    """Return the scripted vehicle whose waypoints `waypoint_text` has written; `name` is for error messages.

    Raises:
        InputError: if the text does not describe waypoints.
    """
    waypoints = []
    for pair in text.split(","):
        try:
            position, speed = map(float, pair.split())
        except ValueError:
            raise InputError(
                f"{name}: a waypoint is a position [m] and a speed [m/s], separated by a space, got {brief(pair)}"
            ) from None
        waypoints.append(Waypoint(position, speed))
    return NPC(kind, route, tuple(waypoints))


def route_points(npc: NPC, roadmap: RoadMap) -> Floats:
    """Return points of a vehicle's route as they are written, shape (P, 2) [m].

    They are the start and the place where it parks. Points between them, at the ends of lanes and in junctions, would
    belong to several roads.
    """
    route = roadmap.routes[npc.route]
    points = route.pose(np.array([npc.waypoints[0].position, npc.waypoints[-1].position]))[:, :2]
    return np.asarray(np.round(mirrored_points(points), DIGITS) + 0.0)


def speed_profile(npc: NPC) -> Floats:
    """Return the speed at the end of each phase [m/s] and the duration of the phase [s], shape (P, 2).

    In the last phase, of a second, the vehicle stands. Without it, a player may go on with the last deceleration.
    """
    waypoints = waypoint_array(npc)
    phases = np.empty((len(waypoints) + 1, N_PHASE_COLUMNS))
    phases = phases[: fill_phases(waypoints, phases)]
    profile = np.column_stack([phases[1:, PHASE_SPEED], np.diff(phases[:, BEGIN])])
    profile = np.concatenate([profile, [[0.0, 1.0]]])
    return np.asarray(np.round(profile, DIGITS))
