"""A network of `train` as a model of Stable-Baselines3: it drives as before, and a script can train it further."""

import shutil

import numpy as np
import pytest
import yaml

import behavexplor
from behavexplor.ads.learned.network_file import TrainedNetwork, write_network
from behavexplor.ads.loading import load_ads
from behavexplor.commands import BAD_INPUT, OK, main
from behavexplor.errors import InputError

pytest.importorskip("stable_baselines3")

from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize
from torch import nn

from behavexplor.sb3 import FuzzCallback, learning_env

POLICY, ENV = "learned:lane-change", "lane-change"
SETTINGS = {"n_steps": 8, "batch_size": 16, "device": "cpu"}


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """The file of the model."""
    path = tmp_path_factory.mktemp("zip") / "model.zip"
    assert main(["zip", POLICY, "--out", str(path)]) == OK
    return path


def lines(run):
    return [record.to_json() for record in run.records]


def test_it_drives_as_the_network(model, tmp_path):
    assert yaml.safe_load(model.with_suffix(".yaml").read_text()) == {"env": ENV, "decision": "mean"}
    settings = {"budget": 12, "seed": 3, "workers": 0, "unconfined": True}
    one = behavexplor.find_failures(str(model), out=tmp_path / "zip", **settings)
    other = behavexplor.find_failures(POLICY, ENV, out=tmp_path / "npz", **settings)
    assert one.config.env == ENV
    assert lines(one) == lines(other)


def test_a_script_trains_it_further_and_fuzzes_it_in_memory(model, tmp_path):
    venv = learning_env(ENV, 2)
    trained = PPO.load(model, env=venv, custom_objects=SETTINGS)
    assert trained.policy.state_dict()["action_net.weight"].shape[0] == venv.action_space.n
    callback = FuzzCallback(every=16, budget=4, share=1.0, out=str(tmp_path / "rounds"))
    trained.learn(16, callback=callback)
    assert callback.rounds[0].summary.executions == 4
    run = behavexplor.open_run(callback.rounds[0].folder)
    assert run.config.env == f"behavexplor/{ENV}-v0"
    venv.close()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([POLICY, "--out", "model.npz"], "must end with .zip"),
        (["model.zip", "--out", "other.zip"], "is no network of `train`"),
        (["missing.npz", "--out", "other.zip"], "missing.npz"),
        ([POLICY, "--out", "other.zip", "--env", "nowhere"], "functional scenario"),
        ([POLICY, "--out", "/proc/other.zip"], "cannot be written"),
    ],
)
def test_wrong_input_is_one_sentence(arguments, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["zip", *arguments]) == BAD_INPUT
    assert message in capsys.readouterr().err


def test_it_is_refused_where_it_cannot_drive_or_learn(model, tmp_path, capsys):
    with pytest.raises(InputError, match="follows a route on the roads of this package"):
        load_ads(str(model), None)
    assert main(["retrain", str(model), "--out", str(tmp_path / "out")]) == BAD_INPUT
    assert "retrain the network" in capsys.readouterr().err


def test_a_model_that_sees_scaled_features_is_refused(model, tmp_path):
    scaled = VecNormalize(learning_env(ENV, 1))
    trained = PPO("MlpPolicy", scaled, n_steps=8, batch_size=8, policy_kwargs={"activation_fn": nn.Tanh})
    with pytest.raises(InputError, match="through VecNormalize"):
        behavexplor.find_failures(trained, ENV, budget=1, out=tmp_path / "run")
    trained.save(tmp_path / "model.zip")
    scaled.save(str(tmp_path / "vecnormalize.pkl"))
    (tmp_path / "model.yaml").write_text("decision: mean\nstatistics: vecnormalize.pkl\n")
    with pytest.raises(InputError, match="neither scaled nor stacked"):
        load_ads(str(tmp_path / "model.zip"), learning_env(ENV, 1).roadmap)


def test_statistics_of_another_model_in_the_folder_do_not_count(model, tmp_path):
    for file in (model, model.with_suffix(".yaml")):
        shutil.copy(file, tmp_path)
    (tmp_path / "vecnormalize.pkl").touch()
    assert load_ads(str(tmp_path / model.name), learning_env(ENV, 1).roadmap).policy_frequency == 5


def test_a_network_of_another_form_is_not_written(tmp_path, capsys):
    layers = [(np.zeros((4, 10)), np.zeros(4)), (np.zeros((20, 4)), np.zeros(20))]
    write_network(tmp_path / "policy.npz", TrainedNetwork(layers))
    (tmp_path / "policy.yaml").write_text("[" * 2000)
    assert main(["zip", str(tmp_path / "policy.npz"), "--out", str(tmp_path / "a.zip")]) == BAD_INPUT
    assert "policy.yaml" in capsys.readouterr().err
    assert main(["zip", str(tmp_path / "policy.npz"), "--out", str(tmp_path / "a.zip"), "--env", ENV]) == BAD_INPUT
    assert "Expected a network of" in capsys.readouterr().err
    assert not (tmp_path / "a.zip").exists()


def test_another_network_under_that_description_is_named(tmp_path):
    venv = learning_env(ENV, 1)
    other = PPO("MlpPolicy", venv, policy_kwargs={"net_arch": [8], "activation_fn": nn.ReLU}, n_steps=8, batch_size=8)
    other.save(tmp_path / "model.zip")
    (tmp_path / "model.yaml").write_text("decision: mean\n")
    with pytest.raises(InputError, match="dense layers with Tanh between them, got ReLU"):
        load_ads(str(tmp_path / "model.zip"), venv.roadmap)
