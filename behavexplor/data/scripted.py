"""Concrete scenarios of scripted vehicles: their routes, the speeds along them, and the ranges of both on a map.

A `ScriptedScenario` is a frozen value that knows neither map nor simulator. `ScriptedRanges` has the values that are
possible on a map; `behavexplor.data.scripted_logical.ScriptedLogicalScenario` draws and varies scenarios within them.
Source: paper section 2.2, for the parameters that are searched (the NPCs' routes and waypoints).
"""

import json
import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Any, Final, NamedTuple, Self

import numpy as np

from behavexplor.data.array_types import Floats
from behavexplor.data.conventions import EGO_SIZE, VEHICLE_SIZES
from behavexplor.data.geometry import box_corners, boxes_overlap
from behavexplor.data.roadmap import Lane, RoadMap, Route
from behavexplor.data.untrusted import object_fields
from behavexplor.errors import InputError, brief, unknown_name

MAX_NAME_LENGTH = 200  # characters
MAX_NUMBER = 1e9  # limit of positions [m] and speeds [m/s]
_ATTEMPTS: Final = 1000  # greatest number of vehicles that are drawn until one can be placed
_MARGIN: Final = 1e-6  # much more than roundings change a distance [m]


@dataclass(frozen=True, slots=True)
class Waypoint:
    """A position along a route and the speed at this position.

    Attributes:
        position: distance from the start of the route [m], >= 0.
        speed: speed at this position [m/s], >= 0.

    Raises:
        InputError: if a value is not a number from 0 to `MAX_NUMBER`.
    """

    position: float
    speed: float

    def __post_init__(self) -> None:
        position, speed = self.position, self.speed
        if type(position) is type(speed) is float and 0.0 <= position < MAX_NUMBER and 0.0 <= speed < MAX_NUMBER:
            return  # nearly always, and faster than the checks below
        object.__setattr__(self, "position", _number("position", position))
        object.__setattr__(self, "speed", _number("speed", speed))


@dataclass(frozen=True, slots=True)
class NPC:
    """A scripted vehicle that follows its waypoints blindly and parks at the last one.

    Attributes:
        type: vehicle type, such as "sedan".
        route: name of the vehicle's route.
        waypoints: one or more waypoints with non-decreasing positions. The vehicle starts at the first one.

    Raises:
        InputError: if a field has the wrong type, or the positions decrease.
    """

    type: str
    route: str
    waypoints: tuple[Waypoint, ...]

    def __post_init__(self) -> None:
        _text("type", self.type)
        _text("route", self.route)
        object.__setattr__(self, "waypoints", _parts("waypoints", self.waypoints))
        if not self.waypoints:
            raise InputError("waypoints: at least one is needed")
        for i, waypoint in enumerate(self.waypoints):
            if not isinstance(waypoint, Waypoint):
                raise InputError(f"waypoints[{i}]: expected a Waypoint, got {brief(waypoint)}")
        positions = [waypoint.position for waypoint in self.waypoints]
        for i, (before, position) in enumerate(pairwise(positions), 1):
            if position < before:
                raise InputError(f"waypoints[{i}].position: {position} lies before the previous waypoint's {before}")


@dataclass(frozen=True, slots=True)
class ScriptedScenario:
    """A concrete scenario, in which all values are fixed.

    Attributes:
        functional: name of the functional scenario, such as "intersection-straight".
        npcs: the scripted vehicles.

    Raises:
        InputError: if a field has the wrong type.
    """

    functional: str
    npcs: tuple[NPC, ...]

    has_original = False  # the roads are this package's
    meta_actions = ()  # the driver accelerates and steers

    def __post_init__(self) -> None:
        _text("functional", self.functional)
        object.__setattr__(self, "npcs", _parts("npcs", self.npcs))
        for i, npc in enumerate(self.npcs):
            if not isinstance(npc, NPC):
                raise InputError(f"npcs[{i}]: expected an NPC, got {brief(npc)}")

    @property
    def conditions(self) -> dict[str, Any]:
        """Nothing: the script holds in every configuration of the environment."""
        return {}

    @property
    def scene_config(self) -> dict[str, Any]:
        """Nothing, as for `conditions`."""
        return {}

    @property
    def scene(self) -> Self:
        """The whole scenario, which is the same for every driver."""
        return self

    def to_dict(self) -> dict[str, Any]:
        """Return the scenario as JSON values. Waypoints are `[position, speed]` pairs."""
        return {
            "functional": self.functional,
            "npcs": [
                {
                    "type": npc.type,
                    "route": npc.route,
                    "waypoints": [[waypoint.position, waypoint.speed] for waypoint in npc.waypoints],
                }
                for npc in self.npcs
            ],
        }

    def to_json(self) -> str:
        """Return the scenario as one line of JSON. `behavexplor.data.scenario.parse_scenario` restores it exactly."""
        return json.dumps(self.to_dict(), separators=(",", ":"))

    @classmethod
    def from_dict(cls, value: object) -> Self:
        """Create a scenario from JSON values, as returned by `to_dict`.

        Raises:
            InputError: if a field is missing, unknown or wrong; the message names it.
        """
        fields = object_fields("the scenario", value, ("functional", "npcs"))
        npcs = []
        for i, entry in enumerate(_list("npcs", fields["npcs"])):
            npcs.append(_within(f"npcs[{i}]", _npc_from_dict, entry))
        return cls(fields["functional"], tuple(npcs))


