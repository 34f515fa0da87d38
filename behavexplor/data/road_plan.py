"""Road plans: all lanes of a road with their markings, as other tools need them.

Both kinds of roads become a plan: the map of a functional scenario by `plan_of_map`, and the road of a highway-env
environment by `behavexplor.envs.highway.course.road_plan`.
"""

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from behavexplor.data.array_types import Floats
from behavexplor.data.geometry import point_segment_distances
from behavexplor.data.roadmap import Lane, RoadMap

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
