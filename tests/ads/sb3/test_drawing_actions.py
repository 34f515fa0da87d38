"""Drawn actions: the distributions of the libraries, from numbers that are handed in."""

import gymnasium
import numpy as np
import pytest
import torch
from scipy.stats import chisquare, kstest

from behavexplor.ads.interface import StochasticADS
from behavexplor.ads.sb3.policy import load_policy
from tests.ads.sb3.models import META, make_model

MANY = 4000
TWO = gymnasium.spaces.MultiDiscrete([3, 2])
BITS = gymnasium.spaces.MultiBinary(3)


def loaded(name, folder, space=None):
    model = make_model(name, action_space=space)
    model.save(folder / "model")
    return load_policy(folder / "model.zip"), model


def same(count, seed=0):
    return np.repeat(np.random.default_rng(seed).normal(size=(1, 7, 5)).astype(np.float32), count, axis=0)


def drawn(policy, observations, seed=0):
    noise = np.random.default_rng(seed).random((len(observations), policy.noise))
    return policy.draw(observations, None, np.ones(len(observations), dtype=bool), noise)[0]


@pytest.mark.parametrize(
    ("name", "space", "noise"),
    [
        ("PPO", None, 2),
        ("PPO", META, 1),
        ("PPO", TWO, 2),
        ("PPO", BITS, 3),
        ("A2C", None, 0),
        ("SAC", None, 2),
        ("TQC", None, 2),
        ("TRPO", None, 2),
        ("RecurrentPPO", None, 2),
        ("MaskablePPO", None, 1),
        ("DQN", None, 0),
        ("QRDQN", None, 0),
        ("TD3", None, 0),
        ("ARS", None, 0),
    ],
)
def test_every_algorithm_says_whether_it_can_draw(name, space, noise, tmp_path):
    policy, _ = loaded(name, tmp_path, space)
    assert policy.noise == noise
    assert isinstance(policy, StochasticADS)
    if noise:
        actions = drawn(policy, same(70))
        assert actions.shape == (70, *policy.action_space.shape)
        assert len(np.unique(actions, axis=0)) > 1
        assert all(policy.action_space.contains(action) for action in actions)


@pytest.mark.parametrize("name", ["PPO", "MaskablePPO"])
def test_categories_have_the_probabilities_of_the_policy(name, tmp_path):
    policy, model = loaded(name, tmp_path, META)
    observation = same(MANY)
    tensor, _ = model.policy.obs_to_tensor(observation[:1])
    expected = model.policy.get_distribution(tensor).distribution.probs.detach().numpy()[0].astype(np.float64)
    counts = np.bincount(drawn(policy, observation), minlength=5)
    assert chisquare(counts, expected / expected.sum() * MANY).pvalue > 1e-3


@pytest.mark.parametrize("name", ["PPO", "SAC"])
def test_numbers_have_the_distribution_of_the_library(name, tmp_path):
    policy, model = loaded(name, tmp_path)
    observation = same(MANY)
    torch.manual_seed(0)
    expected, _ = model.predict(observation, deterministic=False)
    actions = drawn(policy, observation)
    for i in range(2):
        assert kstest(actions[:, i], expected[:, i]).pvalue > 1e-3


@pytest.mark.parametrize(("name", "space"), [("PPO", META), ("PPO", None), ("SAC", None), ("RecurrentPPO", None)])
def test_no_row_depends_on_the_batch(name, space, tmp_path):
    policy, _ = loaded(name, tmp_path, space)
    observation = np.random.default_rng(1).normal(size=(150, 7, 5)).astype(np.float32)
    noise = np.random.default_rng(2).random((150, policy.noise))
    start = np.ones(150, dtype=bool)
    together, _ = policy.draw(observation, None, start, noise)
    for rows in (slice(0, 1), slice(63, 65), slice(100, 150), slice(149, None, -1)):
        again, _ = policy.draw(observation[rows], None, start[rows], noise[rows])
        np.testing.assert_array_equal(again, together[rows])


def test_the_most_probable_actions_stay_what_they_were(tmp_path):
    policy, model = loaded("PPO", tmp_path, META)
    observation = same(1)
    before, _ = policy.predict(observation)
    drawn(policy, same(64))
    assert policy.predict(observation)[0] == before == model.predict(observation, deterministic=True)[0]
