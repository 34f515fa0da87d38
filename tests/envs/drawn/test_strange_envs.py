"""Environments of users that do what highway-env's own never do, played from their draws."""

import numpy as np
import pytest

from behavexplor.envs.making import make_env, make_vector_env
from behavexplor.errors import InputError
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


@pytest.mark.parametrize(
    ("name", "config", "message"),
    [
        ("intersection-multi-agent-v0", {}, "has 2 controlled vehicles, and a driver drives one"),
        ("intersection-multi-agent-v1", {"controlled_vehicles": 1}, "has tuples as observations"),
        (
            "highway-fast-v0",
            {"action": {"type": "MultiAgentAction", "action_config": {"type": "DiscreteMetaAction"}}},
            "has tuples as actions",
        ),
    ],
)
def test_an_environment_of_several_egos_is_refused(name, config, message):
    with pytest.raises(InputError, match=message):
        make_env(name, config)


def test_a_wrapper_that_changes_what_a_driver_does_is_not_left_out():
    env = make_env(strange.registered(strange.mirrored), {})
    with pytest.raises(InputError, match="does not know the wrapper Mirrored"):
        make_vector_env(env, 2, {})
