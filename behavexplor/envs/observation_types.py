"""The observations of the environments, on highway-env's objects."""

from typing import Any

import numpy as np
from gymnasium import spaces
from highway_env.envs.common.observation import KinematicObservation, ObservationType
from highway_env.road.lane import AbstractLane
from highway_env.vehicle.kinematics import Vehicle

from behavexplor.data import scene
from behavexplor.data.array_types import Array, Floats

FEATURES = (
    *("presence", "x", "y", "vx", "vy", "heading", "cos_h", "sin_h"),
    *("cos_d", "sin_d", "long_off", "lat_off", "ang_off"),
)
RELATIVE = ("x", "y", "vx", "vy")  # relative to the ego unless `absolute`
ORDERS = ("sorted", "shuffled")


class Kinematics(KinematicObservation):  # type: ignore[misc]
    """highway-env's `Kinematics` observation: a float32 array of shape (vehicles_count, features).

    The ego's row comes first, and rows without a vehicle are 0. There is one difference. With a `vehicles_count` of 1,
    highway-env shows every vehicle, in a shape that its own space does not contain. This class shows the ego only.
    """

    features: list[str]
    features_range: dict[str, list[float]] | None

    def __init__(self, env: Any, **config: Any) -> None:
        super().__init__(env, **config)
        self.features = list(self.features)

    def observe(self) -> Array:
        """Return the observation of the current state."""
        rows: Array = super().observe()[: self.vehicles_count]
        return rows

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


class SceneObservation(ObservationType):  # type: ignore[misc]
    """All vehicles in world coordinates: float64, (1 + n_npcs, 8), with the columns of `behavexplor.data.scene`."""

    def __init__(self, env: Any, **_: Any) -> None:  # a `behavexplor.envs.driving.DrivingEnv`
        super().__init__(env)
        self._shape = (1 + env.logical.n_npcs, scene.N_COLUMNS)

    def space(self) -> spaces.Box:
        """Return the observation space."""
        return spaces.Box(-np.inf, np.inf, shape=self._shape, dtype=np.float64)

    def observe(self) -> Floats:
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
