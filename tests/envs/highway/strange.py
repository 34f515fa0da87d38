"""Environments of users that do what highway-env's own never do."""

import gymnasium
import numpy as np
from highway_env.envs.highway_env import HighwayEnvFast
from highway_env.envs.intersection_env import IntersectionEnv
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.behavior import IDMVehicle

MODULE = __name__
draws = np.random.default_rng(0)


class Brief(HighwayEnvFast):
    @classmethod
    def default_config(cls):
        return {**super().default_config(), "vehicles_count": 5, "duration": 5}


class Mirrored(gymnasium.ActionWrapper):
    """Takes "left" for "right"."""

    def action(self, action):
        return {0: 2, 2: 0}.get(action, action)


def mirrored(**keywords):
    return Mirrored(Brief(**keywords))


def rewarded(**keywords):
    return gymnasium.wrappers.TransformReward(Brief(**keywords), lambda reward: -reward)


def flattened(**keywords):
    return gymnasium.wrappers.FlattenObservation(Brief(**keywords))


def limited(**keywords):
    return gymnasium.wrappers.TimeLimit(Brief(**keywords), 3)


class WithoutConfig(HighwayEnvFast):
    """Takes no configuration."""

    def __init__(self, render_mode=None):
        super().__init__({"vehicles_count": 5, "duration": 5}, render_mode)


class OnManyRoads(Brief):
    """Has another road in every episode."""

    def lanes(self):
        return int(self.np_random.integers(2, 5))

    def _create_road(self):
        network = RoadNetwork.straight_road_network(self.lanes(), speed_limit=30)
        self.road = Road(network=network, np_random=self.np_random)


class SeldomOnAnotherRoad(OnManyRoads):
    """Has another road once in a million episodes."""

    def lanes(self):
        return 3 if self.np_random.uniform() > 1 - 1e-6 else 4


class DrawsItsConfig(Brief):
    """Draws a key of its configuration in every reset."""

    def _create_vehicles(self):
        self.config["ego_spacing"] = self.np_random.uniform(1.0, 3.0)
        super()._create_vehicles()


class DrawsElsewhere(Brief):
    """Draws the ego's speed by numpy's global generator."""

    def _create_vehicles(self):
        super()._create_vehicles()
        self.vehicle.speed = np.random.uniform(20.0, 30.0)  # noqa: NPY002 - as users do


class SaysItLate(Brief):
    """Says only near its end whether it is a success, as Stable-Baselines3 asks at the end only."""

    def step(self, action):
        *result, info = super().step(action)
        return *result, {**info, "is_success": True} if self.time >= 3 else info


class SucceedsInPassing(Brief):
    """Is a success in the middle of its episode, and no longer at its end."""

    def step(self, action):
        *result, info = super().step(action)
        return *result, {**info, "is_success": self.time == 3}


class RewardsOtherwise(IntersectionEnv):
    """An intersection whose reward has other terms than highway-env's."""

    @classmethod
    def default_config(cls):
        return {**super().default_config(), "initial_vehicle_count": 0, "spawn_probability": 0.0, "duration": 3}

    def _rewards(self, action):
        return {"speed_reward": self.vehicle.speed}


def registered(kind, **settings):
    """Register an environment, and return the name by which it is made."""
    name = f"{kind.__name__.lower()}-v0"
    if name not in gymnasium.registry:
        gymnasium.register(name, entry_point=kind, **settings)
    return f"{MODULE}:{name}"


class Nervous(IDMVehicle):
    """Brakes now and then, by draws that no environment knows of: they go on from one episode to the next."""

    def act(self, action=None):
        super().act(action)
        if draws.random() < 0.3:
            self.action["acceleration"] = -5.0
