"""Environments of users that do what highway-env's own never do, played from their draws."""

import numpy as np
import pytest

from behavexplor.envs.highway import drawn_env
from behavexplor.envs.making import make_env, make_vector_env
from behavexplor.errors import InputError
from behavexplor.judge.specs import Destination
from tests.envs.highway import strange

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


def test_a_wrapper_of_rewards_matters_only_where_rewards_do():
    env = make_env(strange.registered(strange.rewarded), {})
    make_vector_env(env, 2, {}).close()
    with pytest.raises(InputError, match="does not know the wrapper TransformReward"):
        make_vector_env(env, 2, {}, rewards=True)


@pytest.mark.parametrize(
    ("name", "config", "limit"),
    [
        ("merge-v0", {"action": {"type": "DiscreteMetaAction", "target_speeds": [0, 10, 20]}}, 20),
        (strange.registered(strange.limited), {}, 3),
    ],
)
def test_an_ego_that_stands_still_does_not_drive_for_ever(name, config, limit, monkeypatch):
    monkeypatch.setattr(drawn_env, "MOST_DECISIONS", 20)
    env = make_env(name, config)
    assert len(driven(env, 4).actions) == limit
    envs = make_vector_env(env, 1, {})
    envs.reset(options={"scenarios": [env.logical.sample(np.random.default_rng(0))]})
    ended = [bool(envs.step(np.array([4]))[3][0]) for _ in range(limit)]
    assert ended == [False] * (limit - 1) + [True]


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        (strange.WithoutConfig, "cannot make WithoutConfig by its configuration: "),
        (strange.OnManyRoads, "The road of OnManyRoads changes"),
    ],
)
def test_what_the_engine_cannot_begin_is_refused_before_it_drives(kind, message):
    env = make_env(strange.registered(kind), {})
    with pytest.raises(InputError, match=message):
        make_vector_env(env, 2, {})
    assert driven(env, 4).signals


def test_a_configuration_that_is_drawn_is_the_same_in_every_process():
    env, other = (make_env(strange.registered(strange.DrawsItsConfig), {}) for _ in range(2))
    scenario = env.logical.sample(np.random.default_rng(0))
    (first, _), (again, _) = (each.reset(options={"scenario": scenario}) for each in (env, other))
    assert np.array_equal(first, again)
