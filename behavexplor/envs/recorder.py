"""The record of an episode while it runs, and the questions that its end and its reward ask of it."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from highway_env.vehicle.kinematics import Vehicle
from numpy.typing import NDArray

from behavexplor.envs.npc import HEADING, SPEED, X, Y
from behavexplor.geometry import box_corners, boxes_overlap
from behavexplor.roadmap import RoadMap
from behavexplor.trace import Trace

Floats = NDArray[np.float64]


class Recorder:
    """Everything that goes into the trace of one episode.

    Args:
        roadmap: the place.
        time: of the simulation's steps, shape (T,) [s].
        motion: the NPCs' motion table at these times, shape (T, n_npcs, 5).
        sizes: length and width of the ego and of every NPC [m].
    """

    def __init__(self, roadmap: RoadMap, time: Floats, motion: Floats, sizes: Sequence[tuple[float, float]]) -> None:
        self._roadmap = roadmap
        self._time = time
        self._motion = motion
        self._sizes = np.array(sizes)
        self._radii = np.hypot(*self._sizes.T) / 2
        self._ego: list[tuple[float, float, float, float, float]] = []
        self._actions: list[Floats] = []
        self._action_frames: list[int] = []
        self._standing = 0

    def frame(self, ego: Vehicle) -> None:
        """Record the ego after a step. Its velocity is that of its centre: the slip of the bicycle model included."""
        slip = np.arctan(0.5 * np.tan(ego.action["steering"]))
        course = ego.heading + slip
        x, y = ego.position
        self._ego.append((x, y, ego.heading, ego.speed * np.cos(course), ego.speed * np.sin(course)))

    def action(self, action: Any) -> None:
        """Record a command, given at the latest frame."""
        self._actions.append(np.atleast_1d(np.asarray(action, dtype=np.float64)))
        self._action_frames.append(len(self._ego) - 1)

    def collided(self) -> bool:
        """Whether the ego's box touches an NPC's in the latest frame."""
        frame = len(self._ego) - 1
        x, y, heading, *_ = self._ego[-1]
        others = self._motion[frame]
        near = np.hypot(others[:, X] - x, others[:, Y] - y) <= self._radii[0] + self._radii[1:]
        if not near.any():
            return False
        box = box_corners(np.array([x, y]), np.array(heading), self._sizes[0])
        boxes = box_corners(others[near][:, [X, Y]], others[near, HEADING], self._sizes[1:][near])
        return bool(boxes_overlap(box, boxes).any())

    def standing_frames(self, speed: float) -> int:
        """For how many frames up to the latest the ego has been slower than `speed` [m/s]; ask in every frame."""
        *_, vx, vy = self._ego[-1]
        self._standing = self._standing + 1 if np.hypot(vx, vy) < speed else 0
        return self._standing

    def progress(self) -> float:
        """How much nearer the latest decision has brought the ego to its destination [m]."""
        x, y = self._roadmap.destination_point
        before, now = self._ego[self._action_frames[-1]], self._ego[-1]
        return float(np.hypot(before[0] - x, before[1] - y) - np.hypot(now[0] - x, now[1] - y))

    def trace(self, end: str) -> Trace:
        """The trace of the episode that has ended."""
        roadmap = self._roadmap
        frames = len(self._ego)
        ego = np.array(self._ego)
        npcs = self._motion[:frames]
        velocity = npcs[..., SPEED, None] * np.stack([np.cos(npcs[..., HEADING]), np.sin(npcs[..., HEADING])], -1)
        return Trace(
            time=self._time[:frames],
            position=np.concatenate([ego[:, None, :2], npcs[..., [X, Y]]], axis=1),
            heading=np.concatenate([ego[:, None, 2], npcs[..., HEADING]], axis=1),
            velocity=np.concatenate([ego[:, None, 3:], velocity], axis=1),
            size=self._sizes,
            actions=np.array(self._actions),
            action_frame=np.array(self._action_frames),
            route=roadmap.ego_route.polyline(roadmap.ego_start, roadmap.ego_route.length),
            destination=roadmap.destination_point,
            illegal_lines=roadmap.illegal_lines,
            end=end,
        )
