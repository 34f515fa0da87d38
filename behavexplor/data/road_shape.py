"""The shape of a road for pictures: surfaces, borders and lines between lanes; and its lanes as a plan for other tools.

Both kinds of roads become a plan: the map of a functional scenario by `plan_of_map`, and the road of a highway-env
environment by `behavexplor.envs.highway.course.road_plan`.
"""

import json
import math
from dataclasses import dataclass, field, replace
from typing import Any, Final, Self

import numpy as np
from numpy.typing import ArrayLike

from behavexplor.data.array_types import Floats
from behavexplor.data.geometry import point_segment_distances
from behavexplor.data.roadmap import Lane, RoadMap
from behavexplor.data.untrusted import object_fields, parse_json
from behavexplor.errors import InputError

ROAD_FILE: Final = "road.json"  # file in the run folder of a highway-env environment
DASH, PERIOD = 3.0, 6.0  # length of a dash between lanes, and distance of the starts of two of them [m]
MOST_POINTS: Final = 1_000_000  # of a road, dashes included
FARTHEST: Final = 1e7  # greatest coordinate [m]
_FIELDS: Final = ("surfaces", "striped", "borders")


@dataclass(frozen=True, eq=False)
class RoadShape:
    """The shape of a road, with lengths in meters."""

    surfaces: tuple[Floats, ...]  # polygons, each of shape (n, 2)
    striped: tuple[Floats, ...] = ()  # lines between lanes, each of shape (n, 2)
    borders: tuple[Floats, ...] = ()  # lines at the sides of roads, each of shape (n, 2)
    line_kinds: tuple[str, ...] = ()  # kinds of the illegal lines in a trace
    routes: dict[str, Floats] = field(default_factory=dict)  # center lines of NPCs' routes by name, of shape (n, 2)

    @property
    def n_points(self) -> int:
        """Number of points, plus about the number of dashes."""
        lengths = (np.hypot(*np.diff(line, axis=0).T).sum() for line in self.striped)
        return sum(len(line) for line in (*self.surfaces, *self.striped, *self.borders)) + int(sum(lengths) / PERIOD)

    def dashes(self, low: Floats, high: Floats) -> list[Floats]:
        """Return the dashes of the striped lines in the rectangle from `low` to `high` [m], each of shape (2, 2).

        `low` are the least x and y, `high` the greatest.
        """
        found = []
        for line in self.striped:
            ends = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
            starts = np.arange(0.0, ends[-1], PERIOD)
            stations = np.stack([starts, np.minimum(starts + DASH, ends[-1])], axis=1)
            points = np.stack([np.interp(stations, ends, line[:, axis]) for axis in (0, 1)], axis=-1)
            inside = ((points >= low) & (points <= high)).all((1, 2))
            found += list(points[inside])
        return found

    def to_json(self) -> str:
        """Return surfaces, striped lines and borders as JSON, from which `from_json` restores them."""
        return json.dumps({name: [np.round(line, 2).tolist() for line in getattr(self, name)] for name in _FIELDS})

    @classmethod
    def from_json(cls, text: str) -> Self:
        """Read the shape that `to_json` wrote.

        Raises:
            InputError: if it is not one.
        """
        values = object_fields("the shape of a road", parse_json(text, "the shape of a road"), _FIELDS)
        surfaces, striped, borders = (
            tuple(_line(name, points) for points in _listed(name, values[name])) for name in _FIELDS
        )
        made = cls(surfaces, striped, borders)
        if made.n_points > MOST_POINTS:
            raise InputError(f"The shape of a road has at most {MOST_POINTS} points and dashes, not {made.n_points}")
        return made


def _listed(name: str, value: Any) -> list[Any]:
    if not isinstance(value, list):
        raise InputError(f"{name} of the shape of a road must be a list of lines")
    return value


