"""The record of one episode of a highway-env environment, and the trace that is made of it.

Beside a crash, highway-env's environments themselves count as a failure:

| environment | R2: off the road | R3: not arrived |
|---|---|---|
| highway, merge, exit, racetrack | `on_road` is false | exit: `is_success` is false at the end |
| intersection | | `has_arrived` is false |
| roundabout | | the ego never entered the circle |
| parking | | `is_success` is false at the end |
| two-way, u-turn, lane-keeping | | |

Where nothing is said, it means nothing: in junctions, a vehicle that drives well leaves its lane for some frames, and
on a two-way road it may overtake. A subclass counts as its parent does.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.envs.exit_env import ExitEnv
from highway_env.envs.highway_env import HighwayEnv
from highway_env.envs.intersection_env import IntersectionEnv
from highway_env.envs.merge_env import MergeEnv, MergeGenericEnv
from highway_env.envs.racetrack_env import RacetrackEnv
from highway_env.envs.roundabout_env import RoundaboutEnv
from highway_env.road.road import RoadNetwork
from highway_env.vehicle.objects import RoadObject

from behavexplor.data.array_types import Array, Bools, Floats, Ints
from behavexplor.data.geometry import box_corners, box_distance
from behavexplor.data.trace import (
    ABSENT,
    ARRIVED,
    CHANGING,
    CRASHED,
    OFF_ROAD,
    PARTNER,
    PARTNER_LANES,
    WAY,
    WRECKS,
    Trace,
)
from behavexplor.envs.engine.frame_log import THING
from behavexplor.envs.engine.lane_network import lane_indexes
from behavexplor.envs.engine.state import NO_LANE, Records
from behavexplor.envs.highway.course import LaneIndex, ego_route
from behavexplor.envs.highway.driven_lanes import lane_changes, lane_table, partner_places, places

_NAMES: Final = ("x", "y", "heading", "speed", "lane", "target_lane")  # fields of `THING`
_WITH_BORDERS: Final = (HighwayEnv, MergeEnv, MergeGenericEnv, ExitEnv, RacetrackEnv)


class Frame(NamedTuple):
    """What is on the road at one moment."""

    things: Records  # the vehicles and obstacles, shape (n,) of `behavexplor.envs.engine.frame_log.THING`
    ego: int  # the ego's place among them
    is_on_road: bool  # highway-env's `on_road` of the ego


class EpisodeRecord:
    """The frames and decisions of an episode."""

    def __init__(self, env: AbstractEnv, route: Sequence[LaneIndex]) -> None:
        self._route = tuple(route)
        self._leaving_matters = leaving_matters(env)
        self._must_move_on = must_move_on(env)
        self.frames: list[Frame] = []
        self.sizes: dict[int, tuple[float, float]] = {}
        self._period = 1 / env.config["simulation_frequency"]
        self._actions: list[Floats] = []
        self._action_frames: list[int] = []
        self._arrivals: list[tuple[int, bool]] = []  # whether the ego has arrived, with the frame in which it is said

    def decide(self, action: Any) -> None:
        """Record a command that is given at the latest frame."""
        self._actions.append(np.atleast_1d(np.asarray(action, dtype=np.float64)))
        self._action_frames.append(len(self.frames) - 1)

    def judge(self, arrived: bool | None) -> None:
        """Record whether the ego has arrived after a decision; None if the environment has no destination."""
        if arrived is not None:
            self._arrivals.append((len(self.frames) - 1, arrived))

    def trace(self, network: RoadNetwork, *, terminated: bool) -> Trace:
        """Return the trace of the episode, which ends with the frame in which the ego crashes, if it does."""
        things = [frame.things for frame in self.frames]
        ego = int(things[0]["number"][self.frames[0].ego])
        numbers = np.array([ego, *(number for number in self.sizes if number != ego)])
        column = np.zeros(numbers.max() + 1, dtype=np.intp)
        column[numbers] = np.arange(len(numbers))
        frame = np.repeat(np.arange(len(things)), [len(seen) for seen in things])
        every = np.concatenate(things, dtype=THING)
        at = (frame, column[every["number"]])
        motion = np.zeros((4, len(things), len(numbers)))
        motion[:2] = ABSENT
        lanes = np.zeros((2, len(things), len(numbers)), dtype=np.int64)
        present, crashed = np.zeros((2, len(things), len(numbers)), dtype=bool)
        for values, name in zip((*motion, *lanes), _NAMES, strict=True):
            values[at] = every[name]
        present[at], crashed[at] = True, every["crashed"]
        position, heading, speed = np.moveaxis(motion[:2], 0, -1), motion[2], motion[3]
        size = np.array([self.sizes[number] for number in numbers.tolist()])
        count = int(crashed[:, 0].argmax()) + 1 if crashed[:, 0].any() else len(things)
        indexes = lane_indexes(network)
        driven = [indexes[lane] for lane in lanes[0, :, 0].tolist()]
        route = ego_route(network, self._route, driven, position[:, 0])
        partner = _partner(position, heading, size, crashed)
        trace = Trace(
            time=np.arange(len(things), dtype=np.float64) * self._period,
            position=position,
            heading=heading,
            velocity=speed[..., None] * np.stack([np.cos(heading), np.sin(heading)], axis=-1),
            size=size,
            actions=np.array(self._actions) if self._actions else np.zeros((0, 1)),
            action_frame=np.array(self._action_frames, dtype=np.int64),
            route=route,
            destination=route[-1],
            illegal_lines=np.zeros((0, 2, 2)),
            end=self._end(terminated=terminated),
            signals={
                **self._signals(crashed[:, 0], driven, count),
                **_lane_signals(network, lanes, heading, partner),
                **({WRECKS: crashed.astype(np.float64)} if crashed[:, 1:].any() else {}),
            },
            present=present,
            partner=partner,
        )
        return trace.until(count, "collision") if crashed[:, 0].any() else trace

    def _signals(self, crashed: Bools, driven: Sequence[LaneIndex], count: int) -> dict[str, Floats]:
        """Return the signals of the requirements. An arrival counts if it is the last thing that is said of it."""
        signals = {CRASHED: crashed.astype(np.float64)}
        if self._leaving_matters:
            signals[OFF_ROAD] = np.array([not frame.is_on_road for frame in self.frames], dtype=np.float64)
        if self._arrivals:
            signals[ARRIVED] = np.zeros(len(self.frames))
            for frame, arrived in [said for said in self._arrivals if said[0] < count][-1:]:
                signals[ARRIVED][frame] = arrived
        elif self._must_move_on:
            entry = {driven[0][:2], *(lane[:2] for lane in self._route[:2])}
            signals[ARRIVED] = np.array([lane[:2] not in entry for lane in driven], dtype=np.float64)
        return signals

    def _end(self, *, terminated: bool) -> str:
        """Return the kind of end of an episode without a crash, one of `behavexplor.data.trace.ENDS`."""
        if self._arrivals and self._arrivals[-1][1]:
            return "arrived"
        if not terminated:
            return "timeout"
        return "ended" if self.frames[-1].is_on_road else "off-road"


class Watch:
    """Watches a highway-env environment that has just been reset, and records every frame of an episode."""

    def __init__(self, env: AbstractEnv) -> None:
        self._things: dict[int, tuple[int, RoadObject]] = {}  # keeps the objects alive, since their identity is the key
        self.record = EpisodeRecord(env, getattr(env.vehicle, "route", None) or ())
        self._look(env)
        road: Any = env.road
        step = road.step

        def watched(dt: float) -> None:
            step(dt)
            self._look(env)

        road.step = watched

    def _look(self, env: AbstractEnv) -> None:
        vehicles, ego = env.road.vehicles, env.vehicle
        obstacles = [thing for thing in env.road.objects if thing.solid and thing.collidable]
        lanes = {index: lane for lane, index in enumerate(lane_indexes(env.road.network))}
        rows = [*(self._row(thing, lanes) for thing in vehicles), *(self._row(thing, {}) for thing in obstacles)]
        self.record.frames.append(Frame(np.array(rows, dtype=THING), vehicles.index(ego), bool(ego.on_road)))

    def _row(
        self, thing: RoadObject, lanes: dict[LaneIndex, int]
    ) -> tuple[int, float, float, float, float, int, int, bool]:
        number, _ = self._things.setdefault(id(thing), (len(self._things), thing))
        self.record.sizes.setdefault(number, (float(thing.LENGTH), float(thing.WIDTH)))
        pose = (*thing.position.tolist(), float(thing.heading), float(getattr(thing, "speed", 0.0)))
        lane, target = (tuple(getattr(thing, name, None) or ()) for name in ("lane_index", "target_lane_index"))
        return number, *pose, lanes.get(lane, NO_LANE), lanes.get(target, NO_LANE), bool(thing.crashed)


def _lane_signals(network: RoadNetwork, lanes: Ints, heading: Floats, partner: int) -> dict[str, Array]:
    """Return the signals that the lanes tell; see `behavexplor.envs.highway.driven_lanes`."""
    table = lane_table(network)
    place = places(table, *lanes[:, :, 0])
    signals: dict[str, Array] = {CHANGING: lane_changes(table, *lanes[:, :, 0]), WAY: table.way[place]}
    if partner > 0:
        turned = heading[:, partner] - heading[:, 0]
        where, beside = partner_places(table, place, places(table, *lanes[:, :, partner]), turned)
        signals |= {PARTNER: where, PARTNER_LANES: beside}
    return signals


def _partner(position: Floats, heading: Floats, size: Floats, crashed: Bools) -> int:
    """Return the vehicle or obstacle with which the ego crashed; -1 without a crash.

    highway-env does not tell it. It is the nearest of those that have crashed by the frame of the ego's crash.
    """
    frame = int(crashed[:, 0].argmax())
    candidates = 1 + np.flatnonzero(crashed[frame, 1:])
    if not crashed[frame, 0] or not len(candidates):
        return -1
    boxes = box_corners(position[frame], heading[frame], size)
    return int(candidates[box_distance(boxes[:1], boxes[candidates]).argmin()])


def leaving_matters(env: AbstractEnv) -> bool:
    """Return whether it is a violation that the ego leaves the road."""
    return isinstance(env, _WITH_BORDERS)


def must_move_on(env: AbstractEnv) -> bool:
    """Return whether an ego must drive beyond the first two roads of its route, where no arrival is named."""
    return isinstance(env, RoundaboutEnv)


def has_arrived(env: AbstractEnv, info: Mapping[str, Any]) -> bool | None:
    """Return whether the ego has arrived, as highway-env says; None if the environment has no destination.

    The terms of a subclass's reward do not tell it, since they may be others.
    """
    if "is_success" in info:
        return bool(info["is_success"])
    return bool(env.has_arrived(env.vehicle)) if isinstance(env, IntersectionEnv) else None
