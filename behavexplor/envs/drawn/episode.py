"""The record of one episode of a highway-env environment, frame by frame."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.vehicle.objects import RoadObject
from numpy.typing import NDArray

from behavexplor.data.geometry import box_corners, box_distance
from behavexplor.data.trace import ABSENT, ARRIVED, CRASHED, OFF_ROAD, Trace
from behavexplor.envs.drawn.course import LaneIndex

Floats = NDArray[np.float64]

X, Y, HEADING, SPEED, SLIP = range(5)  # columns of a row of `Frame.rows`


@dataclass(frozen=True, slots=True)
class Frame:
    """What is on the road at one moment.

    Attributes:
        things: the number of each vehicle and obstacle, the ego's first.
        rows: x and y [m], heading [rad], speed [m/s] and slip angle [rad] of each of them, shape (n, 5).
        crashed: whether each of them has crashed, shape (n,).
        lane: the ego's lane.
        is_off_road: whether the ego is beside its lane.
    """

    things: Sequence[int]
    rows: Floats
    crashed: NDArray[np.bool_]
    lane: LaneIndex
    is_off_road: bool


@dataclass
class EpisodeRecord:
    """The frames and decisions of an episode.

    Attributes:
        period: time between two frames [s].
        sizes: length and width of each thing by its number [m].
        frames: the frames.
        actions: the commands.
        action_frames: the frame in which each command was given.
        arrivals: whether the ego had arrived after each decision; empty if the environment has no destination.
    """

    period: float
    sizes: dict[int, tuple[float, float]] = field(default_factory=dict)
    frames: list[Frame] = field(default_factory=list)
    actions: list[Floats] = field(default_factory=list)
    action_frames: list[int] = field(default_factory=list)
    arrivals: list[bool] = field(default_factory=list)

    def decide(self, action: Any) -> None:
        """Record a command that is given at the latest frame."""
        self.actions.append(np.atleast_1d(np.asarray(action, dtype=np.float64)))
        self.action_frames.append(len(self.frames) - 1)

    def trace(self, *, end: str, route: Floats, destination: Floats | None, leaves_road: bool) -> Trace:
        """Return the trace of the episode.

        Args:
            end: kind of end.
            route: the ego's route.
            destination: the ego's destination; None for the end of the route.
            leaves_road: whether it means something in this environment that the ego leaves the road.
        """
        numbers = list(self.sizes)
        column = {number: i for i, number in enumerate(numbers)}
        count = len(self.frames)
        position = np.full((count, len(numbers), 2), ABSENT)
        heading, speed, slip = np.zeros((3, count, len(numbers)))
        present = np.zeros((count, len(numbers)), dtype=bool)
        for i, frame in enumerate(self.frames):
            at = [column[number] for number in frame.things]
            position[i, at], heading[i, at] = frame.rows[:, [X, Y]], frame.rows[:, HEADING]
            speed[i, at], slip[i, at] = frame.rows[:, SPEED], frame.rows[:, SLIP]
            present[i, at] = True
        course = heading + slip
        signals = {CRASHED: np.array([frame.crashed[0] for frame in self.frames], dtype=np.float64)}
        if leaves_road:
            signals[OFF_ROAD] = np.array([frame.is_off_road for frame in self.frames], dtype=np.float64)
        if self.arrivals:
            signals[ARRIVED] = self._arrived(count)
        return Trace(
            time=np.arange(count, dtype=np.float64) * self.period,
            position=position,
            heading=heading,
            velocity=speed[..., None] * np.stack([np.cos(course), np.sin(course)], axis=-1),
            size=np.array([self.sizes[number] for number in numbers]),
            actions=np.array(self.actions) if self.actions else np.zeros((0, 1)),
            action_frame=np.array(self.action_frames, dtype=np.int64),
            route=route,
            destination=route[-1] if destination is None else destination,
            illegal_lines=np.zeros((0, 2, 2)),
            end=end,
            signals=signals,
            present=present,
            partner=column.get(self._partner(), -1),
        )

    def _arrived(self, count: int) -> Floats:
        arrived = np.zeros(count)
        ends = [*self.action_frames[1:], count - 1]
        for begin, end, has_arrived in zip(self.action_frames, ends, self.arrivals, strict=True):
            arrived[begin + 1 : end + 1] = has_arrived
            arrived[end] = has_arrived
        return arrived

    def _partner(self) -> int:
        """Return the number of the thing with which the ego crashed; -1 without a crash.

        highway-env does not tell it. It is the nearest of those that have crashed by the frame of the ego's crash.
        """
        crash = next((frame for frame in self.frames if frame.crashed[0]), None)
        if crash is None:
            return -1
        candidates = 1 + np.flatnonzero(crash.crashed[1:])
        if not len(candidates):
            return -1
        size = np.array([self.sizes[number] for number in crash.things])
        boxes = box_corners(crash.rows[:, [X, Y]], crash.rows[:, HEADING], size)
        gaps = box_distance(boxes[:1], boxes[candidates])
        return crash.things[int(candidates[gaps.argmin()])]


class Watch:
    """Watches a highway-env environment, and records every frame of its episodes."""

    def __init__(self) -> None:
        self._numbers: dict[int, int] = {}
        self._things: list[RoadObject] = []  # keeps the objects alive, because their identity is the key
        self.record = EpisodeRecord(1.0)

    def begin(self, env: AbstractEnv) -> None:
        """Begin the record of an episode, after a reset of the environment."""
        self._numbers, self._things = {}, []
        self.record = EpisodeRecord(1 / env.config["simulation_frequency"])
        self._look(env)
        road: Any = env.road
        step = road.step

        def watched(dt: float) -> None:
            step(dt)
            self._look(env)

        road.step = watched

    def _look(self, env: AbstractEnv) -> None:
        ego = env.vehicle
        solid = [thing for thing in env.road.objects if thing.solid and thing.collidable]
        things = [ego, *(thing for thing in [*env.road.vehicles, *solid] if thing is not ego)]
        numbers = [self._number(thing) for thing in things]
        self.record.frames.append(
            Frame(
                things=numbers,
                rows=np.array([_row(thing) for thing in things]),
                crashed=np.array([bool(thing.crashed) for thing in things]),
                lane=ego.lane_index,
                is_off_road=not ego.on_road,
            )
        )

    def _number(self, thing: RoadObject) -> int:
        number = self._numbers.setdefault(id(thing), len(self._things))
        if number == len(self._things):
            self._things.append(thing)
            self.record.sizes[number] = (float(thing.LENGTH), float(thing.WIDTH))
        return number


def _row(thing: RoadObject) -> tuple[float, float, float, float, float]:
    steering = getattr(thing, "action", {}).get("steering", 0.0)
    slip = float(np.arctan(0.5 * np.tan(steering))) if steering else 0.0
    x, y = thing.position
    return float(x), float(y), float(thing.heading), float(getattr(thing, "speed", 0.0)), slip
