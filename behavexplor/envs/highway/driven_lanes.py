"""What the lanes say, frame by frame: what the ego does, and where the vehicle is into which it crashes.

A vehicle's place is the lane that is closest to it, or the one at which it aims if that lies on another road: in a
junction, the closest lane is often one that only crosses.
"""

import math
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from highway_env.road.lane import AbstractLane
from highway_env.road.road import RoadNetwork

from behavexplor.data.array_types import Bools, Floats, Ints
from behavexplor.data.conventions import wrapped
from behavexplor.data.trace import ELSEWHERE, OBSTACLE, ON_ITS_WAY, WAYS
from behavexplor.envs.engine.lane_network import lane_indexes, road_numbers
from behavexplor.envs.engine.state import NO_LANE

CURVE: Final = 0.5  # a road whose heading changes by more than this is a curve [rad]
ALONG: Final = math.pi / 4  # greatest angle to the road of a vehicle that drives along it [rad]
_STATIONS: Final = 9  # at which the heading of a lane is read


class LaneTable(NamedTuple):
    """The L lanes of a road network, in the order of `RoadNetwork.lanes_dict`."""

    road: Ints  # number of each lane's road, shape (L,)
    number: Ints  # number of each lane on its road, from the left, shape (L,)
    turn: Floats  # change of each lane's heading from start to end, positive to the right, shape (L,) [rad]
    way: Ints  # what a vehicle does there, a place in `WAYS`, shape (L,)
    # how many lanes lane j is to the right of lane i, as far as j is on the road of i or on one of the next two that
    # follow or precede it; NaN for all others. Shape (L, L).
    beside: Floats


@lru_cache(maxsize=8)
def lane_table(network: RoadNetwork) -> LaneTable:
    """Return what is known of the lanes of a road network."""
    indexes, roads = lane_indexes(network), road_numbers(network)
    lanes = [network.get_lane(index) for index in indexes]
    ends = [index[:2] for index in indexes]
    turn = np.array([_turn(lane) for lane in lanes])
    curves = {origin: target for (origin, target), angle in zip(ends, turn, strict=True) if abs(angle) > CURVE}
    ring = frozenset(node for node in curves if _returns(node, curves))
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
    """Return what a vehicle does on the road between two nodes, one of `WAYS`."""
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
        onward = follows[j] & np.isnan(beside[i])
        beside[i, onward] = beside[j, onward]
    return np.where(np.isnan(beside), -beside.T, beside)


def _bend(lane: AbstractLane, following: AbstractLane) -> float:
    """Return the angle from the end of a lane to the start of another [rad], which is half a turn where a road ends."""
    return wrapped(following.heading_at(0.0) - lane.heading_at(lane.length))


def _lanes_across(lane: AbstractLane, following: AbstractLane) -> int:
    """Return how many lanes the start of a lane is to the right of the end of another."""
    x, y = following.position(0.0, 0.0) - lane.position(lane.length, 0.0)
    heading = lane.heading_at(lane.length)
    across: float = (y * math.cos(heading) - x * math.sin(heading)) / lane.width_at(lane.length)
    return round(across)


def places(table: LaneTable, lane: Ints, target: Ints) -> Ints:
    """Return the place of a vehicle in each frame: its lane, or the one at which it aims on another road."""
    return np.where((target != NO_LANE) & (table.road[target] != table.road[lane]), target, lane)


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

    The former is `ELSEWHERE`, `ON_ITS_WAY` or `OBSTACLE`. The place of an obstacle is `NO_LANE`; `turned` is its
    heading relative to the ego's [rad].
    """
    beside = table.beside[place, partner]
    angle = np.abs(np.remainder(turned + np.pi, 2 * np.pi) - np.pi)
    along: Bools = angle < ALONG + np.abs(table.turn[place]) + np.abs(table.turn[partner])
    is_near = ~np.isnan(beside) & along
    where = np.where(partner == NO_LANE, OBSTACLE, np.where(is_near, ON_ITS_WAY, ELSEWHERE))
    return where, np.where(where == ON_ITS_WAY, beside, 0.0)
