"""Road maps as plain data: lanes, routes along them, and the lines that must not be touched.

Environments build the roads of their simulator from a `RoadMap`, planners use it as their map, and samplers derive the
parameter ranges of scenarios from it. The world frame is that of `behavexplor.data.geometry`.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from behavexplor.data.array_types import Floats

DOUBLE_YELLOW, CURB = "double-yellow", "curb"


@dataclass(frozen=True)
class Lane:
    """A lane with a straight or circular center line and a constant width.

    Lanes with the same `origin` and `target` run side by side and are listed from left to right. Stations are distances
    from the start along the center line [m].
    """

    name: str  # name of the lane, unique within the map
    origin: str  # node at which the lane begins
    target: str  # node at which the lane ends
    x: float  # start of the center line [m]
    y: float  # start of the center line [m]
    heading: float  # heading at the start [rad]
    length: float  # length of the center line [m]
    width: float  # width of the lane [m]
    curvature: float = 0.0  # curvature of the center line [1/m], positive for a right turn, 0 for a straight lane
    junction: bool = False  # whether the lane crosses a junction

    def pose(self, station: ArrayLike) -> Floats:
        """Compute x [m], y [m] and heading [rad] at stations, shape (...) [m], also beyond the ends.

        The result has the shape (..., 3).
        """
        s = np.asarray(station, dtype=np.float64)
        heading = self.heading + self.curvature * s
        if self.curvature == 0.0:
            cos, sin = self._direction
            x, y = self.x + s * cos, self.y + s * sin
        else:
            x = self.x + (np.sin(heading) - np.sin(self.heading)) / self.curvature
            y = self.y - (np.cos(heading) - np.cos(self.heading)) / self.curvature
        return np.stack([x, y, heading], axis=-1)

    def pose_at(self, station: float) -> tuple[float, float, float]:
        """Compute x [m], y [m] and heading [rad] at one station; the same numbers as `pose`, in less time."""
        if self.curvature != 0.0:
            x, y, heading = self.pose(station).tolist()
            return x, y, heading
        cos, sin = self._direction
        return self.x + station * cos, self.y + station * sin, self.heading

    @cached_property
    def _direction(self) -> tuple[float, float]:
        return float(np.cos(self.heading)), float(np.sin(self.heading))

    def project(self, x: float, y: float) -> tuple[float, float]:
        """Compute the station and offset (positive to the right) of a point [m], also beyond the lane's ends."""
        dx, dy = x - self.x, y - self.y
        cos, sin = math.cos(self.heading), math.sin(self.heading)
        ahead, aside = dx * cos + dy * sin, dy * cos - dx * sin
        if self.curvature == 0.0:
            return ahead, aside
        radius = 1 / self.curvature
        to_center = radius - aside
        side = math.copysign(1.0, radius)
        station = math.atan2(side * ahead, side * to_center) * radius
        return station, radius - side * math.hypot(ahead, to_center)


@dataclass(frozen=True)
class Route:
    """A sequence of connected lanes. Stations are distances from the start of the first lane."""

    name: str  # name of the route, unique among the map's routes
    lanes: tuple[Lane, ...]  # one or more lanes, each beginning where the previous one ends

    @cached_property
    def bounds(self) -> Floats:
        """Stations at which the lanes begin, and the last one ends [m], shape (lanes + 1,)."""
        return np.concatenate([[0.0], np.cumsum([lane.length for lane in self.lanes])])

    @property
    def length(self) -> float:
        """Length of the route [m]."""
        return float(self.bounds[-1])

    def pose(self, station: ArrayLike) -> Floats:
        """Compute x [m], y [m] and heading [rad] at stations, shape (...) [m].

        The result has the shape (..., 3). The outer lanes are continued beyond the route's ends.
        """
        s = np.asarray(station, dtype=np.float64)
        index = np.searchsorted(self.bounds[1:-1], s, side="right")
        poses = np.empty((*s.shape, 3))
        for i, lane in enumerate(self.lanes):
            here = index == i
            poses[here] = lane.pose(s[here] - self.bounds[i])
        return poses

    def project(self, x: float, y: float) -> tuple[float, float]:
        """Compute the station and offset (positive to the right) of a point on the nearest lane [m].

        The outer lanes are continued beyond the route's ends.
        """
        best = (math.inf, 0.0, 0.0)
        last = len(self.lanes) - 1
        for i, (lane, begin) in enumerate(zip(self.lanes, self.bounds, strict=False)):
            station, offset = lane.project(x, y)
            before = max(-station, 0.0) if i > 0 else 0.0
            behind = max(station - lane.length, 0.0) if i < last else 0.0
            best = min(best, (math.hypot(offset, before + behind), float(begin) + station, offset))
        return best[1:]

    def polyline(self, start: float, end: float, spacing: float = 1.0) -> Floats:
        """Return points of the center line from `start` to `end`, about `spacing` meters apart, shape (P, 2) [m]."""
        count = max(2, int(np.ceil((end - start) / spacing)) + 1)
        return self.pose(np.linspace(start, end, count))[:, :2]


@dataclass(frozen=True, eq=False)
class RoadMap:
    """The map of a functional scenario, with the ego's start and destination."""

    lanes: tuple[Lane, ...]  # all lanes. Parallel lanes are ordered from left to right.
    npc_routes: tuple[Route, ...]  # possible routes of NPCs
    ego_route: Route  # route to the ego's destination and past it
    ego_start: float  # station on the ego's route at which the ego starts [m]
    destination: float  # station on the ego's route that the ego must reach [m]
    illegal_lines: Floats  # end points of the lines that must not be touched, read-only, shape (L, 2, 2) [m]
    line_kinds: tuple[str, ...]  # kind of each illegal line, `DOUBLE_YELLOW` or `CURB`
    speed_limit: float  # speed limit on all lanes [m/s]
    ego_offset: float = 0.0  # how far to the right of its route the ego starts [m]; not 0 if it has to change lanes

    def __post_init__(self) -> None:
        object.__setattr__(self, "illegal_lines", _read_only(self.illegal_lines))

    @cached_property
    def routes(self) -> dict[str, Route]:
        """The NPC routes by name."""
        return {route.name: route for route in self.npc_routes}

    @cached_property
    def start_pose(self) -> Floats:
        """Start of the ego: x [m], y [m] and heading [rad], shape (3,)."""
        x, y, heading = self.ego_route.pose(self.ego_start)
        return np.array([x - self.ego_offset * np.sin(heading), y + self.ego_offset * np.cos(heading), heading])

    @cached_property
    def ego_line(self) -> Floats:
        """Center line of the ego's route, from its start to past its destination, read-only, shape (P, 2) [m]."""
        return _read_only(self.ego_route.polyline(self.ego_start, self.ego_route.length))

    @cached_property
    def destination_point(self) -> Floats:
        """The ego's destination, read-only, shape (2,) [m]."""
        return _read_only(self.ego_route.pose(self.destination)[:2])

    @cached_property
    def destination_direction(self) -> Floats:
        """Unit vector along the lane at the destination, shape (2,)."""
        heading = self.ego_route.pose(self.destination)[2]
        return np.array([np.cos(heading), np.sin(heading)])


def _read_only(array: Floats) -> Floats:
    """Return a read-only copy of an array."""
    copy = array.copy()
    copy.setflags(write=False)
    return copy
