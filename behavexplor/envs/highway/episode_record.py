"""The record of one episode of a highway-env environment, and the trace that is made of it.

What highway-env's environments themselves count as a failure, beside a crash:

| environment | R2: off the road | R3: not arrived |
|---|---|---|
| highway, merge, exit, racetrack | `on_road` is false | exit: `is_success` is false at the end |
| intersection | | `has_arrived` is false |
| roundabout | | the ego never entered the circle |
| parking | | `is_success` is false at the end |
| two-way, u-turn, lane-keeping | | |

Where nothing is said, it means nothing: in junctions, a vehicle that drives well leaves its lane for some frames, and
on a two-way road it may overtake. A subclass counts as its parent does.

The trace also tells, by lanes, what the ego does, and where the vehicle is into which it crashes. A vehicle's place is
its closest lane, or the one at which it aims if that lies on another road: in a junction, the closest lane is often one
that only crosses. A vehicle aims at the next road of its route before it has left its own, and stays there until then.
"""

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, Final, NamedTuple

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.envs.exit_env import ExitEnv
from highway_env.envs.highway_env import HighwayEnv
from highway_env.envs.intersection_env import IntersectionEnv
from highway_env.envs.merge_env import MergeEnv, MergeGenericEnv
from highway_env.envs.racetrack_env import RacetrackEnv
from highway_env.envs.roundabout_env import RoundaboutEnv
from highway_env.road.lane import AbstractLane
from highway_env.road.road import RoadNetwork
from highway_env.vehicle.objects import RoadObject

from behavexplor.data.array_types import Array, Bools, Floats, Ints
from behavexplor.data.conventions import wrapped
from behavexplor.data.geometry import box_corners, box_distance
from behavexplor.data.trace import (
    ABSENT,
    ARRIVED,
    CHANGING,
    CRASHED,
    ELSEWHERE,
    OBSTACLE,
    OFF_ROAD,
    ON_ITS_WAY,
    PARTNER,
    PARTNER_LANES,
    WAY,
    WAYS,
    WRECKS,
    Trace,
)
from behavexplor.envs.engine.frame_log import THING
from behavexplor.envs.engine.lane_network import lane_indexes, road_numbers
from behavexplor.envs.engine.state import NO_LANE, Records
from behavexplor.envs.highway.course import LaneIndex, ego_route

CURVE: Final = 0.5  # a road whose heading changes by more than this is a curve [rad]
ALONG: Final = math.pi / 4  # two vehicles whose headings differ by less drive the same way, on straight roads [rad]
_STATIONS: Final = 9  # at which the heading of a lane is read
_WITH_BORDERS: Final = (HighwayEnv, MergeEnv, MergeGenericEnv, ExitEnv, RacetrackEnv)


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


class Frame(NamedTuple):
    """What is on the road at one moment."""

    things: Records  # the vehicles and obstacles, shape (n,) of `behavexplor.envs.engine.frame_log.THING`
    ego: int  # the ego's place among them
    is_on_road: bool  # highway-env's `on_road` of the ego


