"""highway-env's `Kinematics` observation without data frames: the same values in a hundredth of the time."""

import math
from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
from gymnasium import spaces
from highway_env.envs.common.observation import KinematicObservation, ObservationType
from highway_env.road.lane import AbstractLane
from highway_env.utils import lmap
from highway_env.vehicle.kinematics import Vehicle
from highway_env.vehicle.objects import RoadObject
from numpy.typing import NDArray

from behavexplor.data import scene
from behavexplor.data.array_types import Floats

FEATURES = (
    *("presence", "x", "y", "vx", "vy", "heading", "cos_h", "sin_h"),
    *("cos_d", "sin_d", "long_off", "lat_off", "ang_off"),
)
RELATIVE = ("x", "y", "vx", "vy")  # relative to the ego unless `absolute`
ORDERS = ("sorted", "shuffled")


class Kinematics(KinematicObservation):  # type: ignore[misc]
    """Kinematics observation, equal to `highway_env.envs.common.observation.KinematicObservation` in every value.

    The observation is a float32 array of shape (vehicles_count, features). The ego's row comes first, and rows without
    a vehicle are 0. All options and their defaults are highway-env's.

    There is one difference. With a `vehicles_count` of 1, highway-env shows every vehicle, in a shape that its own
    space does not contain. This class shows the ego only.
    """

    features: list[str]
    features_range: dict[str, list[float]] | None

    def __init__(self, env: Any, **config: Any) -> None:
        super().__init__(env, **config)
        self.features = list(self.features)

    def observe(self) -> NDArray[Any]:
        """Return the observation of the current state."""
        if not self.env.road:
            return np.zeros(self.space().shape, dtype=np.float32)
        ego = self.observer_vehicle
        seen = [ego, *self._close_objects(ego)]
        table = np.zeros((self.vehicles_count, len(self.features)))
        columns = _Columns(seen, self.observe_intentions)
        for i, feature in enumerate(self.features):
            column = columns.of(feature)
            if feature in RELATIVE and not self.absolute:
                column = column.copy()
                column[1:] -= column[0]
            table[: len(seen), i] = column
        if self.normalize:
            self._normalize(table[: len(seen)])
        if self.order == "shuffled":
            self.env.np_random.shuffle(table[1:])
        return table.astype(np.float32)

    def _close_objects(self, ego: Vehicle) -> list[RoadObject]:
        """Return the other vehicles, and obstacles if they are included, that get a row: `Road.close_objects_to`."""
        candidates = [(vehicle, self.see_behind) for vehicle in self.env.road.vehicles if vehicle is not ego]
        if self.include_obstacles:
            candidates += [(obstacle, False) for obstacle in self.env.road.objects]
        lane, behind = ego.lane, -2 * ego.LENGTH
        own = lane.local_coordinates(ego.position)[0]
        close = []
        for other, whole_circle in candidates:
            gap = other.position - ego.position
            if not math.sqrt(gap[0] * gap[0] + gap[1] * gap[1]) < self.env.PERCEPTION_DISTANCE:
                continue
            ahead = lane.local_coordinates(other.position)[0] - own
            if whole_circle or behind < ahead:
                close.append((abs(ahead), other))
        if self.order == "sorted":
            close.sort(key=lambda entry: entry[0])
        return [other for _, other in close[: self.vehicles_count - 1]]

    def _normalize(self, rows: Floats) -> None:
        if not self.features_range:
            self.features_range = default_ranges(self.n_side_lanes())
        for i, feature in enumerate(self.features):
            if feature in self.features_range:
                low, high = self.features_range[feature]
                rows[:, i] = lmap(rows[:, i], [low, high], [-1, 1])
                if self.clip:
                    np.clip(rows[:, i], -1, 1, out=rows[:, i])

    def n_side_lanes(self) -> int:
        """Return the number of parallel lanes where the ego is."""
        return len(self.env.road.network.all_side_lanes(self.observer_vehicle.lane_index))


def default_ranges(n_side_lanes: int) -> dict[str, list[float]]:
    """Return highway-env's default ranges of the features for an ego on a road with `n_side_lanes` lanes."""
    return {
        "x": [-5.0 * Vehicle.MAX_SPEED, 5.0 * Vehicle.MAX_SPEED],
        "y": [-AbstractLane.DEFAULT_WIDTH * n_side_lanes, AbstractLane.DEFAULT_WIDTH * n_side_lanes],
        "vx": [-2 * Vehicle.MAX_SPEED, 2 * Vehicle.MAX_SPEED],
        "vy": [-2 * Vehicle.MAX_SPEED, 2 * Vehicle.MAX_SPEED],
    }


