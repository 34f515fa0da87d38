"""Build the trace of an episode from its record."""

import numpy as np
from numpy.typing import NDArray

from behavexplor.data.npc_motion import HEADING, SPEED, X, Y
from behavexplor.data.roadmap import RoadMap
from behavexplor.data.trace import Trace

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def episode_trace(
    roadmap: RoadMap,
    *,
    time: Floats,
    ego: Floats,
    motion: Floats,
    sizes: Floats,
    actions: Floats,
    action_frames: Ints,
    end: str,
) -> Trace:
    """Build the trace of a finished episode of T frames.

    Args:
        roadmap: the map.
        time: time of each frame, shape (T,) [s].
        ego: x [m], y [m], heading [rad] and velocity (vx, vy) [m/s] of the ego, shape (T, 5).
        motion: the NPCs' motion table, shape (T, n_npcs, 5).
        sizes: length and width of the ego and of every NPC, shape (1 + n_npcs, 2) [m].
        actions: the commands, shape (D, A).
        action_frames: frame at which each command was given, shape (D,).
        end: kind of end, one of `behavexplor.data.trace.ENDS`.
    """
    moved = np.empty((len(time), len(sizes), ego.shape[1]))  # the columns of `ego`, for every vehicle
    moved[:, 0] = ego
    for column, moving in enumerate((X, Y, HEADING)):
        moved[:, 1:, column] = motion[..., moving]
    moved[:, 1:, 3] = motion[..., SPEED] * np.cos(motion[..., HEADING])
    moved[:, 1:, 4] = motion[..., SPEED] * np.sin(motion[..., HEADING])
    return Trace(
        time=time,
        position=moved[..., :2],
        heading=moved[..., 2],
        velocity=moved[..., 3:],
        size=sizes,
        actions=actions,
        action_frame=action_frames,
        route=roadmap.ego_line,
        destination=roadmap.destination_point,
        illegal_lines=roadmap.illegal_lines,
        end=end,
    )