class EpisodeRecord:
    """The frames and decisions of an episode."""

    def __init__(self, env: AbstractEnv, route: Sequence[LaneIndex]) -> None:
        self._route = tuple(route)  # lanes of the ego's route at the start; empty if the environment plans none
        self._leaving_matters = leaving_matters(env)
        self._must_move_on = must_move_on(env)
        self.frames: list[Frame] = []
        self.sizes: dict[int, tuple[float, float]] = {}  # length and width of each vehicle and obstacle by number [m]
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
        """Return the trace of the episode, which ends with the frame in which the ego crashes, if it does.

        `terminated` says that the environment ended the episode, not that its time ran out.
        """
        things = [frame.things for frame in self.frames]
        numbers, column = self._columns()
        size = np.array([self.sizes[number] for number in numbers.tolist()])
        frame = np.repeat(np.arange(len(things)), [len(seen) for seen in things])
        every = _joined(things)
        at = (frame, column[every["number"]])
        motion = np.zeros((4, len(things), len(numbers)))
        motion[:2] = ABSENT
        for values, name in zip(motion, ("x", "y", "heading", "speed"), strict=True):
            values[at] = every[name]
        position, heading, speed = np.moveaxis(motion[:2], 0, -1), motion[2], motion[3]
        velocity = speed[..., None] * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
        lane, target = np.zeros((2, len(things), len(numbers)), dtype=np.int64)
        lane[at], target[at] = every["lane"], every["target_lane"]
        present, crashed = np.zeros((2, len(things), len(numbers)), dtype=bool)
        present[at], crashed[at] = True, every["crashed"]
        has_crashed = bool(crashed[:, 0].any())
        count = int(crashed[:, 0].argmax()) + 1 if has_crashed else len(things)  # frames that the trace keeps
        indexes = lane_indexes(network)
        driven = [indexes[place] for place in lane[:, 0].tolist()]  # the ego's lane in every frame
        route = ego_route(network, self._route, driven, position[:, 0])
        partner = _partner(position, heading, size, crashed)
        signals = self._signals(crashed[:, 0], driven, count) | _lane_signals(network, lane, target, heading, partner)
        if crashed[:, 1:].any():
            signals[WRECKS] = crashed.astype(np.float64)
        decisions = sum(given < count for given in self._action_frames)
        return Trace(
            time=np.arange(count, dtype=np.float64) * self._period,
            position=position[:count],
            heading=heading[:count],
            velocity=velocity[:count],
            size=size,
            actions=np.array(self._actions[:decisions]) if self._actions else np.zeros((0, 1)),
            action_frame=np.array(self._action_frames[:decisions], dtype=np.int64),
            route=route,
            destination=route[-1],
            illegal_lines=np.zeros((0, 2, 2)),
            end="collision" if has_crashed else self._end(terminated=terminated),
            signals={name: values[:count] for name, values in signals.items()},
            present=present[:count],
            partner=partner,
        )

    def _columns(self) -> tuple[Ints, Ints]:
        """Return the numbers of all vehicles and obstacles, the ego's first, and the column of each number."""
        first = self.frames[0]
        ego = int(first.things["number"][first.ego])
        numbers = np.array([ego, *(number for number in self.sizes if number != ego)])
        column = np.zeros(numbers.max() + 1, dtype=np.intp)
        column[numbers] = np.arange(len(numbers))
        return numbers, column

    def _signals(self, crashed: Bools, driven: Sequence[LaneIndex], count: int) -> dict[str, Floats]:
        """Return the signals of the requirements. An arrival counts if it is the last thing that is said of it.

        In every frame, `crashed` is whether the ego has crashed, and `driven` its lane; the trace keeps `count` frames.
        """
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
        numbers = {index: number for number, index in enumerate(lane_indexes(env.road.network))}
        rows = [self._row(thing, numbers) for thing in vehicles]
        rows += [self._row(thing, {}) for thing in obstacles]  # obstacles have no lane
        self.record.frames.append(Frame(np.array(rows, dtype=THING), vehicles.index(ego), bool(ego.on_road)))

    def _row(
        self, thing: RoadObject, numbers: dict[LaneIndex, int]
    ) -> tuple[int, float, float, float, float, int, int, bool]:
        number, _ = self._things.setdefault(id(thing), (len(self._things), thing))
        self.record.sizes.setdefault(number, (float(thing.LENGTH), float(thing.WIDTH)))
        x, y = thing.position.tolist()
        heading, speed = float(thing.heading), float(getattr(thing, "speed", 0.0))
        lane = numbers.get(tuple(getattr(thing, "lane_index", None) or ()), NO_LANE)
        target = numbers.get(tuple(getattr(thing, "target_lane_index", None) or ()), NO_LANE)
        return number, x, y, heading, speed, lane, target, bool(thing.crashed)


