import copy
import pickle
from concurrent.futures import ThreadPoolExecutor

import gymnasium
import numpy as np
import pytest
import torch

from behavexplor.ads.sb3.blocks import BlockwiseNetwork
from tests.ads.sb3.models import BOX, COMMANDS, META, make_model

WIDE = gymnasium.spaces.Box(-2.0, 3.0, (3,), np.float32)
PRECISE = gymnasium.spaces.Box(-np.inf, np.inf, (16,), np.float64)
SIZES = (1, 4, 63, 64, 65, 150, 4)


def network_of(name, space, action_space, layers, activation=torch.nn.Tanh, **keywords):
    """A network whose biases are not 0, as after training."""
    options = {"net_arch": layers, "activation_fn": activation}
    policy = make_model(name, space, action_space, policy_kwargs=options, **keywords).policy
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for values in policy.parameters():
            values.mul_(1.7).add_(torch.randn(values.shape, generator=generator) * 0.2)
    return BlockwiseNetwork(policy)


def seen_by(policy, count):
    space = policy._network.observation_space
    return np.random.default_rng(count).normal(scale=2, size=(count, *space.shape)).astype(space.dtype)


@pytest.mark.parametrize(
    ("name", "space", "action_space", "layers", "activation"),
    [
        ("PPO", BOX, COMMANDS, [64, 64], torch.nn.Tanh),
        ("PPO", BOX, WIDE, [20, 33], torch.nn.Tanh),
        ("PPO", PRECISE, META, [64, 64], torch.nn.Tanh),
        ("PPO", PRECISE, META, [16, 7], torch.nn.SiLU),
        ("PPO", BOX, COMMANDS, [], torch.nn.Tanh),
        ("A2C", BOX, META, [8, 48], torch.nn.ELU),
        ("TRPO", PRECISE, WIDE, [32], torch.nn.LeakyReLU),
        ("DQN", BOX, META, [256, 256], torch.nn.ReLU),
        ("DQN", PRECISE, META, [9], torch.nn.Tanh),
    ],
)
def test_actions_are_equal_to_those_of_predict_to_the_last_bit(name, space, action_space, layers, activation):
    policy = network_of(name, space, action_space, layers, activation, **({"use_sde": False} if name == "A2C" else {}))
    assert policy._actor is not None
    for count in SIZES:
        seen = seen_by(policy, count)
        actions, memory = policy.ask(seen, None, None)
        expected, _ = policy._predict(seen, None, None, None)
        assert (actions.dtype, memory) == (expected.dtype, None)
        np.testing.assert_array_equal(actions, expected)


@pytest.mark.parametrize("shape", [(), (1,), (1, 2), (2, 1)])
def test_actions_have_the_shape_of_their_space(shape):
    policy = network_of("PPO", BOX, gymnasium.spaces.Box(-1.0, 1.0, shape, np.float32), [8])
    seen = seen_by(policy, 3)
    actions, _ = policy.ask(seen, None, None)
    np.testing.assert_array_equal(actions, policy._predict(seen, None, None, None)[0])
    assert actions.shape == (3, *shape)


def test_a_network_can_be_asked_for_whole_blocks_again():
    policy = network_of("PPO", BOX, COMMANDS, [8])
    block = seen_by(policy, 64)
    expected, _ = policy._network.predict(block, deterministic=True)
    policy._predict(block[:1], None, None, None)
    np.testing.assert_array_equal(policy._network.predict(block, deterministic=True)[0], expected)


def test_a_policy_answers_several_threads():
    policy = network_of("PPO", BOX, COMMANDS, [64])
    questions = [seen_by(policy, 3 + number % 5) for number in range(200)]
    expected = [policy.ask(seen, None, None)[0] for seen in questions]
    with ThreadPoolExecutor(4) as threads:
        answers = list(threads.map(lambda seen: policy.ask(seen, None, None)[0], questions))
    for answer, wanted in zip(answers, expected, strict=True):
        np.testing.assert_array_equal(answer, wanted)


@pytest.mark.parametrize(
    ("name", "keywords"), [("SAC", {}), ("A2C", {"use_sde": True}), ("MaskablePPO", {}), ("QRDQN", {})]
)
def test_other_policies_are_left_to_predict(name, keywords):
    assert BlockwiseNetwork(make_model(name, **keywords).policy)._actor is None


@pytest.mark.parametrize("deviation", [-np.inf, np.nan])
def test_a_policy_that_cannot_answer_is_left_to_predict(deviation):
    policy = make_model("PPO").policy
    torch.nn.init.constant_(policy.log_std, deviation)
    network = BlockwiseNetwork(policy)
    assert network._actor is None
    with pytest.raises(ValueError, match="Expected parameter"):
        network.ask(seen_by(network, 2), None, None)


@pytest.mark.parametrize("action_space", [COMMANDS, META])
def test_a_network_that_answers_nan_fails_as_in_its_library(action_space):
    policy = network_of("PPO", BOX, action_space, [8])
    seen = seen_by(policy, 3)
    seen[1, 2, 3] = np.nan
    with pytest.raises(ValueError, match="Expected parameter"):
        policy.ask(seen, None, None)


def test_numbers_beyond_single_precision_are_answered_as_in_its_library():
    policy = network_of("PPO", PRECISE, COMMANDS, [8])
    seen = seen_by(policy, 2)
    seen[:, 7] = 1e300
    np.testing.assert_array_equal(policy.ask(seen, None, None)[0], policy._predict(seen, None, None, None)[0])


def test_an_observation_of_a_wrong_shape_is_refused_as_in_its_library():
    policy = network_of("PPO", BOX, COMMANDS, [8])
    with pytest.raises(ValueError, match="Unexpected observation shape"):
        policy.ask(np.zeros((2, 3, 3), dtype=np.float32), None, None)


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda policy: pickle.loads(pickle.dumps(policy))])
def test_a_copy_answers_likewise(copied):
    policy = network_of("PPO", BOX, COMMANDS, [8, 20])
    seen = seen_by(policy, 5)
    expected, _ = policy.ask(seen, None, None)
    np.testing.assert_array_equal(copied(policy).ask(seen, None, None)[0], expected)
