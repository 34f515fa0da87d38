"""Systems under test for the tests: they keep their lane and see nothing."""

import os
import signal
import sys

import numpy as np
from threadpoolctl import threadpool_info


class Cruiser:
    """Drives at 10 m/s, whatever stands in its way."""

    observation = {"type": "Scene"}
    action = {"type": "ContinuousAction", "acceleration_range": [-8.0, 4.0], "steering_range": [-0.6, 0.6]}
    policy_frequency = 10
    vectorized = True

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        speed = observation[:, 0, 4]
        return np.stack([np.where(speed < 10, 1.0, 1 / 3), 0 * speed], axis=1), state


class Hermit(Cruiser):
    """The same, but it can be asked for one ego only."""

    vectorized = False

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        assert len(observation) == 1
        return super().predict(observation, state)


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


class Timid(Cruiser):
    """The same, but it cannot be asked when another vehicle is near."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        gaps = np.hypot(*(observation[:, 1:, 1:3] - observation[:, :1, 1:3]).transpose(2, 0, 1))
        if (gaps[observation[:, 1:, 0] > 0] < 6).any():
            raise RuntimeError("somebody is near")
        return super().predict(observation, state)


class Leaver(Cruiser):
    """Calls it a day."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        sys.exit(0)


class Crashing(Cruiser):
    """The same, as if the system had run out of memory."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        os.kill(os.getpid(), signal.SIGKILL)


class Lost(Cruiser):
    """Answers no number after a while."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        actions, state = super().predict(observation, state)
        return np.where(observation[:, :1, 4] > 1, np.nan, actions), state


class Threads(Cruiser):
    """Refuses to drive where numerical libraries may use more than one thread."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        assert all(pool["num_threads"] == 1 for pool in threadpool_info())
        return super().predict(observation, state)


class Settable(Cruiser):
    """A parameter that is no road map keeps its default."""

    def __init__(self, speed=10.0):
        assert speed == 10.0


cruiser = Cruiser()


class Unreadable:
    """A driver whose method cannot be looked at."""

    @property
    def predict(self):
        raise RuntimeError("no predict")


def make_cruiser(roadmap):
    """Made from the road map, as planners are."""
    assert roadmap.speed_limit > 10
    return Cruiser()


def make_nothing():
    return 3


class Ranger(Cruiser):
    """Has a lidar, which only the single environment offers, and drives on whatever it sees."""

    observation = {"type": "LidarObservation"}

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.tile([0.5, 0.0], (len(observation), 1)), state
