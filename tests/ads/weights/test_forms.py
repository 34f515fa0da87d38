"""Networks of files of weights act as in the scripts that made them."""

import json

import gymnasium
import numpy as np
import pytest
import torch

from behavexplor.ads.sb3.description import named_env
from behavexplor.ads.sb3.policy import load_policy
from behavexplor.ads.weights.weights_policy import load_weights
from behavexplor.commands import main
from behavexplor.errors import InputError
from tests.ads.sb3.models import make_model
from tests.ads.weights.files import COMMANDS, FORMS, GRID, KINEMATICS, META, Tutorial, dense, write


def answers(path, spaces, observations, activation=None):
    """The answers of a policy to observations, in blocks of several sizes."""
    policy = load_weights(path, activation).seeing(*spaces)
    parts = np.split(observations, [1, 33, 97, 500])
    return np.concatenate([policy.predict(part)[0] for part in parts])


@pytest.mark.parametrize("name", FORMS)
def test_actions_are_those_of_the_script(name, tmp_path):
    form = FORMS[name]
    path, network = write(form, tmp_path)
    observations = np.random.default_rng(1).normal(size=(1000, *form.spaces[0].shape)).astype(np.float32)
    with torch.no_grad():
        outputs = network(torch.from_numpy(observations)).numpy()
    found = answers(path, form.spaces, observations)
    if isinstance(form.spaces[1], gymnasium.spaces.Discrete):
        np.testing.assert_array_equal(found, outputs.argmax(axis=1))
        assert len(np.unique(found)) > 1
    else:
        np.testing.assert_allclose(found, outputs, atol=1e-6)


@pytest.mark.parametrize("function", ["relu", "tanh", "elu", "gelu", "silu", "leaky_relu", "sigmoid", "identity"])
def test_the_function_between_layers_is_torchs(function, tmp_path):
    kinds = {"relu": "ReLU", "tanh": "Tanh", "elu": "ELU", "gelu": "GELU", "silu": "SiLU", "leaky_relu": "LeakyReLU"}
    network = dense(25, 32, 32, 2, function=getattr(torch.nn, kinds.get(function, function.capitalize())))
    torch.save(network.state_dict(), tmp_path / "weights.pth")
    (tmp_path / "weights.yaml").write_text("squash: false")
    observations = np.random.default_rng(1).uniform(-1, 1, size=(600, 5, 5)).astype(np.float32)
    with torch.no_grad():
        rows = [network(torch.from_numpy(row).reshape(1, 25)).clamp(-1, 1).numpy() for row in observations]
    found = answers(tmp_path / "weights.pth", (KINEMATICS, COMMANDS), observations, function)
    np.testing.assert_allclose(found, np.concatenate(rows), atol=1e-6)


def test_parameters_with_a_name_of_their_own_keep_their_biases(tmp_path):
    network = dense(25, 16, 5)
    names = {"0.weight": "fc1_weight", "0.bias": "fc1_bias", "2.weight": "fc2_weight", "2.bias": "fc2_bias"}
    torch.save({names[name]: array for name, array in network.state_dict().items()}, tmp_path / "weights.pth")
    observations = np.random.default_rng(0).normal(size=(50, 5, 5)).astype(np.float32)
    with torch.no_grad():
        expected = network(torch.as_tensor(observations.reshape(50, 25))).argmax(1)
    spaces = gymnasium.make("highway-fast-v0").unwrapped
    policy = load_weights(tmp_path / "weights.pth", "relu").seeing(spaces.observation_space, spaces.action_space)
    assert policy.predict(observations)[0].tolist() == expected.tolist()


def test_a_network_is_the_same_in_a_zip_to_the_last_bit(tmp_path):
    box = gymnasium.spaces.Box(-np.inf, np.inf, (25,), np.float32)
    model = make_model("PPO", box, COMMANDS)
    model.save(tmp_path / "model.zip")
    torch.save(model.policy.state_dict(), tmp_path / "policy.pth")
    observations = np.random.default_rng(1).normal(size=(1000, 5, 5)).astype(np.float32)
    zipped = load_policy(tmp_path / "model.zip").seeing(KINEMATICS, COMMANDS)
    found = answers(tmp_path / "policy.pth", (KINEMATICS, COMMANDS), observations, "relu")
    np.testing.assert_array_equal(found, zipped.predict(observations)[0])
    loaded = load_weights(tmp_path / "policy.pth", "relu").seeing(KINEMATICS, COMMANDS)
    noise = np.random.default_rng(2).uniform(size=(1000, 2))
    drawn = [policy.draw(observations, None, None, noise)[0] for policy in (loaded, zipped)]
    np.testing.assert_array_equal(*drawn)


