"""Environments of users that do what highway-env's own never do, played from their draws."""

import numpy as np
import pytest

from behavexplor.envs.making import make_env
from behavexplor.judge.specs import Destination
from tests.envs.drawn import strange

pytestmark = pytest.mark.filterwarnings("ignore:.*out of date:DeprecationWarning")


def driven(env, action):
    """The trace of a scenario in which the same action is always taken."""
    env.reset(options={"scenario": env.logical.sample(np.random.default_rng(0))})
    while True:
        _, _, terminated, truncated, info = env.step(action)
        if terminated or truncated:
            return info["trace"]


def test_an_arrival_is_where_the_environment_says_it():
    trace = driven(make_env(strange.registered(strange.SaysItLate), {}), 4)
    assert trace.end == "arrived"
    arrived = trace.time[np.flatnonzero(trace.signals["arrived"])]
    assert arrived.tolist() == pytest.approx([5.0])


def test_a_success_that_is_gone_at_the_end_is_none():
    trace = driven(make_env(strange.registered(strange.SucceedsInPassing), {}), 4)
    assert trace.end == "timeout"
    assert Destination().violated(trace)


def test_an_intersection_with_another_reward_has_the_same_destination():
    env = make_env(strange.registered(strange.RewardsOtherwise), {})
    assert Destination().violated(driven(env, 0))
