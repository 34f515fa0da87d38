"""Roads and vehicles of scripted scenarios as objects of highway-env.

A road map is a road network with a fast search for the closest lane. The ego is a vehicle of highway-env, and NPCs play
back their motion tables.

highway-env's code runs here with the trigonometry of the C library and plain dot products instead of numpy's. On some
processors numpy's trigonometry differs from the C library's in the last bit, and the BLAS library fuses the
multiplication and the addition of a dot product. highway-env's steering toward a lane is unstable below about 1 m/s, so
a difference in the last bit grows to meters. With numpy's arithmetic, an episode would not repeat on another machine,
and it would diverge from the kernels of the vector environment.
"""

import math
from collections.abc import Callable
from functools import cache, partial
from types import FunctionType, SimpleNamespace
from typing import TypeVar, cast

import numpy as np
from highway_env.road.lane import AbstractLane, CircularLane, LineType, StraightLane
from highway_env.road.road import LaneIndex, Road, RoadNetwork
from highway_env.utils import wrap_to_pi
from highway_env.vehicle.controller import MDPVehicle
from highway_env.vehicle.kinematics import Vehicle

from behavexplor.data.array_types import Floats
from behavexplor.data.conventions import EGO_SIZE
from behavexplor.data.npc_motion import ACCELERATION, HEADING, SPEED, X, Y
from behavexplor.data.roadmap import Lane, RoadMap, Route

Function = TypeVar("Function", bound=Callable[..., object])


def _dot(a: Floats, b: Floats) -> float:
    """Return the dot product of two vectors of length 2, without the fused operations of some BLAS kernels."""
    return float(a[0] * b[0] + a[1] * b[1])


def _norm(a: Floats) -> float:
    """Return the norm of a vector of length 2."""
    return math.sqrt(_dot(a, a))


_NUMPY = SimpleNamespace(
    **vars(np)
    | {"sin": math.sin, "cos": math.cos, "tan": math.tan}
    | {"arcsin": math.asin, "arctan": math.atan, "arctan2": math.atan2}
    | {"dot": _dot, "linalg": SimpleNamespace(norm=_norm)}
)


@cache
def with_c_library(function: Function) -> Function:
    """Return a copy of a function that uses the C library and plain dot products, for use in a method of a subclass.

    Methods look the function up at each call, since a program may replace it. Its module imports numpy as `np`, and it
    applies trigonometry to scalars, and `dot` and `linalg.norm` to vectors of length 2. A callable of another type is
    returned as it is.
    """
    if not isinstance(function, FunctionType):
        return function
    original = cast("FunctionType", function)
    names = {**original.__globals__, "np": _NUMPY}
    copy = FunctionType(original.__code__, names, original.__name__, original.__defaults__, original.__closure__)
    return cast("Function", copy)


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
    """highway-env's straight lane with plain arithmetic."""

    def local_coordinates(self, position: Floats) -> tuple[float, float]:
        """Return the station and the offset of a point [m]."""
        return with_c_library(StraightLane.local_coordinates)(self, position)  # type: ignore[no-any-return]


class _Arc(CircularLane):  # type: ignore[misc]
    """highway-env's circular lane with the C library's trigonometry."""

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
    style = {"width": lane.width, "line_types": (LineType.NONE, dividing), "speed_limit": roadmap.speed_limit}
    if lane.curvature == 0.0:
        return _Straight(lane.pose(0.0)[:2], lane.pose(lane.length)[:2], **style)
    side = math.copysign(math.pi / 2, lane.curvature)
    radius = 1 / abs(lane.curvature)
    towards = lane.heading + side
    center = (lane.x + radius * math.cos(towards), lane.y + radius * math.sin(towards))
    start = towards + math.pi
    return _Arc(center, radius, start, start + lane.curvature * lane.length, clockwise=lane.curvature > 0, **style)