def _joined(things: Sequence[Records]) -> Records:
    """Return many arrays of things as one, in a fraction of the time of `np.concatenate`."""
    return np.frombuffer(b"".join(seen.tobytes() for seen in things), THING)


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


def _lane_signals(network: RoadNetwork, lane: Ints, target: Ints, heading: Floats, partner: int) -> dict[str, Array]:
    """Return the signals that the lanes tell; see the module. Lanes and headings have the shape (T, vehicles)."""
    table = lane_table(network)
    place = places(table, lane[:, 0], target[:, 0])
    signals: dict[str, Array] = {CHANGING: lane_changes(table, lane[:, 0], target[:, 0]), WAY: table.way[place]}
    if partner > 0:
        turned = heading[:, partner] - heading[:, 0]
        where, beside = partner_places(table, place, places(table, lane[:, partner], target[:, partner]), turned)
        signals |= {PARTNER: where, PARTNER_LANES: beside}
    return signals


class LaneTable(NamedTuple):
    """The L lanes of a road network, in the order of `RoadNetwork.lanes_dict`."""

    road: Ints  # number of each lane's road, shape (L,)
    number: Ints  # number of each lane on its road, from the left, shape (L,)
    turn: Floats  # change of each lane's heading from start to end, positive to the right, shape (L,) [rad]
    way: Ints  # what a vehicle does there, a place in `WAYS`, shape (L,)
    # how many lanes lane j is to the right of lane i, shape (L, L). It is NaN unless j is on the road of i or on one of
    # the next two roads that follow or precede it.
    beside: Floats


@lru_cache(maxsize=8)
def lane_table(network: RoadNetwork) -> LaneTable:
    """Return what is known of the lanes of a road network."""
    indexes, roads = lane_indexes(network), road_numbers(network)
    lanes = [network.get_lane(index) for index in indexes]
    ends = [index[:2] for index in indexes]
    turn = np.array([_turn(lane) for lane in lanes])
    # by the node where it begins, the node where a curve ends
    curves = {origin: target for (origin, target), angle in zip(ends, turn, strict=True) if abs(angle) > CURVE}
    ring = frozenset(node for node in curves if _returns(node, curves))  # nodes of a roundabout
    way = [WAYS.index(_way(pair, curves, ring, angle)) for pair, angle in zip(ends, turn, strict=True)]
    road = np.array([roads[pair] for pair in ends])
    number = np.array([index[2] for index in indexes])
    return LaneTable(road, number, turn, np.array(way), _beside(lanes, ends, number))


def _turn(lane: AbstractLane) -> float:
    headings = np.unwrap([lane.heading_at(station) for station in np.linspace(0.0, lane.length, _STATIONS)])
    return float(headings[-1] - headings[0])


def _returns(node: str, curves: dict[str, str]) -> bool:
    """Return whether curves alone lead from a node back to it, as in a roundabout."""
    passed = [node]
    while passed[-1] in curves and curves[passed[-1]] not in passed:
        passed.append(curves[passed[-1]])
    return curves.get(passed[-1]) == node


def _way(ends: tuple[str, str], curves: dict[str, str], ring: frozenset[str], turn: float) -> str:
    """Return what a vehicle does on a lane between two nodes, one of `WAYS`; `turn` is the lane's [rad]."""
    origin, target = ends
    if origin in ring:
        return "driving-in-the-ring" if curves[origin] == target else "leaving-the-ring"
    if target in ring:
        return "entering-the-ring"
    if abs(turn) < CURVE:
        return "going-straight"
    return "turning-right" if turn > 0 else "turning-left"


