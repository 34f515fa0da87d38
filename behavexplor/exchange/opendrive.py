"""Roads as OpenDRIVE 1.7, written by the library scenariogeneration.

Every lane is a right lane of a road in its own direction. The reference line of a road is the center line of its
leftmost lane, and the lane offset says so.
"""

from pathlib import Path
from typing import Any, Final

from scenariogeneration import xodr
from scenariogeneration.helpers import prettify

from behavexplor.data.durable import write_durably
from behavexplor.data.road_shape import BROKEN, DASH, NO_LINE, PERIOD, SOLID, PlannedLane, RoadPlan, SineLane
from behavexplor.data.roadmap import CURB, DOUBLE_YELLOW, Lane
from behavexplor.exchange.axes import mirrored_lane
from behavexplor.exchange.road_layout import NOWHERE, RoadLayout, road_layout, sine_pieces

REVISION: Final = "7"  # minor revision of OpenDRIVE 1
_FIRST_JUNCTION: Final = 1000  # id of the first junction; ids of roads are smaller where there are fewer roads


def write_road(plan: RoadPlan, name: str, path: Path) -> None:
    """Write a road as an OpenDRIVE file.

    Args:
        plan: the road.
        name: name of the road network.
        path: path of the file.
    """
    layout = road_layout(plan)
    network = xodr.OpenDrive(name, revMinor=REVISION)
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
    before, after = layout.before(i), layout.after(i)
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
    """Return whether the link between two roads, of which i is one, leads from i into a junction."""
    is_branching = len(layout.after(begin)) > 1 or len(layout.before(end)) > 1
    return is_branching and layout.junction[i] == NOWHERE


def _junction_id(junction: int) -> int:
    return junction if junction == NOWHERE else _FIRST_JUNCTION + junction


def _plan_view(lane: Lane) -> Any:
    """Return the reference line along the center of a lane."""
    view = xodr.PlanView()
    ours = mirrored_lane(lane)
    if isinstance(ours, SineLane):
        for piece in sine_pieces(ours):
            view.add_fixed_geometry(xodr.ParamPoly3(*piece.u.tolist(), *piece.v.tolist()), *piece.pose.tolist())
        return view
    shape = xodr.Arc(ours.curvature, length=ours.length) if ours.curvature else xodr.Line(ours.length)
    view.add_fixed_geometry(shape, ours.x, ours.y, ours.heading)
    return view


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
        for incoming in layout.before(i) if crossed == number else ():
            connection = xodr.Connection(incoming, i, xodr.ContactPoint.start)
            for a, b in layout.links[incoming, i]:
                connection.add_lanelink(_lane_id(a), _lane_id(b))
            made.add_connection(connection)
    return made
