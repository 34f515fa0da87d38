"""When the configuration of a policy is known, and which one counts."""

import json

import gymnasium
import numpy as np
import pytest
from highway_env.envs import HighwayEnvFast

from behavexplor.ads.in_memory import GivenDriver
from behavexplor.api.campaigns import config_of
from behavexplor.campaign.config import campaign_config
from behavexplor.execution.simulation import Simulation

ENV = "highway-fast-v0"


class OwnDefaults(HighwayEnvFast):
    @classmethod
    def default_config(cls):
        return super().default_config() | {"vehicles_count": 3}


class Renamed(HighwayEnvFast):
    pass


gymnasium.register("own-defaults-v0", entry_point=OwnDefaults)
gymnasium.register("renamed-v0", entry_point=Renamed)
gymnasium.register("own-registration-v0", entry_point=HighwayEnvFast, kwargs={"config": {"vehicles_count": 3}})


class Trained:
    """A policy that knows its spaces, but not the configuration of its training."""

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (5, 5), np.float32)
    action_space = gymnasium.spaces.Discrete(5)

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.array([1]), state


class Elsewhere(Trained):
    """The same, and it was trained in other traffic, and at another frequency."""

    env_config = {"vehicles_count": 4, "policy_frequency": 5}


def simulated(driver, env, env_config=None):
    config = config_of(GivenDriver("in-memory:it", driver), env, env_config, ())
    assert campaign_config(json.loads(json.dumps({"env_config": config.env_config}))).env_config == config.env_config
    assert config.to_yaml()
    return Simulation(config.env, driver, env_config=config.env_config)


@pytest.mark.parametrize(
    ("env", "env_config", "known"),
    [
        (ENV, None, False),
        (ENV, {}, True),
        (gymnasium.make(ENV), None, True),
        (gymnasium.make("parking-v0"), None, True),  # it has values of numpy
        (f"{__name__}:own-defaults-v0", None, True),
        (f"{__name__}:own-registration-v0", None, True),
        (f"{__name__}:renamed-v0", None, False),
    ],
)
def test_a_configuration_is_known_where_it_is_stated(env, env_config, known):
    driver = Trained()
    if not isinstance(env, str):
        driver.observation_space, driver.action_space = env.observation_space, env.action_space
    assert simulated(driver, env, env_config).is_configured is known


def test_the_scene_is_that_of_the_environment_and_not_that_of_the_training():
    config = simulated(Elsewhere(), gymnasium.make(ENV)).env.config
    assert config["vehicles_count"] == gymnasium.make(ENV).unwrapped.config["vehicles_count"] != 4
    assert config["policy_frequency"] == 5
    assert simulated(Elsewhere(), ENV, {}).env.config["vehicles_count"] == 4
