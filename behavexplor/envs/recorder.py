"""The record of a running episode, and the quantities that its end and its reward are computed from."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from highway_env.vehicle.kinematics import Vehicle
from numpy.typing import NDArray

from behavexplor.data.conventions import is_rear_end, wrapped
from behavexplor.data.geometry import box_corners, boxes_overlap, segment_meets_box
from behavexplor.data.npc_motion import HEADING, SPEED, X, Y
from behavexplor.data.roadmap import RoadMap
from behavexplor.data.trace import ENDS, Trace
from behavexplor.envs.tasks.scripted_reward import TERMS, reward_terms
from behavexplor.envs.tasks.scripted_slots import RUN, RUNNING
from behavexplor.envs.tasks.scripted_trace import POSE, episode_trace

Floats = NDArray[np.float64]


class Recorder:
    """Recorder of everything that goes into the trace of one episode.

    Args:
        roadmap: the map.
        time: times of the simulation steps, shape (T,) [s].
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
        self._line_frame: int | None = None
        self._lines = _line_columns(roadmap.illegal_lines)

    def frame(self, ego: Vehicle) -> None:
        """Record the ego after a step. Its velocity is that of its center, so it includes the bicycle model's slip."""
        slip = math.atan(0.5 * math.tan(ego.action["steering"]))
        course = ego.heading + slip
        x, y = ego.position
        self._ego.append((x, y, ego.heading, ego.speed * math.cos(course), ego.speed * math.sin(course)))
        if self._line_frame is None and self._touches_line():
            self._line_frame = len(self._ego) - 1

    def action(self, action: Any) -> None:
        """Record a command that is given at the latest frame."""
        self._actions.append(np.atleast_1d(np.asarray(action, dtype=np.float64)))
        self._action_frames.append(len(self._ego) - 1)

    def _touches_line(self) -> bool:
        """Return whether the ego's box touches an illegal line in the latest frame."""
        x, y, heading, *_ = self._ego[-1]
        cos, sin = math.cos(heading), math.sin(heading)
        nx, ny, offset, middle_x, middle_y, half = self._lines
        length, width = self._sizes[0]
        reach = (np.abs(nx * cos + ny * sin) * length + np.abs(ny * cos - nx * sin) * width) / 2
        near = np.abs(nx * x + ny * y - offset) <= reach
        near &= np.hypot(middle_x - x, middle_y - y) <= half + self._radii[0]
        if not near.any():
            return False
        box = box_corners(np.array([x, y]), np.array(heading), self._sizes[0])
        return bool(segment_meets_box(box, self._roadmap.illegal_lines[near]).any())

    def touched_npcs(self) -> list[int]:
        """Return the indices of the NPCs that the ego's box touches in the latest frame."""
        x, y, heading, *_ = self._ego[-1]
        others = self._motion[len(self._ego) - 1]
        gaps = np.hypot(others[:, X] - x, others[:, Y] - y)
        near = np.flatnonzero(gaps <= self._radii[0] + self._radii[1:])
        if not len(near):
            return []
        box = box_corners(np.array([x, y]), np.array(heading), self._sizes[0])
        boxes = box_corners(others[near][:, [X, Y]], others[near, HEADING], self._sizes[1:][near])
        touched: list[int] = near[boxes_overlap(box, boxes)].tolist()
        return touched

    def standing_frames(self, speed: float) -> int:
        """Count the consecutive frames, up to the latest, in which the ego was slower than `speed` [m/s].

        Call this exactly once in every frame.
        """
        *_, vx, vy = self._ego[-1]
        self._standing = self._standing + 1 if np.hypot(vx, vy) < speed else 0
        return self._standing

    def reward_terms(self, weights: Mapping[str, float], end: str | None) -> dict[str, float]:
        """Compute the terms of the reward for the latest decision; see `behavexplor.envs.tasks.scripted_reward`."""
        decided = self._action_frames[-1]
        before, now = self._ego[decided], self._ego[-1]
        route = self._roadmap.ego_route
        elapsed = float(self._time[len(self._ego) - 1] - self._time[decided])
        npcs = self.touched_npcs() if end == "collision" else []
        run = np.zeros(1, RUN)
        run["progress"] = route.project(*now[:2])[0] - route.project(*before[:2])[0]
        run["mean_acceleration"] = (math.hypot(*now[3:]) - math.hypot(*before[3:])) / elapsed
        run["touched"] = self._line_frame is not None and self._line_frame > decided
        run["rear_end"] = bool(npcs) and all(self._struck_by(npc) for npc in npcs)
        run["end"] = RUNNING if end is None else ENDS.index(end)
        terms = reward_terms(weights, run, np.ones(1, dtype=bool))
        return dict(zip(TERMS, terms[:, 0].tolist(), strict=True))

    def _struck_by(self, npc: int) -> bool:
        x, y, heading, vx, vy = self._ego[-1]
        row = self._motion[len(self._ego) - 1, npc]
        ahead = (row[X] - x) * math.cos(heading) + (row[Y] - y) * math.sin(heading)
        turned = wrapped(row[HEADING] - heading)
        return is_rear_end(ahead, turned, self._sizes[0][0], math.hypot(vx, vy), row[SPEED])

    def trace(self, end: str) -> Trace:
        """Return the trace of the finished episode."""
        frames = len(self._ego)
        return episode_trace(
            self._roadmap,
            time=self._time[:frames],
            ego=np.array(self._ego, dtype=POSE),
            motion=self._motion[:frames],
            sizes=self._sizes,
            actions=np.array(self._actions),
            action_frames=np.array(self._action_frames),
            end=end,
        )


def _line_columns(lines: Floats) -> Floats:
    """Compute the unit normals of segments, their distances from the origin, middles and half lengths, (6, L)."""
    along = lines[:, 1] - lines[:, 0]
    length = np.hypot(along[:, 0], along[:, 1])
    nx, ny = -along[:, 1] / length, along[:, 0] / length
    middle = lines.mean(1)
    return np.stack([nx, ny, nx * middle[:, 0] + ny * middle[:, 1], *middle.T, length / 2])
