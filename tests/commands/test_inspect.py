"""`behavexplor inspect` says what any policy's file holds, where it drives, and what to type next."""

import base64
import json
import shlex
import sys
import types
import zipfile

import cloudpickle
import gymnasium
import numpy as np
import pytest
import torch

from behavexplor.ads.learned.shipped import FOLDER
from behavexplor.ads.sb3.inert import Inert, Name
from behavexplor.commands import main
from behavexplor.commands.inspect import _function_between
from tests.ads.sb3.models import ALGORITHMS, make_model
from tests.ads.sb3.test_policy import with_data
from tests.ads.weights.files import FORMS, Tutorial, dense, write

FLAT = gymnasium.spaces.Box(-np.inf, np.inf, (25,), np.float32)


def inspected(capfd, *arguments):
    """What is printed, with the lines of each paragraph joined."""
    assert main(["inspect", *map(str, arguments)]) == 0
    return " ".join(capfd.readouterr().out.split())


@pytest.mark.parametrize("name", FORMS)
def test_each_form_of_weights(name, tmp_path, capfd, monkeypatch):
    path, network = write(FORMS[name], tmp_path)
    said = inspected(capfd, path)
    size = sum(array.numel() for array in network.state_dict().values())
    assert f"{2 * size if name == 'checkpoint' else size} numbers" in said
    assert "loads yes" in said
    assert "digest sha256:" in said
    env = "intersection-straight" if name in ("gaussian", "soft") else "highway-fast-v0"
    assert f"drives in {env}" in said or f", {env}" in said or "config" in path.with_suffix(".yaml").read_text()
    assert f"fuzz --env highway-fast-v0 --ads {shlex.quote(str(path))}" in said


@pytest.mark.parametrize("name", ALGORITHMS)
def test_each_algorithm(name, tmp_path, capfd):
    make_model(name).save(tmp_path / "model.zip")
    said = inspected(capfd, tmp_path / "model.zip", "--json", tmp_path / "found.json")
    known = {"TD3": "TD3 or DDPG", "DDPG": "TD3 or DDPG", "QRDQN": "QR-DQN"}.get(name, name)
    assert f"algorithm {known}, " in said
    found = json.loads((tmp_path / "found.json").read_text())
    assert found["loads"] == "yes"
    assert found["observations"] == "Box(7, 5)"
    assert "learning rate" in found["schedule"]
    assert "Stable-Baselines3 " in found["versions"]
    if name not in ("DQN", "QRDQN", "MaskablePPO"):
        assert found["fits"] == ["lane-change", "lane-follow"]
        assert found["command"].endswith(f"fuzz --env lane-change --ads {tmp_path / 'model.zip'}")
    else:
        assert found["fits"] == []
        assert "A configuration that fits" in found["drives in"]


def test_shipped_policies(capfd):
    for path in sorted(FOLDER.glob("*.npz")):
        said = inspected(capfd, f"learned:{path.stem}")
        assert "a network of `train`" in said
        assert f"--ads learned:{path.stem}" in said


def of_gym(patch, module, kind, space):
    """A space as a model's file has it if it is of gym."""
    for name in ("gym", "gym.spaces", f"gym.spaces.{module}"):
        patch.setitem(sys.modules, name, types.ModuleType(name))
    old = type(kind, (), {"__module__": f"gym.spaces.{module}"})
    setattr(sys.modules[f"gym.spaces.{module}"], kind, old)
    made = old()
    made.__dict__.update({key: value for key, value in vars(space).items() if not key.startswith("_np_random")})
    return base64.b64encode(cloudpickle.dumps(made)).decode()


def test_a_model_with_spaces_of_gym(tmp_path, capfd, monkeypatch):
    """Stable-Baselines3 before 2.0 kept spaces of gym."""
    model = make_model("DQN", FLAT)
    model.save(tmp_path / "new.zip")
    with monkeypatch.context() as patch:
        pickled = {
            "observation_space": of_gym(patch, "box", "Box", model.observation_space),
            "action_space": of_gym(patch, "discrete", "Discrete", model.action_space),
        }
    said = inspected(capfd, with_data(tmp_path / "new.zip", tmp_path / "model.zip", pickled))
    assert "algorithm DQN" in said
    assert "loads yes" in said
    assert "highway-fast-v0" in said


