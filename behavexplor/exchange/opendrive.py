"""Roads as OpenDRIVE 1.7, written by the library scenariogeneration; and their layout: links and junctions.

Every lane is a right lane of a road in its own direction. The reference line of a road is the center line of its
leftmost lane, and the lane offset says so. Sines become cubic polynomials, since OpenDRIVE has no sines.

OpenDRIVE links one road to one other road. Where roads fork or merge, they cross a junction: the roads on the side with
several roads become the junction's connecting roads. A connecting road must begin and end at roads outside the
junction. Where there would be none, its end is cut off as a road of its own.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from scenariogeneration import xodr
from scenariogeneration.helpers import prettify
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from behavexplor.data.array_types import Floats
from behavexplor.data.conventions import wrapped
from behavexplor.data.durable import write_durably
from behavexplor.data.road_plan import BROKEN, NO_LINE, SOLID, PlannedLane, RoadPlan, SineLane, part_of
from behavexplor.data.road_shape import DASH, PERIOD
from behavexplor.data.roadmap import CURB, DOUBLE_YELLOW, Lane
from behavexplor.exchange.axes import mirrored_lane

Links = dict[tuple[int, int], tuple[tuple[int, int], ...]]  # see `RoadLayout.links`

MAX_ERROR: Final = 0.001  # greatest distance of a piece from the sine [m]
NOWHERE: Final = -1  # junction of a road outside junctions
_SAME: Final = 1e-6  # greatest deviation of parallel lanes from parallels [m] [rad]
_MEETING: Final = 0.01  # greatest gap between lanes that are linked [m]
_MEETING_ANGLE: Final = 0.02  # greatest bend between them [rad]
_CUT: Final = 10.0  # length of the road that is cut off from a connecting road [m]
_SHORTER: Final = 1e-9  # how much the length of a cubic is rounded down [m]
_SHARES: Final = np.linspace(0.0, 1.0, 5)  # places at which two lanes are compared, as shares of their lengths

REVISION: Final = "7"  # minor revision of OpenDRIVE 1
# the place on earth, for which CARLA asks: these roads have none, so their origin is at latitude 0 and longitude 0
_PLACE: Final = "+proj=tmerc +lat_0=0 +lon_0=0 +k=1 +x_0=0 +y_0=0 +datum=WGS84 +units=m +no_defs"
_FIRST_JUNCTION: Final = 1000  # id of the first junction; ids of roads are smaller where there are fewer roads


class Piece(NamedTuple):
    """A parametric cubic curve in the frame of its start, with a parameter p from 0 to 1."""

    pose: Floats  # x [m], y [m] and heading [rad] of the start, shape (3,)
    u: Floats  # coefficients of 1, p, p^2 and p^3 along the heading [m], shape (4,)
    v: Floats  # coefficients perpendicular to it, in the direction in which headings grow [m], shape (4,)


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
    """Lanes side by side with the same direction."""

    origin: str  # node at which the lanes begin
    target: str  # node at which they end
    lanes: tuple[PlannedLane, ...]  # the lanes from left to right


@dataclass(frozen=True)
class RoadLayout:
    """Roads with links and junctions."""

    roads: tuple[Road, ...]  # the roads
    links: Links  # pairs of lanes that meet, by the pair of the road that ends and the road that begins there
    junction: tuple[int, ...]  # number of the junction that each road crosses, or `NOWHERE`


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


def write_road(plan: RoadPlan, name: str, path: Path) -> None:
    """Write a road as an OpenDRIVE file; `name` is that of the road network."""
    layout = road_layout(plan)
    network = xodr.OpenDrive(name, revMinor=REVISION, geo_reference=_PLACE)
    for i in range(len(layout.roads)):
        network.add_road(_road(layout, i))
    for junction in sorted({*layout.junction} - {NOWHERE}):
        network.add_junction(_junction(layout, junction))
    write_durably(path, prettify(network.get_element(), encoding="utf-8"))


def _road(layout: RoadLayout, i: int) -> Any:
    road = layout.roads[i]
    name, junction = f"{road.origin} to {road.target}", _junction_id(layout.junction[i])
    made = xodr.Road(i, _plan_view(road.lanes[0].lane), _lanes(layout, i), junction, name)
    limits = [planned.speed_limit for planned in road.lanes if planned.speed_limit is not None]
    made.add_type(xodr.RoadType.town, speed=max(limits) if limits else None)
    before, after = _before(layout.links, i), _after(layout.links, i)
    if before:
        made.add_predecessor(*_linked(layout, i, before[0], is_before=True))
    if after:
        made.add_successor(*_linked(layout, i, after[0], is_before=False))
    return made


def _linked(layout: RoadLayout, i: int, other: int, *, is_before: bool) -> tuple[Any, ...]:
    """Return what a road is linked to beside another one: that road, or the junction that it crosses."""
    pair = (other, i) if is_before else (i, other)
    if _enters_junction(layout, i, *pair):
        return xodr.ElementType.junction, _junction_id(layout.junction[other])
    return xodr.ElementType.road, other, xodr.ContactPoint.end if is_before else xodr.ContactPoint.start


def _enters_junction(layout: RoadLayout, i: int, begin: int, end: int) -> bool:
    """Return whether the link between two roads, of which i is one, leads from i into a junction.

    Such a road is linked to the junction, not to the road that crosses it (OpenDRIVE 1.7, section 12.4).
    """
    other = end if i == begin else begin
    return layout.junction[i] == NOWHERE and layout.junction[other] != NOWHERE


def _junction_id(junction: int) -> int:
    return junction if junction == NOWHERE else _FIRST_JUNCTION + junction


def _plan_view(lane: Lane) -> Any:
    """Return the reference line along the center of a lane."""
    view = xodr.PlanView()
    ours = mirrored_lane(lane)
    if isinstance(ours, SineLane):
        for piece in sine_pieces(ours):
            view.add_fixed_geometry(_Cubic(*piece.u.tolist(), *piece.v.tolist()), *piece.pose.tolist())
        return view
    shape = xodr.Arc(ours.curvature, length=ours.length) if ours.curvature else xodr.Line(ours.length)
    view.add_fixed_geometry(shape, ours.x, ours.y, ours.heading)
    return view


class _Cubic(xodr.ParamPoly3):  # type: ignore[misc]  # the library has no types
    """A parametric cubic whose stated length never exceeds that of its arc: beyond it, readers would find no point."""

    def get_end_data(self, x: float, y: float, h: float) -> tuple[float, float, float, float]:
        """Return the end of a cubic that starts at a pose: x [m], y [m], heading [rad], and its length [m]."""
        *end, length = super().get_end_data(x, y, h)
        self.length = length - _SHORTER
        return (*end, self.length)


def _lanes(layout: RoadLayout, i: int) -> Any:
    planned = layout.roads[i].lanes
    center = xodr.Lane(lane_type=xodr.LaneType.none)
    center.add_roadmark(_mark(planned[0].left))
    section = xodr.LaneSection(0, center)
    for number, one in enumerate(planned):
        lane = xodr.Lane(a=one.lane.width)
        lane.add_roadmark(_mark(_between(planned, number)))
        for kind, other in _neighbors(layout, i, number):
            lane.add_link(kind, _lane_id(other))
        section.add_right_lane(lane)
    lanes = xodr.Lanes()
    lanes.add_laneoffset(xodr.LaneOffset(a=planned[0].lane.width / 2))
    lanes.add_lanesection(section)
    return lanes


def _neighbors(layout: RoadLayout, i: int, number: int) -> list[tuple[str, int]]:
    """Return the links of a lane. Those into a junction belong to the junction's connections."""
    found = []
    for (begin, end), pairs in layout.links.items():
        if i not in (begin, end) or _enters_junction(layout, i, begin, end):
            continue
        found += [("predecessor", a) for a, b in pairs if i == end and b == number]
        found += [("successor", b) for a, b in pairs if i == begin and a == number]
    return found


