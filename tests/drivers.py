"""Systems under test for the tests: they keep their lane and see nothing."""

import os

import numpy as np


class Cruiser:
    """Drives at 10 m/s, whatever stands in its way."""

    observation = {"type": "Scene"}
    action = {"type": "ContinuousAction", "acceleration_range": [-8.0, 4.0], "steering_range": [-0.6, 0.6]}
    policy_frequency = 10

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        speed = observation[:, 0, 4]
        return np.stack([np.where(speed < 10, 1.0, 1 / 3), 0 * speed], axis=1), state


class Swerver(Cruiser):
    """The same, but it drifts to the left, over the double yellow line."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        actions, state = super().predict(observation, state)
        actions[:, 1] = np.where(np.abs(observation[:, 0, 3] + np.pi / 2) < 0.05, -0.02, 0.02)
        return actions, state


class Faulty(Cruiser):
    """The same, but it cannot be asked near the junction."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        if (observation[:, 0, 2] < 20).any():
            raise ZeroDivisionError("no gap to divide by")
        return super().predict(observation, state)


class Dying(Cruiser):
    """The same, but it takes its whole process down."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        if (observation[:, 0, 2] < 20).any():
            os._exit(11)
        return super().predict(observation, state)


cruiser = Cruiser()


def make_cruiser(roadmap):
    """Made from the road map, as planners are."""
    assert roadmap.speed_limit > 10
    return Cruiser()


def make_nothing(_roadmap):
    return 3
