"""Ten-line stand-ins for a simulator with an ADS in it, and traces made by hand."""

from zlib import crc32

import numpy as np

from behavexplor.data.logical import EGO_SIZE, VEHICLE_SIZES
from behavexplor.data.trace import Trace
from behavexplor.envs.functional.intersection_straight import IntersectionStraightEnv

LOGICAL = IntersectionStraightEnv.logical

RATE = 20  # frames per second


def make_trace(ego, npcs=(), *, sizes=None, lines=(), destination=(0.0, 0.0), time=None, route=None):
    """A trace from poses.

    `ego` and each of `npcs` are (T, 3) rows of x, y, heading; velocities are their differences.
    """
    poses = np.stack([np.asarray(pose, dtype=float).reshape(-1, 3) for pose in (ego, *npcs)], axis=1)
    time = np.arange(len(poses)) / RATE if time is None else np.asarray(time, dtype=float)
    velocity = np.gradient(poses[..., :2], time, axis=0) if len(poses) > 1 else np.zeros_like(poses[..., :2])
    return Trace(
        time=time,
        position=poses[..., :2],
        heading=poses[..., 2],
        velocity=velocity,
        size=np.array([EGO_SIZE] * poses.shape[1] if sizes is None else sizes, dtype=float),
        actions=np.zeros((0, 1)),
        action_frame=np.zeros(0, dtype=int),
        route=np.array([[0.0, 0.0], [100.0, 0.0]]) if route is None else route,
        destination=np.array(destination, dtype=float),
        illegal_lines=np.array(lines, dtype=float).reshape(-1, 2, 2),
        end="timeout",
    )


def simulate(scenario, logical=LOGICAL):
    """An ADS that never looks: it follows its route, hurries, dawdles and stops as the scenario's letters tell it."""
    rng = np.random.default_rng(crc32(scenario.to_json().encode()))
    roadmap, time = logical.roadmap, np.arange(rng.integers(300, 900)) / RATE
    speed = np.clip(np.interp(time, np.linspace(0, 45, 10), rng.uniform(-3, 11, 10)), 0, None)
    station = np.minimum(roadmap.ego_start + np.cumsum(speed) / RATE, roadmap.destination + rng.uniform(-2, 2))
    poses = [roadmap.ego_route.pose(station)]
    for npc in scenario.npcs:
        positions = [point.position for point in npc.waypoints]
        along = np.interp(time, np.linspace(0, 20, len(positions)), positions)
        poses.append(roadmap.routes[npc.route].pose(along))
    sizes = [EGO_SIZE, *(VEHICLE_SIZES[npc.type] for npc in scenario.npcs)]
    stations = roadmap.ego_route.polyline(roadmap.ego_start, roadmap.destination + 10)
    return make_trace(
        poses[0],
        poses[1:],
        sizes=sizes,
        lines=roadmap.illegal_lines,
        destination=roadmap.destination_point,
        route=stations,
    )
