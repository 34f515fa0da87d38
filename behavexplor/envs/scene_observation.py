"""The `Scene` observation type: all vehicles in world coordinates, for planners. See `behavexplor.data.scene`."""

from typing import Any

import numpy as np
from gymnasium import spaces
from highway_env.envs.common.observation import ObservationType
from numpy.typing import NDArray

from behavexplor.data import scene


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