def _lane_id(number: int) -> int:
    return -1 - number


def _between(planned: tuple[PlannedLane, ...], number: int) -> str:
    """Return the marking to the right of a lane: its own, or that of the lane beside it."""
    own = planned[number].right
    return own if own != NO_LINE or number == len(planned) - 1 else planned[number + 1].left


def _mark(kind: str) -> Any:
    if kind == DOUBLE_YELLOW:
        return xodr.RoadMark(xodr.RoadMarkType.solid_solid, color=xodr.RoadMarkColor.yellow)
    if kind == BROKEN:
        return xodr.RoadMark(xodr.RoadMarkType.broken, width=0.15, length=DASH, space=PERIOD - DASH)
    kinds = {NO_LINE: xodr.RoadMarkType.none, SOLID: xodr.RoadMarkType.solid, CURB: xodr.RoadMarkType.curb}
    return xodr.RoadMark(kinds[kind])


def _junction(layout: RoadLayout, number: int) -> Any:
    made = xodr.Junction(f"junction {number}", _junction_id(number))
    for i, crossed in enumerate(layout.junction):
        for incoming in _before(layout.links, i) if crossed == number else ():
            connection = xodr.Connection(incoming, i, xodr.ContactPoint.start)
            for a, b in layout.links[incoming, i]:
                connection.add_lanelink(_lane_id(a), _lane_id(b))
            made.add_connection(connection)
    return made