def _npc_from_dict(value: object) -> NPC:
    fields = object_fields("an NPC", value, ("type", "route", "waypoints"))
    waypoints = []
    for i, pair in enumerate(_list("waypoints", fields["waypoints"])):
        waypoints.append(_within(f"waypoints[{i}]", _waypoint_from_pair, pair))
    return NPC(fields["type"], fields["route"], tuple(waypoints))


def _waypoint_from_pair(value: object) -> Waypoint:
    if not isinstance(value, list) or len(value) != 2:
        raise InputError(f"expected [position, speed], got {brief(value)}")
    return Waypoint(*value)


def _within(place: str, read: Any, value: object) -> Any:
    """Read a nested value. If it is wrong, the error names the whole path to the field."""
    try:
        return read(value)
    except InputError as error:
        message = str(error)
        separator = "." if re.match(r"\w+(\[|\.|:)", message) else ": "
        raise InputError(f"{place}{separator}{message}") from None


def _list(name: str, value: object) -> list[Any]:
    if not isinstance(value, list):
        raise InputError(f"{name}: expected a list, got {value!r:.80}")
    return value


def _parts(name: str, value: Any) -> tuple[Any, ...]:
    if not isinstance(value, Iterable):
        raise InputError(f"{name}: expected a list, got {value!r:.80}")
    return tuple(value)


def _text(name: str, value: object) -> str:
    if not isinstance(value, str) or not 0 < len(value) <= MAX_NAME_LENGTH:
        raise InputError(f"{name}: expected a name, got {value!r:.80}")
    return value


def _number(name: str, value: object) -> float:
    number = math.nan
    if isinstance(value, int | float) and not isinstance(value, bool):
        number = float(value) if abs(value) < MAX_NUMBER else math.inf
    if not 0 <= number < math.inf:
        raise InputError(f"{name}: expected a number from 0 to {MAX_NUMBER:g}, got {value!r:.80}")
    return number


