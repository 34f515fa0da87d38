"""Models that go on learning are those that were saved, and none of their code runs."""

import zipfile
from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
import torch
from stable_baselines3 import DQN, PPO
from stable_baselines3.common.vec_env import DummyVecEnv

from behavexplor.ads.sb3.archive import read_archive
from behavexplor.ads.sb3.continuing import continued, learning_rate_of, sub_environments_of
from behavexplor.errors import InputError
from tests.ads.sb3.models import BOX, COMMANDS, META, Payload, Still, make_model
from tests.ads.sb3.test_policy import rewritten


def venv(observation_space=BOX, action_space=COMMANDS):
    return DummyVecEnv([lambda: Still(observation_space, action_space)])


def same(first, second):
    return all(torch.equal(a, b) for a, b in zip(first, second, strict=True))


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("PPO", {"n_steps": 16, "batch_size": 8, "n_epochs": 3, "gamma": 0.9, "ent_coef": 0.01, "learning_rate": 1e-3}),
        ("A2C", {"n_steps": 7, "gae_lambda": 0.8, "vf_coef": 0.3}),
        ("TRPO", {"n_steps": 16, "batch_size": 8, "gamma": 0.95}),
        ("DQN", {"buffer_size": 500, "batch_size": 8, "gamma": 0.8, "learning_starts": 10, "gradient_steps": 2}),
        ("QRDQN", {"buffer_size": 500, "batch_size": 8, "target_update_interval": 5, "learning_starts": 10}),
    ],
)
def test_weights_optimizer_and_hyperparameters_go_on(name, settings, tmp_path):
    model = make_model(name, **settings)
    model.learn(64)
    model.save(tmp_path / "model.zip")
    again = continued(read_archive(tmp_path / "model.zip"), venv(action_space=model.action_space))
    assert type(again) is type(model)
    assert same(again.policy.state_dict().values(), model.policy.state_dict().values())
    old, new = model.policy.optimizer.state_dict()["state"], again.policy.optimizer.state_dict()["state"]
    assert old.keys() == new.keys()
    assert all(same(old[key].values(), new[key].values()) for key in old if name == "PPO")
    for key, value in settings.items():
        if key != "learning_rate":
            assert getattr(again, key) == value
    again.learn(32)
    assert not same(again.policy.state_dict().values(), model.policy.state_dict().values())


def test_an_optimizer_that_also_had_the_target_network_goes_on_with_the_other_one(tmp_path):
    """So Stable-Baselines3 saved a DQN before 2.4.0, and so it is loaded today."""
    model = make_model("DQN", buffer_size=500, batch_size=8, learning_starts=10).learn(64)
    model.save(tmp_path / "new.zip")
    saved = torch.load(BytesIO(read_archive(tmp_path / "new.zip").optimizer), weights_only=True)
    group, count = saved["param_groups"][0], len(saved["param_groups"][0]["params"])
    old = {"state": saved["state"], "param_groups": [{**group, "params": [*range(2 * count)]}]}
    content = BytesIO()
    torch.save(old, content)
    rewritten(tmp_path / "new.zip", tmp_path / "old.zip", policy_optimizer_pth=content.getvalue())
    again = continued(read_archive(tmp_path / "old.zip"), venv(action_space=model.action_space))
    assert again.policy.optimizer.state_dict()["param_groups"][0]["params"] == group["params"]
    state = again.policy.optimizer.state_dict()["state"]
    assert all(same(state[key].values(), saved["state"][key].values()) for key in saved["state"])
    with pytest.warns(UserWarning, match=r"DQN model saved with SB3 < 2\.4\.0"):
        theirs = DQN.load(tmp_path / "old.zip")
    assert theirs.policy.optimizer.state_dict()["state"].keys() == state.keys()


def test_the_learning_rate_and_the_number_of_environments_are_read(tmp_path):
    make_model("PPO", learning_rate=2e-3).save(tmp_path / "number.zip")
    make_model("PPO", learning_rate=lambda _: 1e-3).save(tmp_path / "function.zip")
    number, function = (read_archive(tmp_path / f"{name}.zip") for name in ("number", "function"))
    assert (learning_rate_of(number), learning_rate_of(function)) == (2e-3, None)
    assert sub_environments_of(number) == 1


@pytest.mark.parametrize("given", [4, (2, "step"), (1, "episode")])
def test_dqn_is_trained_as_often_as_before_and_explores_as_at_the_end(given, tmp_path):
    model = make_model("DQN", train_freq=given, exploration_final_eps=0.2)
    model.save(tmp_path / "model.zip")
    again = continued(read_archive(tmp_path / "model.zip"), venv(action_space=META))
    model._convert_train_freq()
    again._convert_train_freq()
    assert again.train_freq == model.train_freq
    assert (again.exploration_schedule(1.0), again.exploration_schedule(0.0)) == (0.2, 0.2)


@pytest.mark.parametrize("value", [0, -1, 10**9, 1.5, float("nan")])
def test_a_number_of_environments_that_is_none_is_refused(value, tmp_path):
    make_model("PPO").save(tmp_path / "model.zip")
    archive = replace(read_archive(tmp_path / "model.zip"), numbers={"n_envs": value, "learning_rate": value})
    with pytest.raises(InputError, match="environments at a time"):
        sub_environments_of(archive)
    with pytest.raises(InputError, match="its learning rate is"):
        learning_rate_of(archive)


@pytest.mark.parametrize("name", ["SAC", "RecurrentPPO", "MaskablePPO"])
def test_other_algorithms_are_refused(name, tmp_path):
    make_model(name).save(tmp_path / "model.zip")
    with pytest.raises(InputError, match="only models of PPO, A2C, TRPO, DQN and QR-DQN with a feed-forward network"):
        continued(read_archive(tmp_path / "model.zip"), venv())


def test_a_model_of_another_environment_is_refused(tmp_path):
    make_model("PPO").save(tmp_path / "model.zip")
    with pytest.raises(InputError, match="cannot be trained further in this environment"):
        continued(read_archive(tmp_path / "model.zip"), venv(action_space=META))


def test_no_code_in_the_file_runs(tmp_path):
    proof = tmp_path / "proof"
    model = make_model("PPO")
    model.payload = Payload(proof)
    model.save(tmp_path / "model.zip")
    again = continued(read_archive(tmp_path / "model.zip"), venv())
    assert isinstance(again, PPO)
    assert not proof.exists()
    action, _ = again.predict(np.zeros(BOX.shape), deterministic=True)
    assert action.shape == COMMANDS.shape


def test_a_model_without_the_state_of_its_optimizer_is_said_to_be(tmp_path):
    model = make_model("PPO", n_steps=8, batch_size=8).learn(8)
    model.save(tmp_path / "whole.zip")
    with zipfile.ZipFile(tmp_path / "whole.zip") as whole, zipfile.ZipFile(tmp_path / "part.zip", "w") as part:
        for name in set(whole.namelist()) - {"policy.optimizer.pth"}:
            part.writestr(name, whole.read(name))
    with pytest.warns(UserWarning, match="has no state of an optimizer, so a new one"):
        again = continued(read_archive(tmp_path / "part.zip"), venv(action_space=model.action_space))
    assert same(again.policy.parameters(), model.policy.parameters())
