"""Environments that users of the Python interface give as objects."""

import gymnasium
import numpy as np
import pytest
from gymnasium.wrappers import TimeLimit, TransformReward

from behavexplor.api.campaigns import find_failures
from behavexplor.api.given_environments import environment_of
from behavexplor.errors import InputError


def made(**settings):
    return gymnasium.make("highway-fast-v0", config={"duration": 7}, **settings)


def test_a_wrapper_of_rewards_changes_nothing_for_a_driver():
    name, config = environment_of(TransformReward(made(), lambda reward: 2 * reward))
    assert (name, config["duration"]) == ("highway-fast-v0", 7)


@pytest.mark.parametrize("shorten", [lambda: TimeLimit(made(), 3), lambda: made(max_episode_steps=3)])
def test_a_limit_that_a_campaign_would_not_keep_is_refused(shorten):
    with pytest.raises(InputError, match="after 3 steps"):
        environment_of(shorten())


def test_a_scene_may_have_arrays():
    env = gymnasium.make("highway-fast-v0", config={"reward_speed_range": np.array([20.0, 30.0])})
    assert environment_of(env)[1]["reward_speed_range"] == [20.0, 30.0]


def test_a_limit_that_is_never_reached_is_harmless():
    assert environment_of(made(max_episode_steps=100))[1]["duration"] == 7


def test_an_environment_without_driving_is_refused_in_a_sentence(tmp_path):
    with pytest.raises(InputError, match="'CartPole-v1' cannot be fuzzed"):
        find_failures(lambda observation: 0, gymnasium.make("CartPole-v1"), budget=1, out=tmp_path / "run")