def _beside(lanes: list[AbstractLane], ends: list[tuple[str, str]], number: Ints) -> Floats:
    """Return `LaneTable.beside`."""
    count = len(lanes)
    beside = np.full((count, count), np.nan)
    follows = np.zeros((count, count), dtype=bool)
    for i, j in np.ndindex(count, count):
        if ends[i] == ends[j]:
            beside[i, j] = number[j] - number[i]
        elif ends[i][1] == ends[j][0] and abs(_bend(lanes[i], lanes[j])) < math.pi / 2:
            beside[i, j], follows[i, j] = _lanes_across(lanes[i], lanes[j]), True
    for i, j in np.argwhere(follows & (beside == 0)).tolist():
        onward = follows[j] & np.isnan(beside[i])  # reached straight on by lane j
        beside[i, onward] = beside[j, onward]
    return np.where(np.isnan(beside), -beside.T, beside)  # backwards, too


def _bend(lane: AbstractLane, following: AbstractLane) -> float:
    """Return the angle from the end of a lane to the start of another [rad]: half a turn if that leads back."""
    return wrapped(following.heading_at(0.0) - lane.heading_at(lane.length))


def _lanes_across(lane: AbstractLane, following: AbstractLane) -> int:
    """Return how many lanes the start of a lane is to the right of the end of another."""
    x, y = following.position(0.0, 0.0) - lane.position(lane.length, 0.0)
    heading = lane.heading_at(lane.length)
    across: float = (y * math.cos(heading) - x * math.sin(heading)) / lane.width_at(lane.length)
    return round(across)


def places(table: LaneTable, lane: Ints, target: Ints) -> Ints:
    """Return the place of a vehicle in each frame: its lane, or the one at which it aims on another road.

    A vehicle that still is on the road at which it aimed before is not yet there.
    """
    aim = np.where(target == NO_LANE, lane, target)
    road, driven = table.road[aim], table.road[lane]
    begins = np.append(0, 1 + np.flatnonzero(np.diff(road)))  # of the stretches in which it aims at one road
    begin = begins[np.searchsorted(begins, np.arange(len(road)), side="right") - 1]
    has_left = (begin == 0) | (driven != road[begin - 1])  # the road at which it aimed before
    return np.where((road != driven) & has_left, aim, lane)


def lane_changes(table: LaneTable, lane: Ints, target: Ints) -> Ints:
    """Return in which frames a vehicle changes lanes, shape (T,): -1 to the left, 1 to the right, 0 if it does not.

    A change begins when the vehicle aims at another lane of the same road, and ends when that is the closest one. For a
    vehicle that aims at none, it is the moment at which another lane of the road is the closest.
    """
    aim = np.where(target == NO_LANE, lane, target)
    changing = np.zeros(len(aim), dtype=np.int64)
    begins = 1 + np.flatnonzero((np.diff(aim) != 0) & (np.diff(table.road[aim]) == 0))
    there = np.append(np.flatnonzero(lane == aim), len(aim) - 1)
    for begin in begins.tolist():
        end = int(there[np.searchsorted(there, begin)])
        changing[begin:] = 0
        changing[begin : end + 1] = np.sign(table.number[aim[begin]] - table.number[aim[begin - 1]])
    return changing


def partner_places(table: LaneTable, place: Ints, partner: Ints, turned: Floats) -> tuple[Ints, Floats]:
    """Return where the partner of a crash is in each frame, and how many lanes to the right of the ego, each (T,).

    It is `ELSEWHERE`, `ON_ITS_WAY` or `OBSTACLE`. `place` and `partner` are the lanes of the ego and of the partner,
    `NO_LANE` for an obstacle. `turned` is the heading of the partner relative to the ego's [rad].
    """
    beside = table.beside[place, partner]
    angle = np.abs(np.remainder(turned + np.pi, 2 * np.pi) - np.pi)
    along: Bools = angle < ALONG + np.abs(table.turn[place]) + np.abs(table.turn[partner])
    is_near = ~np.isnan(beside) & along
    where = np.where(partner == NO_LANE, OBSTACLE, np.where(is_near, ON_ITS_WAY, ELSEWHERE))
    return where, np.where(where == ON_ITS_WAY, beside, 0.0)