class _Columns:
    """Features of some objects, the ego first. Each has shape (objects,) and is computed only when it is requested."""

    def __init__(self, objects: list[RoadObject], observe_intentions: bool) -> None:
        self._objects = objects
        self._observe_intentions = observe_intentions
        self._is_vehicle = np.array([isinstance(thing, Vehicle) for thing in objects])
        self._position = np.array([thing.position for thing in objects])
        self._heading = np.array([thing.heading for thing in objects], dtype=np.float64)
        self._direction = np.cos(self._heading), np.sin(self._heading)

    def of(self, feature: str) -> Floats:
        """Return one feature. It is NaN for obstacles that have no such feature in highway-env."""
        return _FEATURES[feature](self)

    def presence(self) -> Floats:
        return np.ones(len(self._objects))

    def position(self, axis: int) -> Floats:
        return self._position[:, axis]

    def velocity(self, axis: int) -> Floats:
        speed = np.array([thing.speed for thing in self._objects], dtype=np.float64)
        return np.where(self._is_vehicle, speed * self._direction[axis], 0.0)

    def heading(self) -> Floats:
        return np.where(self._is_vehicle, self._heading, np.nan)

    def direction(self, axis: int) -> Floats:
        return self._direction[axis]

    @cached_property
    def destination_direction(self) -> Floats:
        """Unit vectors toward the objects' destinations, shape (objects, 2); zeros if a destination is unknown."""
        directions = np.zeros((len(self._objects), 2))
        for i, thing in enumerate(self._objects):
            if isinstance(thing, Vehicle) and (i == 0 or self._observe_intentions):
                directions[i] = thing.destination_direction
        return directions

    @cached_property
    def lane_offset(self) -> Floats:
        """Station [m], offset [m] and angle [rad] of the objects in their lanes, NaN for obstacles; (objects, 3)."""
        offsets = np.full((len(self._objects), 3), np.nan)
        for i, thing in enumerate(self._objects):
            if isinstance(thing, Vehicle):
                lane = thing.lane  # read once: an NPC searches for its lane on every access
                station, offset = lane.local_coordinates(thing.position)
                offsets[i] = station, offset, lane.local_angle(thing.heading, station)
        return offsets


_FEATURES: dict[str, Callable[[_Columns], Floats]] = {
    "presence": _Columns.presence,
    "x": lambda columns: columns.position(0),
    "y": lambda columns: columns.position(1),
    "vx": lambda columns: columns.velocity(0),
    "vy": lambda columns: columns.velocity(1),
    "heading": _Columns.heading,
    "cos_h": lambda columns: columns.direction(0),
    "sin_h": lambda columns: columns.direction(1),
    "cos_d": lambda columns: columns.destination_direction[:, 0],
    "sin_d": lambda columns: columns.destination_direction[:, 1],
    "long_off": lambda columns: columns.lane_offset[:, 0],
    "lat_off": lambda columns: columns.lane_offset[:, 1],
    "ang_off": lambda columns: columns.lane_offset[:, 2],
}


class SceneObservation(ObservationType):  # type: ignore[misc]
    """Float64 array of shape (1 + n_npcs, 8) with the columns of `behavexplor.data.scene`.

    Args:
        env: a `behavexplor.envs.driving.DrivingEnv`.
    """

    def __init__(self, env: Any, **_: Any) -> None:
        super().__init__(env)
        self._shape = (1 + env.logical.n_npcs, scene.N_COLUMNS)

    def space(self) -> spaces.Box:
        """Return the observation space."""
        return spaces.Box(-np.inf, np.inf, shape=self._shape, dtype=np.float64)

    def observe(self) -> NDArray[np.float64]:
        """Return the current scene."""
        rows = np.zeros(self._shape)
        for row, vehicle in zip(rows, self.env.road.vehicles if self.env.road else [], strict=False):
            row[:] = (
                1.0,
                *vehicle.position,
                vehicle.heading,
                vehicle.speed,
                vehicle.action["acceleration"],
                vehicle.LENGTH,
                vehicle.WIDTH,
            )
        return rows
