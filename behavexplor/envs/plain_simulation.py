"""Scripted episodes on highway-env's own objects, where the compiled engine does not support them; and pictures."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pygame
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.envs.common.graphics import EnvViewer, ObservationGraphics
from highway_env.road.graphics import RoadGraphics, WorldSurface
from highway_env.road.road import Road
from highway_env.vehicle.kinematics import Vehicle

from behavexplor.data.array_types import Floats
from behavexplor.data.conventions import (
    ARRIVAL_DISTANCE,
    PASSED_DISTANCE,
    STANDING_SPEED,
    STANDSTILL_TIME,
    VEHICLE_SIZES,
    is_rear_end,
    wrapped,
)
from behavexplor.data.geometry import box_corners, boxes_overlap, segment_meets_box
from behavexplor.data.npc_motion import HEADING, SPEED, X, Y, motion_table
from behavexplor.data.roadmap import DOUBLE_YELLOW, RoadMap
from behavexplor.data.scripted import ScriptedScenario
from behavexplor.data.scripted_logical import ScriptedLogicalScenario
from behavexplor.data.trace import ENDS, Trace
from behavexplor.envs.road_objects import ScriptedVehicle, place_ego, road_network
from behavexplor.envs.tasks.scripted_outcome import POSE, TERMS, episode_trace, reward_terms
from behavexplor.envs.tasks.scripted_slots import RUN, RUNNING

YELLOW = (240, 190, 40)
CURB = (225, 225, 225)
DESTINATION = EGO = (80, 220, 100)
NPCS = ((240, 120, 90), (110, 170, 250), (220, 140, 230), (120, 215, 215), (240, 205, 110), (190, 190, 190))
LINE_WIDTH = 0.15  # [m]
DOUBLE_LINE_GAP = 0.15  # distance of either line from the middle [m]


class Recorder:
    """Recorder of everything that goes into the trace of one episode."""

    def __init__(self, roadmap: RoadMap, time: Floats, motion: Floats, sizes: Sequence[tuple[float, float]]) -> None:
        self._roadmap = roadmap
        self._time = time  # of the simulation steps, shape (T,) [s]
        self._motion = motion  # the NPCs' motion table at these times, shape (T, n_npcs, 5)
        self._sizes = np.array(sizes)  # length and width, the ego's first, shape (1 + n_npcs, 2) [m]
        self._radii = np.hypot(*self._sizes.T) / 2
        self._ego: list[tuple[float, float, float, float, float]] = []  # a `POSE` in each frame
        self._actions: list[Floats] = []
        self._action_frames: list[int] = []
        self._standing = 0  # frames for which the ego has stood still
        self._line_frame: int | None = None  # in which the ego first touched an illegal line
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
        """Compute the terms of the reward for the latest decision; see `behavexplor.envs.tasks.scripted_outcome`."""
        decided = self._action_frames[-1]
        before, now = self._ego[decided], self._ego[-1]
        route = self._roadmap.ego_route
        elapsed = float(self._time[len(self._ego) - 1] - self._time[decided])
        npcs = self.touched_npcs() if end == "collision" else []
        run = np.zeros(1, RUN)  # as one slot of the compiled engine, so that both compute the same reward
        run["progress"] = route.project(*now[:2])[0] - route.project(*before[:2])[0]
        run["mean_acceleration"] = (math.hypot(*now[3:]) - math.hypot(*before[3:])) / elapsed
        run["touched"] = self._line_frame is not None and self._line_frame > decided
        run["rear_end"] = bool(npcs) and all(self._struck_by(npc) for npc in npcs)
        run["end"] = RUNNING if end is None else ENDS.index(end)
        terms = reward_terms(weights, run, active=np.ones(1, dtype=bool))
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


class PlainSimulation(AbstractEnv):  # type: ignore[misc]
    """The base of `DrivingEnv`: it plays back scenarios on highway-env's own objects.

    If the engine simulates, these objects only show the episode.
    """

    logical: ScriptedLogicalScenario
    config: dict[str, Any]
    action_type: Any  # highway-env has no annotations
    _recorder: Recorder
    _end: str | None = None  # kind of end, one of `ENDS`; None while the episode runs
    _terms: dict[str, float]  # terms of the reward for the latest decision

    def _place(self, scenario: ScriptedScenario) -> None:
        """Put the ego and the NPCs of a scenario on a new road, and begin their record."""
        roadmap = self.logical.roadmap
        network = road_network(roadmap)
        self.road = Road(network, np_random=self.np_random)
        ego = place_ego(
            self.action_type.vehicle_class, self.road, roadmap.start_pose, network.indexes(roadmap.ego_route)
        )
        n_frames = int(self.config["duration"] * self.config["simulation_frequency"]) + 1
        time = np.arange(n_frames + 1) / self.config["simulation_frequency"]
        motion = motion_table(scenario, roadmap, time)
        npcs = [
            ScriptedVehicle(
                self.road, VEHICLE_SIZES[npc.type], motion[:, i], network.indexes(roadmap.routes[npc.route])
            )
            for i, npc in enumerate(scenario.npcs)
        ]
        self.controlled_vehicles = [ego]
        self.road.vehicles = [ego, *npcs]
        self._recorder = Recorder(roadmap, time, motion, [(v.LENGTH, v.WIDTH) for v in self.road.vehicles])
        self._recorder.frame(ego)

    def _simulate(self, action: Any = None) -> None:
        """Simulate until the next decision, or until the episode ends."""
        self._recorder.action(action)
        self.action_type.act(action)
        substeps = self.config["simulation_frequency"] // self.config["policy_frequency"]
        for substep in range(substeps):
            self.road.act()
            self.road.step(1 / self.config["simulation_frequency"])
            self.steps += 1
            self._recorder.frame(self.vehicle)
            self._end = self._find_end()
            if self._end is not None:
                break
            if substep < substeps - 1:
                self._automatic_rendering()
        self.enable_auto_render = False
        self._terms = self._recorder.reward_terms(self.config["reward"], self._end)

    def _find_end(self) -> str | None:
        roadmap = self.logical.roadmap
        if self._recorder.touched_npcs():
            return "collision"
        gap = self.vehicle.position - roadmap.destination_point
        if np.hypot(*gap) <= ARRIVAL_DISTANCE:
            return "arrived"
        if gap @ roadmap.destination_direction > PASSED_DISTANCE:
            return "passed"
        if self._recorder.standing_frames(STANDING_SPEED) >= STANDSTILL_TIME * self.config["simulation_frequency"]:
            return "standstill"
        if self.steps >= self.config["duration"] * self.config["simulation_frequency"]:
            return "timeout"
        return None

    def _trace(self, end: str) -> Trace:
        return self._recorder.trace(end)


class MapViewer(EnvViewer):  # type: ignore[misc]
    """Viewer that draws the road, then the illegal lines, the routes and the destination, then the vehicles."""

    def display(self) -> None:
        """Draw the current state, and show it on the screen if there is one."""
        if not self.enabled:
            return
        surface = self.sim_surface
        surface.move_display_window_to(self.window_position())
        RoadGraphics.display(self.env.road, surface)
        self._draw_lines(surface)
        self._draw_routes(surface)
        RoadGraphics.display_traffic(
            self.env.road, surface, simulation_frequency=self.env.config["simulation_frequency"], offscreen=True
        )
        ObservationGraphics.display(self.env.observation_type, surface)
        if not self.offscreen:
            self.screen.blit(surface, (0, 0))
            if self.env.config["real_time_rendering"]:
                self.clock.tick(self.env.config["simulation_frequency"])
            pygame.display.flip()

    def _draw_lines(self, surface: WorldSurface) -> None:
        roadmap = self.env.logical.roadmap
        for (start, end), kind in zip(roadmap.illegal_lines, roadmap.line_kinds, strict=True):
            if kind != DOUBLE_YELLOW:
                _draw_line(surface, CURB, start, end)
                continue
            along = (end - start) / np.hypot(*(end - start))
            aside = DOUBLE_LINE_GAP * np.array([-along[1], along[0]])
            for shift in (aside, -aside):
                _draw_line(surface, YELLOW, start + shift, end + shift)

    def _draw_routes(self, surface: WorldSurface) -> None:
        roadmap = self.env.logical.roadmap
        self.env.vehicle.color = EGO
        for i, npc in enumerate(self.env.scenario.npcs):
            color = NPCS[i % len(NPCS)]
            self.env.road.vehicles[1 + i].color = color
            end = npc.waypoints[-1].position
            points = roadmap.routes[npc.route].polyline(npc.waypoints[0].position, end)
            pygame.draw.lines(surface, color, False, [surface.vec2pix(point) for point in points])
        points = [roadmap.start_pose[:2], *roadmap.ego_route.polyline(roadmap.ego_start, roadmap.destination)[1:]]
        pygame.draw.lines(surface, EGO, False, [surface.vec2pix(point) for point in points])
        target = surface.vec2pix(roadmap.destination_point)
        pygame.draw.circle(surface, DESTINATION, target, max(surface.pix(1.0), 3), width=2)


def _draw_line(surface: WorldSurface, color: tuple[int, int, int], start: Floats, end: Floats) -> None:
    width = max(surface.pix(LINE_WIDTH), 1)
    pygame.draw.line(surface, color, surface.vec2pix(start), surface.vec2pix(end), width)