def test_what_is_missing_is_said(tmp_path, capfd):
    torch.save(Tutorial().state_dict(), tmp_path / "weights.pth")
    said = inspected(capfd, tmp_path / "weights.pth")
    assert "layers 25-128-128-5 " in said
    assert "loads no: " in said
    assert "add `activation: relu`" in said
    assert "Search" not in said
    said = inspected(capfd, tmp_path / "weights.pth", "--activation", "relu")
    assert said.endswith(f"fuzz --env highway-fast-v0 --ads {tmp_path / 'weights.pth'} --activation relu")
    torch.save(dense(35, 8, 5).state_dict(), tmp_path / "weights.pth")
    said = inspected(capfd, tmp_path / "weights.pth", "--activation", "relu")
    assert "no environment as it is. A configuration that fits" in said
    (tmp_path / "env.yaml").write_text("observation: {type: Kinematics, vehicles_count: 7}")
    said = inspected(capfd, tmp_path / "weights.pth", "--activation", "relu", "--env-config", tmp_path / "env.yaml")
    assert f"--activation relu --env-config {tmp_path / 'env.yaml'}" in said


@pytest.mark.parametrize("columns", [60, 80])
def test_the_output_is_legible_on_narrow_terminals(columns, tmp_path, capfd, monkeypatch):
    monkeypatch.setenv("COLUMNS", str(columns))
    monkeypatch.chdir(tmp_path)
    path, _ = write(FORMS["convolutional"], tmp_path)
    assert main(["inspect", path.name]) == 0
    *lines, command = capfd.readouterr().out.splitlines()
    assert "fuzz --env highway-fast-v0 --ads weights.pth" in command
    assert all(len(line) <= columns for line in lines if "sha256:" not in line)


@pytest.mark.parametrize(("content", "message"), [(Tutorial, "whole pickled module"), (dict, "holds no tensors")])
def test_what_cannot_be_read_is_one_sentence(content, message, tmp_path, capfd):
    torch.save(content(), tmp_path / "weights.pth")
    assert main(["inspect", str(tmp_path / "weights.pth")]) == 2
    said = capfd.readouterr()
    assert message in said.err
    assert said.err.count("\n") == 1
    assert said.out == ""


def test_of_weights_that_are_no_tensors_no_layers_are_said(tmp_path, capfd):
    make_model("PPO").save(tmp_path / "model.zip")
    with zipfile.ZipFile(tmp_path / "model.zip") as model, zipfile.ZipFile(tmp_path / "other-8.zip", "w") as other:
        for name in model.namelist():
            with other.open(name, "w") as member:
                torch.save({"a": 1}, member) if name == "policy.pth" else member.write(model.read(name))
    said = inspected(capfd, tmp_path / "other-8.zip")
    assert "holds no tensors of a network: save its weights by torch.save(model.state_dict(), 'weights.pth')" in said
    assert "between them" not in said


OWN, SHARED, OF_DQN = Inert("a.function"), Name("sb3.ActorCriticPolicy"), Name("sb3.DQNPolicy")


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"policy_class": OWN}, ""),
        ({"policy_class": SHARED, "policy_kwargs": {"activation_fn": OWN}}, ""),
        ({"policy_class": SHARED, "policy_kwargs": {"activation_fn": Name("torch.nn.ELU")}}, ", ELU between them"),
        ({"policy_class": SHARED}, ", Tanh between them"),
        ({"policy_class": OF_DQN, "policy_kwargs": {}}, ", ReLU between them"),
    ],
)
def test_the_function_between_layers_is_said_where_it_is_known(settings, said):
    assert _function_between(types.SimpleNamespace(settings=settings)) == said


def test_a_model_needs_no_ending_as_for_fuzz(tmp_path, capfd):
    make_model("PPO").save(tmp_path / "model.zip")
    for name in ("policy", "policy.v2"):
        (tmp_path / name).write_bytes((tmp_path / "model.zip").read_bytes())
        assert "algorithm PPO, " in inspected(capfd, tmp_path / name)


def test_names_that_are_no_policies_are_refused(tmp_path, capfd):
    (tmp_path / "notes.txt").write_text("x")
    for name, message in (
        ("notes.txt", "is not a zip file of Stable-Baselines3, or is damaged"),
        ("none.pth", "There is no file or folder"),
    ):
        assert main(["inspect", str(tmp_path / name)]) == 2
        assert message in capfd.readouterr().err