class EgoVehicle(Vehicle):  # type: ignore[misc]
    """highway-env's vehicle with the C library's trigonometry."""

    def step(self, dt: float) -> None:
        """Move for a time [s]."""
        with_c_library(Vehicle.step)(self, dt)


class MetaEgoVehicle(MDPVehicle):  # type: ignore[misc]
    """highway-env's vehicle for meta-actions with the C library's trigonometry."""

    def step(self, dt: float) -> None:
        """Move for a time [s]."""
        with_c_library(MDPVehicle.step)(self, dt)

    def steering_control(self, target_lane_index: LaneIndex) -> float:
        """Return the steering angle [rad] that leads to a lane."""
        angle: float = with_c_library(MDPVehicle.steering_control)(self, target_lane_index)
        return angle


_EGOS = {Vehicle: EgoVehicle, MDPVehicle: MetaEgoVehicle}


def set_size(vehicle: Vehicle, size: tuple[float, float]) -> None:
    """Set the length and width [m] of a single vehicle. highway-env defines them per class."""
    vehicle.LENGTH, vehicle.WIDTH = size
    vehicle.diagonal = float(np.hypot(*size))


def place_ego(make: Callable[..., Vehicle], road: Road, pose: Floats, route: list[LaneIndex]) -> Vehicle:
    """Create the ego, at rest at the start of its route.

    highway-env's own collision response is switched off: it flags collisions too early or without contact, and pushes
    vehicles apart. The environment computes contact instead.

    `make` is the vehicle class of highway-env's action type, `pose` is x [m], y [m] and heading [rad], and `route` has
    highway-env's indexes of the lanes that the ego follows.
    """
    ego = _ego_class(make)(road, pose[:2], heading=float(pose[2]), speed=0.0)
    set_size(ego, EGO_SIZE)
    ego.route = route
    ego.check_collisions = ego.collidable = False
    return ego


def _ego_class(make: Callable[..., Vehicle]) -> Callable[..., Vehicle]:
    """Return this package's subclass of a vehicle class, or the class itself if there is none.

    The class may be wrapped in a `partial`, whose arguments are kept.
    """
    if isinstance(make, partial):
        return partial(_ego_class(make.func), *make.args, **make.keywords)
    return _EGOS.get(make, make)


class ScriptedVehicle(Vehicle):  # type: ignore[misc]
    """An NPC of a `size` (length, width) [m], which plays back its rows (T, 5) of `data.npc_motion.motion_table`."""

    def __init__(self, road: Road, size: tuple[float, float], motion: Floats, route: list[LaneIndex]) -> None:
        self._motion = motion
        self._frame = 0
        super().__init__(road, motion[0, [X, Y]], heading=float(motion[0, HEADING]), speed=float(motion[0, SPEED]))
        set_size(self, size)
        self.route = route
        self.target_speed = float(motion[:, SPEED].max())
        self.action["acceleration"] = float(motion[0, ACCELERATION])
        self.check_collisions = self.collidable = False

    @property
    def lane_index(self) -> LaneIndex:
        """Index of the closest lane, searched for on access."""
        return self.road.network.get_closest_lane_index(self.position, self.heading)

    @lane_index.setter
    def lane_index(self, _: LaneIndex) -> None:
        """Ignore the lane that highway-env sets at the start and in every step: it follows from the position."""

    @property
    def lane(self) -> object:
        """The closest lane, searched for on access."""
        return self.road.network.get_lane(self.lane_index)

    @lane.setter
    def lane(self, _: object) -> None:
        """Ignore the lane, as `lane_index` does."""

    def step(self, dt: float) -> None:  # noqa: ARG002 - the table's rows are steps of the simulation
        """Move to the next row of the motion table."""
        self._frame += 1
        row = self._motion[self._frame]
        self.position = row[[X, Y]]
        self.heading = float(row[HEADING])
        self.speed = float(row[SPEED])
        self.action = {"steering": 0.0, "acceleration": float(row[ACCELERATION])}
