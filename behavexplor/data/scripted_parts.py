"""Scripted vehicles as parts: their routes, with plain types, positions and speeds left out.

A plain vehicle is a sedan that drives at the speed limit from the middle of its first lane to the end of its route. The
speed of a waypoint is plain if it is that of the waypoint before. Its position is plain if it is in the middle of the
lane, or at the waypoint before if that is farther on.
"""

from collections.abc import Sequence

from behavexplor.data.parts import Part, Value
from behavexplor.data.scripted import NPC, Waypoint
from behavexplor.data.scripted_ranges import ScriptedRanges
from behavexplor.errors import InputError


def part_of(npc: NPC, ranges: ScriptedRanges) -> Part:
    """Return a vehicle as a part: its type, the positions of all waypoints, and the speeds of all but the last one."""
    positions, speeds = [], []
    before = Waypoint(0.0, ranges.speed_range[1])
    for waypoint, plain in zip(npc.waypoints, _middles(npc.route, ranges), strict=True):
        positions.append(_unless(waypoint.position, max(plain, before.position)))
        speeds.append(_unless(waypoint.speed, before.speed))
        before = waypoint
    kind = None if npc.type == ranges.vehicle_types[0] else npc.type
    return Part(npc.route, (kind, *positions, *speeds[:-1]))


def vehicle_of(part: Part, ranges: ScriptedRanges) -> NPC:
    """Return the vehicle of a part. This is the inverse of `part_of`.

    Raises:
        InputError: if the route is unknown, or the values are not those of a vehicle on this route.
    """
    middles = _middles(part.label, ranges)
    if len(part.values) != 2 * len(middles):
        raise InputError(f"{part.label}: a vehicle on this route has {2 * len(middles)} values")
    kind, *numbers = part.values
    waypoints: list[Waypoint] = []
    at, speed = 0.0, ranges.speed_range[1]
    for plain, position, pace in zip(middles, numbers[: len(middles)], [*numbers[len(middles) :], 0.0], strict=True):
        at = _number(position, max(plain, at))
        speed = _number(pace, speed)
        waypoints.append(Waypoint(at, speed))
    return NPC(ranges.vehicle_types[0] if kind is None else str(kind), part.label, tuple(waypoints))


def _middles(route: str, ranges: ScriptedRanges) -> Sequence[float]:
    """Return the plain position of each waypoint on a route, regardless of the waypoints before it."""
    if route not in ranges.roadmap.routes:
        raise InputError(f"route: there is no route {route!r}")
    bounds = ranges.position_ranges(ranges.roadmap.routes[route])
    return [*bounds[:-1].mean(axis=1).tolist(), float(bounds[-1, 1])]


def _unless(value: float, plain: float) -> float | None:
    return None if value == plain else value


def _number(value: Value, plain: float) -> float:
    return plain if value is None else float(value)
