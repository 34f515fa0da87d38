"""Synthetic traces: a stand-in for a simulator with a driving system in it."""

from typing import Any
from zlib import crc32

import numpy as np

from behavexplor.data.conventions import EGO_SIZE, VEHICLE_SIZES
from behavexplor.data.scenario import LogicalScenario
from behavexplor.data.scripted_logical import require_scripted
from behavexplor.data.trace import Trace

RATE = 20  # frames per second


def synthetic_trace(scenario: Any, logical: LogicalScenario) -> Trace:
    """Return the trace of an ego that follows its route in a scenario of `logical` and never looks.

    Its speed is drawn from the text of the scenario, so that equal scenarios have equal traces. The NPCs follow their
    routes through their waypoints.

    Raises:
        InputError: if its vehicles are not scripted.
    """
    roadmap = require_scripted(logical, "A synthetic trace").roadmap
    rng = np.random.default_rng(crc32(scenario.to_json().encode()))
    time = np.arange(rng.integers(300, 900)) / RATE
    speed = np.clip(np.interp(time, np.linspace(0, 45, 10), rng.uniform(-3, 11, 10)), 0, None)
    station = np.minimum(roadmap.ego_start + np.cumsum(speed) / RATE, roadmap.destination + rng.uniform(-2, 2))
    poses = [roadmap.ego_route.pose(station)]
    for npc in scenario.npcs:
        positions = [point.position for point in npc.waypoints]
        along = np.interp(time, np.linspace(0, 20, len(positions)), positions)
        poses.append(roadmap.routes[npc.route].pose(along))
    motion = np.stack([np.asarray(pose, dtype=float).reshape(-1, 3) for pose in poses], axis=1)
    return Trace(
        time=time,
        position=motion[..., :2],
        heading=motion[..., 2],
        velocity=np.gradient(motion[..., :2], time, axis=0),
        size=np.array([EGO_SIZE, *(VEHICLE_SIZES[npc.type] for npc in scenario.npcs)], dtype=float),
        actions=np.zeros((0, 1)),
        action_frame=np.zeros(0, dtype=int),
        route=roadmap.ego_route.polyline(roadmap.ego_start, roadmap.destination + 10),
        destination=np.array(roadmap.destination_point, dtype=float),
        illegal_lines=np.array(roadmap.illegal_lines, dtype=float).reshape(-1, 2, 2),
        end="timeout",
    )
