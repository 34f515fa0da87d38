"""The layout of a plan as OpenDRIVE needs it: roads of parallel lanes, their links, and their junctions.

OpenDRIVE links one road to one other road. Where roads fork or merge, they cross a junction: the roads on the side with
several roads become the junction's connecting roads. A connecting road must begin and end at roads outside the
junction. Where there would be none, its end is cut off as a road of its own.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from behavexplor.data.array_types import Floats
from behavexplor.data.conventions import wrapped
from behavexplor.data.road_shape import PlannedLane, RoadPlan, SineLane, part_of

MAX_ERROR: Final = 0.001  # greatest distance of a piece from the sine [m]
Links = dict[tuple[int, int], tuple[tuple[int, int], ...]]
NOWHERE: Final = -1  # junction of a road outside junctions
_SAME: Final = 1e-6  # greatest deviation of parallel lanes from parallels [m] [rad]
_MEETING: Final = 0.01  # greatest gap between lanes that are linked [m]
_MEETING_ANGLE: Final = 0.02  # greatest bend between them [rad]
_CUT: Final = 10.0  # length of the road that is cut off from a connecting road [m]
_SHARES: Final = np.linspace(0.0, 1.0, 5)


class Piece(NamedTuple):
    """A parametric cubic curve in the frame of its start, with a parameter p from 0 to 1.

    Attributes:
        pose: x [m], y [m] and heading [rad] of the start, shape (3,).
        u: coefficients of 1, p, p^2 and p^3 along the heading [m], shape (4,).
        v: coefficients perpendicular to it, in the direction in which headings grow [m], shape (4,).
    """

    pose: Floats
    u: Floats
    v: Floats


def sine_pieces(lane: SineLane) -> list[Piece]:
    """Return the center line of a sine lane as pieces, none farther than `MAX_ERROR` from the sine.

    Each piece is linear along the axis of the sine and a cubic Hermite interpolation across it. Its error is at most
    h^4 / 384 times the greatest fourth derivative, where h is the length of the piece along the axis.
    """
    steepest = abs(lane.amplitude) * lane.pulsation**4
    longest = (384 * MAX_ERROR / steepest) ** 0.25 if steepest > 0 else math.inf
    ends = np.linspace(0.0, lane.length, max(math.ceil(lane.length / longest), 1) + 1)
    return [_piece(lane, begin, end - begin) for begin, end in pairwise(ends.tolist())]


def _piece(lane: SineLane, begin: float, step: float) -> Piece:
    angle = lane.pulsation * np.array([begin, begin + step]) + lane.phase
    rise = lane.amplitude * (np.sin(angle[1]) - np.sin(angle[0]))
    first, last = step * lane.amplitude * lane.pulsation * np.cos(angle)
    along = np.array([0.0, step, 0.0, 0.0])
    across = np.array([0.0, first, 3 * rise - 2 * first - last, first + last - 2 * rise])
    pose = lane.pose(begin)
    turn = float(pose[2] - lane.heading)
    cos, sin = math.cos(turn), math.sin(turn)
    return Piece(pose, along * cos + across * sin, across * cos - along * sin)


@dataclass(frozen=True)
class Road:
    """Lanes side by side with the same direction.

    Attributes:
        origin: node at which the lanes begin.
        target: node at which they end.
        lanes: the lanes from left to right.
    """

    origin: str
    target: str
    lanes: tuple[PlannedLane, ...]


@dataclass(frozen=True)
class RoadLayout:
    """Roads with links and junctions.

    Attributes:
        roads: the roads.
        links: pairs of lanes that meet, by the pair of the road that ends and the road that begins there.
        junction: number of the junction that each road crosses, or `NOWHERE`.
    """

    roads: tuple[Road, ...]
    links: Links
    junction: tuple[int, ...]

    def before(self, road: int) -> list[int]:
        """Return the roads that lead to a road."""
        return _before(self.links, road)

    def after(self, road: int) -> list[int]:
        """Return the roads to which a road leads."""
        return _after(self.links, road)


def road_layout(plan: RoadPlan) -> RoadLayout:
    """Return the layout of a plan."""
    whole = tuple(_roads(plan))
    roads = tuple(part for i, road in enumerate(whole) for part in _cut(road, *_cuts(_links(whole), i)))
    links = _links(roads)
    return RoadLayout(roads, links, _junctions(links, len(roads)))


def _roads(plan: RoadPlan) -> Iterator[Road]:
    """Yield roads of parallel lanes, in the order of their first lanes."""
    groups: dict[tuple[str, str], list[PlannedLane]] = {}
    for planned in plan:
        groups.setdefault((planned.lane.origin, planned.lane.target), []).append(planned)
    for (origin, target), group in groups.items():
        rest = group
        while rest:
            offsets = [_offset(rest[0], other) for other in rest]
            beside = sorted((offset, i) for i, offset in enumerate(offsets) if offset is not None)
            for run in _adjacent([(offset, rest[i]) for offset, i in beside]):
                yield Road(origin, target, tuple(run))
            rest = [other for other, offset in zip(rest, offsets, strict=True) if offset is None]


def _offset(first: PlannedLane, other: PlannedLane) -> float | None:
    """Return the offset of a lane to the right of a parallel one [m]; None if they are not parallel."""
    ours = first.lane.pose(_SHARES * first.lane.length)
    theirs = other.lane.pose(_SHARES * other.lane.length)
    right = np.stack([-np.sin(ours[:, 2]), np.cos(ours[:, 2])], axis=-1)
    offset = float((theirs[0, :2] - ours[0, :2]) @ right[0])
    parallel = np.column_stack([ours[:, :2] + offset * right, ours[:, 2]])
    return offset if np.abs(theirs - parallel).max() <= _SAME else None


def _adjacent(beside: list[tuple[float, PlannedLane]]) -> Iterator[list[PlannedLane]]:
    """Yield runs of lanes without a gap between them."""
    run = [beside[0][1]]
    for (left, planned), (right, other) in pairwise(beside):
        if abs(right - left - (planned.lane.width + other.lane.width) / 2) > _SAME:
            yield run
            run = []
        run.append(other)
    yield run


def _links(roads: tuple[Road, ...]) -> Links:
    """Return the lanes that meet. A fork at which roads also merge cannot be a junction here, and has no links."""
    pairs = {
        (i, j): meeting
        for i, road in enumerate(roads)
        for j, other in enumerate(roads)
        if road.target == other.origin and (meeting := _meeting(road, other))
    }
    return {
        (i, j): lanes for (i, j), lanes in pairs.items() if len(_after(pairs, i)) == 1 or len(_before(pairs, j)) == 1
    }


def _meeting(road: Road, other: Road) -> tuple[tuple[int, int], ...]:
    ends = [planned.lane.pose(planned.lane.length) for planned in road.lanes]
    starts = [planned.lane.pose(0.0) for planned in other.lanes]
    return tuple(
        (a, b)
        for a, end in enumerate(ends)
        for b, start in enumerate(starts)
        if np.hypot(*(end - start)[:2]) <= _MEETING and abs(wrapped(float(end[2] - start[2]))) <= _MEETING_ANGLE
    )


def _before(links: Links, road: int) -> list[int]:
    return [i for i, j in links if j == road]


def _after(links: Links, road: int) -> list[int]:
    return [j for i, j in links if i == road]


def _connects(links: Links, road: int) -> bool:
    """Return whether a road is a connecting road: it begins at a fork, or ends where roads merge."""
    from_fork = any(len(_after(links, other)) > 1 for other in _before(links, road))
    return from_fork or any(len(_before(links, other)) > 1 for other in _after(links, road))


def _cuts(links: Links, road: int) -> tuple[bool, bool]:
    """Return whether the beginning and the end of a road are cut off."""
    if not _connects(links, road):
        return False, False
    after = _after(links, road)
    is_followed = len(after) == 1 and len(_before(links, after[0])) == 1 and _connects(links, after[0])
    return len(_before(links, road)) != 1, len(after) != 1 or is_followed


def _cut(road: Road, begins: bool, ends: bool) -> list[Road]:
    """Return the parts of a road. With one cut, the part beside the junction is the short one."""
    share = min(_CUT / road.lanes[0].lane.length, 1 / 3)
    inner = {(False, False): [], (True, False): [1 - share], (False, True): [share], (True, True): [share, 1 - share]}
    shares = [0.0, *inner[begins, ends], 1.0]
    nodes = [road.origin, *(f"{road.origin}>{road.target}:{i}" for i in range(1, len(shares) - 1)), road.target]
    return [
        Road(nodes[i], nodes[i + 1], tuple(_shortened(planned, shares[i], shares[i + 1]) for planned in road.lanes))
        for i in range(len(shares) - 1)
    ]


def _shortened(planned: PlannedLane, begin: float, end: float) -> PlannedLane:
    if (begin, end) == (0.0, 1.0):
        return planned
    length = planned.lane.length
    return replace(planned, lane=part_of(planned.lane, begin * length, end * length))


def _junctions(links: Links, count: int) -> tuple[int, ...]:
    """Return the junction of each road. Connecting roads that share a fork or a merger share a junction."""
    forks = [_after(links, road) for road in range(count)]
    mergers = [_before(links, road) for road in range(count)]
    edges = [(group[0], other) for group in (*forks, *mergers) if len(group) > 1 for other in group]
    if not edges:
        return (NOWHERE,) * count
    rows, columns = np.array(edges, dtype=np.int64).T
    graph = coo_array((np.ones(len(rows)), (rows, columns)), (count, count))
    _, component = connected_components(graph, directed=False)
    crossing = sorted({int(component[road]) for road in rows.tolist()})
    number = {found: i for i, found in enumerate(crossing)}
    return tuple(number.get(int(found), NOWHERE) for found in component)