def _line(name: str, points: Any) -> Floats:
    try:
        line = np.array(points, dtype=np.float64)
    except (TypeError, ValueError):
        line = np.zeros(0)
    if line.ndim != 2 or line.shape[1] != 2 or len(line) < 2 or not (np.abs(line) <= FARTHEST).all():
        raise InputError(f"{name} of the shape of a road must be lines of at least two points within {FARTHEST:g} m")
    return line


NO_LINE, BROKEN, SOLID = "none", "broken", "solid"  # markings, besides the kinds of illegal lines
_ON_LINE: Final = 0.01  # greatest distance of a lane's border from the line that marks it [m]


@dataclass(frozen=True)
class SineLane(Lane):
    """A lane whose center line is a sine along a straight axis, as highway-env defines it.

    Stations and `length` are measured along the axis, and `x`, `y` and `heading` are those of the axis.
    """

    amplitude: float = 0.0  # amplitude of the sine [m]
    pulsation: float = 0.0  # angular frequency along the axis [rad/m]
    phase: float = 0.0  # phase at the start [rad]

    def pose(self, station: ArrayLike) -> Floats:
        """Compute the position and heading at some stations along the axis; see `Lane.pose`."""
        s = np.asarray(station, dtype=np.float64)
        angle = self.pulsation * s + self.phase
        offset, slope = self.amplitude * np.sin(angle), self.amplitude * self.pulsation * np.cos(angle)
        cos, sin = math.cos(self.heading), math.sin(self.heading)
        x, y = self.x + s * cos - offset * sin, self.y + s * sin + offset * cos
        return np.stack([x, y, self.heading + np.arctan(slope)], axis=-1)


@dataclass(frozen=True)
class PlannedLane:
    """A lane with its markings."""

    lane: Lane  # the lane
    left: str  # marking of its left border: `NO_LINE`, `BROKEN`, `SOLID`, or a kind of an illegal line
    right: str  # marking of its right border
    speed_limit: float | None  # speed limit [m/s]; None without one


RoadPlan = tuple[PlannedLane, ...]  # all lanes of a road


def plan_of_map(roadmap: RoadMap) -> RoadPlan:
    """Return the plan of a map. Parallel lanes are separated by broken lines outside junctions."""
    return tuple(_planned(lane, roadmap) for lane in roadmap.lanes)


def _planned(lane: Lane, roadmap: RoadMap) -> PlannedLane:
    beside = [other for other in roadmap.lanes if (other.origin, other.target) == (lane.origin, lane.target)]
    number = beside.index(lane)
    inner = NO_LINE if lane.junction else BROKEN
    left = inner if number > 0 else _edge(lane, roadmap, -0.5)
    right = inner if number < len(beside) - 1 else _edge(lane, roadmap, 0.5)
    return PlannedLane(lane, left, right, roadmap.speed_limit)


def _edge(lane: Lane, roadmap: RoadMap, share: float) -> str:
    """Return the kind of the illegal line along a border of a lane."""
    x, y, heading = lane.pose(lane.length / 2)
    side = share * lane.width
    point = np.array([x - side * np.sin(heading), y + side * np.cos(heading)])
    lines = roadmap.illegal_lines
    gaps = point_segment_distances(point[None], lines)[0]
    kinds = [kind for gap, kind in zip(gaps, roadmap.line_kinds, strict=True) if gap <= _ON_LINE and not lane.junction]
    return kinds[0] if kinds else NO_LINE


def part_of(lane: Lane, begin: float, end: float) -> Lane:
    """Return the part of a lane between two stations [m]."""
    if isinstance(lane, SineLane):
        cos, sin = math.cos(lane.heading), math.sin(lane.heading)
        x, y, phase = lane.x + begin * cos, lane.y + begin * sin, lane.phase + lane.pulsation * begin
        return replace(lane, x=x, y=y, length=end - begin, phase=phase)
    x, y, heading = lane.pose(begin).tolist()
    return replace(lane, x=x, y=y, heading=heading, length=end - begin)