@dataclass(frozen=True)
class ScriptedRanges:
    """The parameters of a functional scenario and their ranges."""

    name: str  # name of the functional scenario, such as "intersection-straight"
    roadmap: RoadMap  # the map
    n_npcs: int  # number of NPCs in a sampled scenario, and the greatest number in any scenario
    waypoints_per_lane: int  # number of waypoints that an NPC has on each lane of its route
    min_speed: float = 0.2  # least speed at every waypoint but the last [m/s]; the greatest is the speed limit
    end_gap: float = 2.5  # least distance of a starting NPC's center from the ends of its first lane [m]
    npc_gap: float = 8.0  # least distance between the centers of NPCs that start in the same lane [m]
    ego_gap: float = 15.0  # least distance between the centers of the ego and a starting NPC [m]
    vehicle_types: tuple[str, ...] = field(default=tuple(VEHICLE_SIZES))  # possible vehicle types of NPCs

    @property
    def speed_range(self) -> tuple[float, float]:
        """Least and greatest speed at every waypoint except the last one [m/s]."""
        return self.min_speed, self.roadmap.speed_limit

    def position_ranges(self, route: Route) -> Floats:
        """Return the range of positions of each waypoint on a route, read-only, shape (waypoints, 2) [m].

        Each waypoint lies within its lane. The first waypoint, at which the vehicle starts, also keeps a distance of
        `end_gap` from both ends of its lane.
        """
        return _position_ranges(route, self.waypoints_per_lane, self.end_gap)

    def check(self, scenario: ScriptedScenario) -> None:
        """Check that a concrete scenario is valid in this logical scenario.

        Raises:
            InputError: if the scenario is invalid. The message names the field that is out of range, or the spawn
                rule that is broken.
        """
        if scenario.functional != self.name:
            raise InputError(f"functional: this is a scenario of {scenario.functional!r}, not of {self.name!r}")
        if len(scenario.npcs) > self.n_npcs:
            raise InputError(f"npcs: {len(scenario.npcs)} are too many; {self.name!r} has at most {self.n_npcs}")
        placed: list[_Placed] = []
        for i, npc in enumerate(scenario.npcs):
            try:
                self._check_npc(npc)
            except InputError as error:
                raise InputError(f"npcs[{i}].{error}") from None
            placed.append(self._placed(npc))
            conflict = self._conflict(placed[i], placed[:i])
            if conflict is not None:
                raise InputError(f"npcs[{i}].waypoints[0].position: the vehicle starts {conflict}")

    def _check_npc(self, npc: NPC) -> None:
        if npc.type not in self.vehicle_types:
            raise InputError(f"type: {unknown_name('vehicle type', npc.type, self.vehicle_types)}")
        if npc.route not in self.roadmap.routes:
            raise InputError(f"route: {unknown_name('route', npc.route, self.roadmap.routes)}")
        ranges = self.ranges[npc.route]
        if len(npc.waypoints) != len(ranges):
            raise InputError(f"waypoints: route {npc.route!r} takes {len(ranges)}, got {len(npc.waypoints)}")
        for i, (waypoint, (start, end, low, high)) in enumerate(zip(npc.waypoints, ranges, strict=True)):
            if not start <= waypoint.position <= end:
                raise InputError(f"waypoints[{i}].position: {waypoint.position} is not in [{start:g}, {end:g}] m")
            if not low <= waypoint.speed <= high:
                raise InputError(f"waypoints[{i}].speed: {waypoint.speed} is not in [{low:g}, {high:g}] m/s")

    def first_to_fit(self, vehicles: Iterable[NPC], others: Sequence[NPC]) -> NPC | None:
        """Return the first vehicle that can start beside others, or None. Those after it are not taken, or drawn."""
        placed = list(map(self._placed, others))
        return next((npc for npc in vehicles if self._conflict(self._placed(npc), placed) is None), None)

    def _conflict(self, placed: "_Placed", others: Sequence["_Placed"]) -> str | None:
        gap = _gap(placed, self._ego)
        if gap < self.ego_gap:
            return f"{gap:.2f} m from the ego, closer than {self.ego_gap:g} m"
        if _overlap(placed, self._ego, gap):
            return "where the ego stands"
        for i, other in enumerate(others):
            gap = _gap(placed, other)
            if placed.lane is other.lane and gap < self.npc_gap:
                return f"{gap:.2f} m from NPC {i} in the same lane, closer than {self.npc_gap:g} m"
            if _overlap(placed, other, gap):
                return f"where NPC {i} stands"
        return None

    def _placed(self, npc: NPC) -> "_Placed":
        lane, size = self.roadmap.routes[npc.route].lanes[0], VEHICLE_SIZES[npc.type]
        x, y, heading = lane.pose_at(npc.waypoints[0].position)
        return _Placed(x, y, heading, size, _radius(size), lane)

    @cached_property
    def _ego(self) -> "_Placed":
        x, y, heading = self.roadmap.start_pose.tolist()
        return _Placed(x, y, heading, EGO_SIZE, _radius(EGO_SIZE), self.roadmap.ego_route.lanes[0])

    @cached_property
    def ranges(self) -> dict[str, list["WaypointRange"]]:
        """The range of each waypoint, by route."""
        ranges = {}
        for name, route in self.roadmap.routes.items():
            positions = self.position_ranges(route).tolist()
            speeds = [self.speed_range] * (len(positions) - 1) + [(0.0, 0.0)]
            ranges[name] = [
                WaypointRange(start, end, slowest, fastest)
                for (start, end), (slowest, fastest) in zip(positions, speeds, strict=True)
            ]
        return ranges

    def pass_over(self, rng: np.random.Generator) -> None:
        """Advance the generator as `sample` does. How many numbers that takes depends on the vehicles drawn."""
        self.sample(rng)

    def sample(self, rng: np.random.Generator) -> ScriptedScenario:
        """Sample a scenario with every parameter uniform in its range.

        Raises:
            InputError: if the vehicles could not be placed by the spawn rules.
        """
        npcs: list[NPC] = []
        for _ in range(self.n_npcs):
            npcs.append(self.place(lambda: self.sample_npc(rng), npcs))
        return ScriptedScenario(self.name, tuple(npcs))

    def sample_npc(self, rng: np.random.Generator) -> NPC:
        """Sample a vehicle with a uniform type, route and waypoints, regardless of other vehicles."""
        kind = self.vehicle_types[rng.integers(len(self.vehicle_types))]
        route = self.roadmap.npc_routes[rng.integers(len(self.roadmap.npc_routes))]
        ranges, (slowest, fastest) = self.ranges[route.name], self.speed_range
        waypoints, position = [], 0.0
        for allowed, (along, share) in zip(ranges, rng.random((len(ranges), 2)).tolist(), strict=True):
            least = max(allowed.start, position)
            position = least + (allowed.end - least) * along  # as `rng.uniform` does; one call for all is faster
            waypoints.append(Waypoint(position, slowest + (fastest - slowest) * share))
        waypoints[-1] = Waypoint(position, 0.0)
        return NPC(kind, route.name, tuple(waypoints))

    def place(self, draw: Callable[[], NPC], others: Sequence[NPC]) -> NPC:
        """Draw vehicles until one can start beside the other vehicles, and return it.

        Raises:
            InputError: if none of `_ATTEMPTS` drawn vehicles can be placed.
        """
        npc = self.first_to_fit((draw() for _ in range(_ATTEMPTS)), others)
        if npc is not None:
            return npc
        raise InputError(
            f"{self.name}: none of {_ATTEMPTS} draws could be placed beside {len(others)} NPCs; use fewer NPCs"
        )


