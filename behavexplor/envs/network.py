"""Road maps as road networks of highway-env, with a fast search for the closest lane."""

import math
from functools import cache

import numpy as np
from highway_env.road.lane import AbstractLane, CircularLane, LineType, StraightLane
from highway_env.road.road import LaneIndex, RoadNetwork
from highway_env.utils import wrap_to_pi
from numpy.typing import NDArray

from behavexplor.data.roadmap import Lane, RoadMap, Route
from behavexplor.envs.c_library import with_c_library

Floats = NDArray[np.float64]


class MapNetwork(RoadNetwork):  # type: ignore[misc]
    """highway-env's road network, built from a road map.

    `get_closest_lane_index` gives the same result as highway-env's own method, but computes all lanes at once. A
    vehicle calls it in every step. Computed lane by lane, it would take most of an episode's time.
    """

    def __init__(self, roadmap: RoadMap) -> None:
        super().__init__()
        index_by_name = {}
        for lane in roadmap.lanes:
            beside = len(self.graph.get(lane.origin, {}).get(lane.target, []))
            self.add_lane(lane.origin, lane.target, _simulator_lane(lane, roadmap))
            index_by_name[lane.name] = (lane.origin, lane.target, beside)
        self._index_by_name: dict[str, LaneIndex] = index_by_name
        self._indexes: list[LaneIndex] = [
            (origin, target, i)
            for origin, targets in self.graph.items()
            for target, lanes in targets.items()
            for i in range(len(lanes))
        ]
        lanes = self.lanes_list()
        self._length = np.array([lane.length for lane in lanes])
        self._straight = np.array([isinstance(lane, StraightLane) for lane in lanes])
        self._straight_columns = _columns(lanes, StraightLane, "start", "direction", "heading")
        self._curved_columns = _columns(lanes, CircularLane, "center", "radius", "start_phase", "direction")

    def indexes(self, route: Route) -> list[LaneIndex]:
        """Return highway-env's index of every lane of a route."""
        return [self._index_by_name[lane.name] for lane in route.lanes]

    def get_closest_lane_index(self, position: Floats, heading: float | None = None) -> LaneIndex:
        """Return the index of the lane that is closest in position and, if a heading is given, in heading."""
        station, offset, lane_heading = self._coordinates(position)
        distance = np.abs(offset) + np.maximum(station - self._length, 0) + np.maximum(-station, 0)
        if heading is not None:
            distance += np.abs(wrap_to_pi(heading - lane_heading))
        return self._indexes[int(distance.argmin())]

    def _coordinates(self, position: Floats) -> Floats:
        """Compute the station and offset of a position on every lane, and the lane's heading; shape (3, lanes)."""
        coordinates = np.empty((3, len(self._length)))
        x, y, dx, dy, heading = self._straight_columns
        x, y = position[0] - x, position[1] - y
        coordinates[:, self._straight] = x * dx + y * dy, y * dx - x * dy, heading
        x, y, radius, start, turn = self._curved_columns
        x, y = position[0] - x, position[1] - y
        phase = start + wrap_to_pi(np.arctan2(y, x) - start)
        coordinates[:, ~self._straight] = (
            turn * (phase - start) * radius,
            turn * (radius - np.hypot(x, y)),
            phase + turn * math.pi / 2,
        )
        return coordinates


class _Straight(StraightLane):  # type: ignore[misc]
    """highway-env's straight lane with plain arithmetic; see `behavexplor.envs.c_library`."""

    def local_coordinates(self, position: Floats) -> tuple[float, float]:
        """Return the station and the offset of a point [m]."""
        return with_c_library(StraightLane.local_coordinates)(self, position)  # type: ignore[no-any-return]


class _Arc(CircularLane):  # type: ignore[misc]
    """highway-env's circular lane with the C library's trigonometry; see `behavexplor.envs.c_library`."""

    def position(self, longitudinal: float, lateral: float) -> Floats:
        """Return the point at a station and an offset [m], shape (2,)."""
        return with_c_library(CircularLane.position)(self, longitudinal, lateral)  # type: ignore[no-any-return]

    def local_coordinates(self, position: Floats) -> tuple[float, float]:
        """Return the station and the offset of a point [m]."""
        return with_c_library(CircularLane.local_coordinates)(self, position)  # type: ignore[no-any-return]


LANE_CLASSES = _Straight, _Arc  # whose geometry is that of highway-env's straight and circular lanes


@cache
def road_network(roadmap: RoadMap) -> MapNetwork:
    """Return the network of a map. It is built once, since it never changes."""
    return MapNetwork(roadmap)


def _columns(lanes: list[AbstractLane], kind: type[AbstractLane], *names: str) -> Floats:
    """Return attributes of all lanes of one kind, flattened, shape (values, lanes)."""
    rows = [np.hstack([getattr(lane, name) for name in names]) for lane in lanes if isinstance(lane, kind)]
    return np.array(rows, dtype=np.float64).reshape(-1, 5).T


def _simulator_lane(lane: Lane, roadmap: RoadMap) -> AbstractLane:
    """Return highway-env's lane. It draws dividing lines; the viewer draws double yellow lines and curbs."""
    group = [other for other in roadmap.lanes if (other.origin, other.target) == (lane.origin, lane.target)]
    dividing = LineType.STRIPED if lane is not group[-1] and not lane.junction else LineType.NONE
    style = {
        "width": lane.width,
        "line_types": (LineType.NONE, dividing),
        "speed_limit": roadmap.speed_limit,
    }
    if lane.curvature == 0.0:
        return _Straight(lane.pose(0.0)[:2], lane.pose(lane.length)[:2], **style)
    side = math.copysign(math.pi / 2, lane.curvature)
    radius = 1 / abs(lane.curvature)
    towards = lane.heading + side
    center = (lane.x + radius * math.cos(towards), lane.y + radius * math.sin(towards))
    start = towards + math.pi
    return _Arc(center, radius, start, start + lane.curvature * lane.length, clockwise=lane.curvature > 0, **style)
