"""A user's own environment: a subclass of highway-env's with another number of lanes and another reward."""

import gymnasium
from highway_env.envs.highway_env import HighwayEnv

NAME = "own-highway-v0"
ID = f"{__name__}:{NAME}"


class OwnHighwayEnv(HighwayEnv):
    @classmethod
    def default_config(cls):
        return {**super().default_config(), "lanes_count": 5, "vehicles_count": 12, "duration": 15}

    def _reward(self, action):
        return self.vehicle.speed / 30 - 2.0 * self.vehicle.crashed


if NAME not in gymnasium.registry:
    gymnasium.register(NAME, entry_point=OwnHighwayEnv)