def test_logits_are_drawn_by_their_probabilities_and_values_are_not_drawn(tmp_path):
    path, network = write(FORMS["actor-critic"], tmp_path)
    policy = load_weights(path).seeing(KINEMATICS, META)
    assert policy.noise == 1
    observation = np.random.default_rng(1).normal(size=(1, 5, 5)).astype(np.float32)
    noise = np.random.default_rng(2).uniform(size=(20_000, 1))
    drawn = policy.draw(np.repeat(observation, 20_000, axis=0), None, None, noise)[0]
    with torch.no_grad():
        expected = network(torch.from_numpy(observation)).softmax(1)[0].numpy()
    np.testing.assert_allclose(np.bincount(drawn, minlength=5) / 20_000, expected, atol=0.02)
    assert load_weights(write(FORMS["dueling"], tmp_path)[0]).seeing(KINEMATICS, META).noise == 0


def test_a_flag_says_the_function(tmp_path):
    torch.save(Tutorial().state_dict(), tmp_path / "weights.pth")
    load_weights(tmp_path / "weights.pth", "relu")


@pytest.mark.slow
@pytest.mark.parametrize("name", FORMS)
def test_each_form_is_fuzzed_with_one_command(name, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    path, _ = write(FORMS[name], tmp_path)
    env = [] if name == "rl_agents" else ["--env", "highway-fast-v0"]
    arguments = ["fuzz", *env, "--ads", path.name, "--budget", "6", "--workers", "0", "--unconfined", "--out", "run"]
    assert main(arguments) == 0
    said = capfd.readouterr()
    assert "6 executions" in said.out
    assert ("flattened" in said.err) == (FORMS[name].spaces[0] is KINEMATICS)


@pytest.mark.slow
def test_the_first_try_of_a_flat_model_drives(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    make_model("DQN", gymnasium.spaces.Box(-np.inf, np.inf, (25,), np.float32)).save("model.zip")
    arguments = ["fuzz", "--env", "highway-v0", "--ads", "model.zip", "--budget", "4", "--workers", "0", "--unconfined"]
    assert main(arguments) == 0
    said = " ".join(capfd.readouterr().err.split())
    assert "observations of the shape (5, 5) are flattened for the policy, as in training" in said


def test_rl_agents_metadata_names_the_environment(tmp_path):
    path, _ = write(FORMS["rl_agents"], tmp_path)
    assert named_env(None, str(path)) == "highway-fast-v0"
    assert load_weights(path).env_config == {"duration": 20}
    (tmp_path / "metadata.0.123.json").write_text(json.dumps({"agent": {"model": 3}, "env": []}))
    assert load_weights(path).description.activation == "relu"


def test_metadata_that_cannot_be_read_is_named(tmp_path):
    path, metadata = tmp_path / "checkpoint-best.tar", tmp_path / "metadata.1.json"
    torch.save({"state_dict": dense(25, 64, 5).state_dict()}, path)
    metadata.mkdir()
    with pytest.raises(InputError, match=r"metadata\.1\.json cannot be read"):
        load_weights(path)
    metadata.rmdir()
    metadata.write_text("{")
    with pytest.raises(InputError, match=r"metadata\.1\.json cannot be read"):
        load_weights(path)
    metadata.write_text("[1]")
    with pytest.raises(InputError, match=r"metadata\.1\.json must contain keys and values"):
        load_weights(path)


def test_convolutions_of_rl_agents_have_steps_of_two(tmp_path):
    torch.manual_seed(3)
    network = torch.nn.Module()
    grids = [torch.nn.Conv2d(*channels, 2, stride=2) for channels in ((4, 16), (16, 32), (32, 64))]
    network.conv1, network.conv2, network.conv3 = grids
    network.head = torch.nn.Module()
    network.head.layers, network.head.predict = torch.nn.ModuleList([torch.nn.Linear(64, 32)]), torch.nn.Linear(32, 5)
    torch.save({"state_dict": network.state_dict(), "optimizer": {}}, tmp_path / "latest.tar")
    agent = {
        "model": {"type": "ConvolutionalNetwork", "activation": "RELU", "head_mlp": {"type": "MultiLayerPerceptron"}}
    }
    (tmp_path / "metadata.1.2.json").write_text(json.dumps({"agent": agent, "env": {"id": "highway-v0"}}))
    observations = np.random.default_rng(1).normal(size=(1000, *GRID.shape)).astype(np.float32)
    with torch.no_grad():
        seen = torch.from_numpy(observations)
        for one in grids:
            seen = torch.relu(one(seen))
        expected = network.head.predict(torch.relu(network.head.layers[0](seen.flatten(1)))).argmax(1).numpy()
    np.testing.assert_array_equal(answers(tmp_path / "latest.tar", (GRID, META), observations), expected)
