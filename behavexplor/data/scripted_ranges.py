"""Ranges of scripted scenarios on a map, which can be checked and sampled.

Source: paper section 2.2, for the parameters that are searched (the NPCs' routes and waypoints).
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Final, NamedTuple

import numpy as np

from behavexplor.data.array_types import Floats
from behavexplor.data.conventions import EGO_SIZE, VEHICLE_SIZES
from behavexplor.data.geometry import box_corners, boxes_overlap
from behavexplor.data.roadmap import Lane, RoadMap, Route
from behavexplor.data.scripted import NPC, ScriptedScenario, Waypoint
from behavexplor.errors import InputError, unknown_name

_MARGIN: Final = 1e-6  # much more than roundings change a distance [m]


@dataclass(frozen=True)
class ScriptedRanges:
    """The parameters of a functional scenario and their ranges."""

    name: str  # name of the functional scenario, such as "intersection-straight"
    roadmap: RoadMap  # the map
    n_npcs: int  # number of NPCs in a sampled scenario, and the greatest number in any scenario
    waypoints_per_lane: int  # number of waypoints that an NPC has on each lane of its route
    # least speed at every waypoint except the last one [m/s]; the greatest speed is the speed limit
    min_speed: float = 0.2
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

    def spawn_conflict(self, npc: NPC, others: Sequence[NPC]) -> str | None:
        """Return the spawn rule that a vehicle breaks, or None if it can start beside the other vehicles.

        Args:
            npc: a vehicle with a valid type, route and first position.
            others: vehicles that are already placed.

        Returns:
            The broken rule as the end of the sentence "the vehicle starts ...", or None.
        """
        return self._conflict(self._placed(npc), list(map(self._placed, others)))

    def first_to_fit(self, vehicles: Iterable[NPC], others: Sequence[NPC]) -> NPC | None:
        """Return the first of some vehicles that can start beside others, see `spawn_conflict`; None if none can."""
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

    def start_pose_of(self, npc: NPC) -> Floats:
        """Return the pose at which a vehicle starts: x, y [m] and heading [rad], shape (3,)."""
        return np.array(self.roadmap.routes[npc.route].lanes[0].pose_at(npc.waypoints[0].position))

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
        """Take the random numbers of a scenario, as `sample` does."""
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
        ranges, position, (slowest, fastest) = self.ranges[route.name], 0.0, self.speed_range
        waypoints = []
        for allowed, (along, fast) in zip(ranges, rng.random((len(ranges), 2)).tolist(), strict=True):
            least = max(allowed.start, position)
            position = least + (allowed.end - least) * along
            waypoints.append(Waypoint(position, slowest + (fastest - slowest) * fast))
        waypoints[-1] = Waypoint(position, 0.0)
        return NPC(kind, route.name, tuple(waypoints))

    def place(self, draw: Callable[[], NPC], others: Sequence[NPC], attempts: int = 1000) -> NPC:
        """Draw vehicles until one can start beside the other vehicles, and return it.

        Raises:
            InputError: if none of `attempts` drawn vehicles can be placed.
        """
        npc = self.first_to_fit((draw() for _ in range(attempts)), others)
        if npc is not None:
            return npc
        raise InputError(
            f"{self.name}: none of {attempts} draws could be placed beside {len(others)} NPCs; use fewer NPCs"
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