@lru_cache
def _position_ranges(route: Route, waypoints_per_lane: int, end_gap: float) -> Floats:
    lanes = np.stack([route.bounds[:-1], route.bounds[1:]], axis=1)
    ranges = np.repeat(lanes, waypoints_per_lane, axis=0)
    ranges[0] += end_gap, -end_gap
    ranges.setflags(write=False)
    return ranges


class WaypointRange(NamedTuple):
    """Where a waypoint may lie [m], and the least and greatest speed there [m/s]."""

    start: float
    end: float
    slowest: float
    fastest: float


class _Placed(NamedTuple):
    """Where a vehicle starts."""

    x: float  # center of its box [m]
    y: float  # center of its box [m]
    heading: float  # heading [rad]
    size: tuple[float, float]  # length and width [m]
    radius: float  # radius of the circle around its box [m]
    lane: Lane  # lane in which it starts


def _gap(a: _Placed, b: _Placed) -> float:
    """Return the distance between the centers of two vehicles [m]."""
    return math.hypot(a.x - b.x, a.y - b.y)


def _overlap(a: _Placed, b: _Placed, gap: float) -> bool:
    """Return whether the boxes of two vehicles touch. `gap` is the distance between their centers [m].

    Circles around the boxes decide most pairs, and the gap across the first vehicle's heading decides most others. Both
    have a margin for rounding, so that the answer is always that of `boxes_overlap`.
    """
    if gap > a.radius + b.radius + _MARGIN or _gap_across(a, b) > _MARGIN:
        return False
    return bool(boxes_overlap(_corners(a), _corners(b)))


def _gap_across(a: _Placed, b: _Placed) -> float:
    """Return the gap between two boxes across the first one's heading [m]. If it is positive, they do not touch."""
    aside = abs((b.x - a.x) * math.sin(a.heading) - (b.y - a.y) * math.cos(a.heading))
    turned = b.heading - a.heading
    half = (abs(math.sin(turned)) * b.size[0] + abs(math.cos(turned)) * b.size[1]) / 2
    return aside - a.size[1] / 2 - half


@lru_cache
def _radius(size: tuple[float, float]) -> float:
    return math.hypot(*size) / 2


def _corners(placed: _Placed) -> Floats:
    return box_corners(np.array([placed.x, placed.y]), np.array(placed.heading), np.array(placed.size))
