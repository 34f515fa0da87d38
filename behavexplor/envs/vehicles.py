"""The vehicles on the road: the ego is a vehicle of highway-env, and NPCs play back their motion tables."""

from collections.abc import Callable
from functools import partial

import numpy as np
from highway_env.road.road import LaneIndex, Road
from highway_env.vehicle.controller import MDPVehicle
from highway_env.vehicle.kinematics import Vehicle
from numpy.typing import NDArray

from behavexplor.data.npc_motion import ACCELERATION, HEADING, SPEED, X, Y
from behavexplor.data.vehicle_sizes import EGO_SIZE
from behavexplor.envs.c_library import with_c_library

Floats = NDArray[np.float64]


class EgoVehicle(Vehicle):  # type: ignore[misc]
    """highway-env's vehicle with the C library's trigonometry; see `behavexplor.envs.c_library`."""

    def step(self, dt: float) -> None:
        """Move for a time [s]."""
        with_c_library(Vehicle.step)(self, dt)


class MetaEgoVehicle(MDPVehicle):  # type: ignore[misc]
    """highway-env's vehicle for meta-actions with the C library's trigonometry; see `behavexplor.envs.c_library`."""

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

    Args:
        make: the vehicle class of highway-env's action type.
        road: the road on which the ego drives.
        pose: x [m], y [m] and heading [rad] of the start, shape (3,).
        route: highway-env's indexes of the lanes that the ego follows.
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
    """An NPC that plays back its motion table, one row for each step of the simulation.

    Args:
        road: the road on which the NPC drives.
        size: length and width [m].
        motion: the NPC's part of `behavexplor.data.npc_motion.motion_table`, shape (T, 5).
        route: highway-env's indexes of the lanes that the NPC follows.
    """

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
