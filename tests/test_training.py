"""Training: the same seed gives the same policy, interrupted or not."""

import numpy as np
import pytest
import torch
import yaml

from behavexplor.ads.learned.network_file import read_network
from behavexplor.commands import BAD_INPUT, OK, main
from behavexplor.errors import InputError
from behavexplor.training import ALGORITHMS, TrainingConfig, train
from tests.ads.sb3.models import Payload

SMALL = {"env": "lane-change", "steps": 6000, "stage": 2000, "envs": 2, "layers": (16,)}


def layers(folder):
    return read_network(folder / "policy.npz").layers


class CutError(Exception):
    """Pulls the plug."""


def same(first, second):
    return all(
        np.array_equal(a, b) for one, other in zip(first, second, strict=True) for a, b in zip(one, other, strict=True)
    )


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    folder = tmp_path_factory.mktemp("trained")
    seen = []
    train(TrainingConfig(**SMALL), folder, seen.append)
    return folder, seen


def test_a_training_that_was_cut_off_ends_as_if_it_had_not_been(trained, tmp_path):
    folder, seen = trained
    config = TrainingConfig(**SMALL)

    def cut(learned):
        if learned.steps > 4200:
            raise CutError

    with pytest.raises(CutError):
        train(config, tmp_path, cut)
    assert [path.name for path in sorted((tmp_path / "models").iterdir())] == ["stage-0001.pt", "stage-0002.pt"]
    train(config, tmp_path, lambda _: None)
    assert same(layers(tmp_path), layers(folder))
    assert seen[-1].steps >= 6000
    assert sum(seen[-1].ends.values()) == pytest.approx(1.0)


@pytest.mark.parametrize("content", [b"", b"rubbish", "payload"])
def test_a_damaged_checkpoint_is_refused_and_nothing_of_it_is_run(content, tmp_path):
    checkpoint, proof = tmp_path / "models" / "stage-0001.pt", tmp_path / "proof"
    checkpoint.parent.mkdir()
    if content == "payload":
        torch.save(Payload(proof), checkpoint)
    else:
        checkpoint.write_bytes(content)
    with pytest.raises(InputError, match=r"Cannot resume from .*stage-0001\.pt"):
        train(TrainingConfig(**SMALL), tmp_path, lambda _: None)
    assert not proof.exists()


def test_another_seed_gives_another_policy(trained, tmp_path):
    train(TrainingConfig(**SMALL, seed=1), tmp_path, lambda _: None)
    assert not same(layers(tmp_path), layers(trained[0]))


@pytest.mark.parametrize("algo", sorted(set(ALGORITHMS) - {"ppo"}))
def test_the_other_algorithms_train_too(algo, tmp_path):
    train(TrainingConfig(**SMALL, algo=algo), tmp_path, lambda _: None)
    assert len(layers(tmp_path)) == 2


def test_the_log_is_read_by_ordinary_tools(trained):
    log = trained[0] / "logs" / "stage-0001"
    assert "rollout/reward" in (log / "progress.csv").read_text().splitlines()[0]
    assert list(log.glob("events.out.tfevents*"))


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"algo": "pppo"}, "did you mean 'ppo'"),
        ({"steps": 0}, "steps: must be a number from 1 to 1e"),
        ({"envs": 0}, "envs: must be a number from 1 to 4096, got 0"),
        ({"seed": -1}, "seed: must be a number from 0 to"),
        ({"layers": ()}, "must be at least one width"),
    ],
)
def test_a_wrong_configuration_is_refused(changed, message):
    with pytest.raises(InputError, match=message):
        TrainingConfig(**changed)


def test_the_command_trains_evaluates_and_tells_how_to_go_on(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("behavexplor.commands.train.EVALUATED", 5)
    folder = tmp_path / "run"
    flags = ["--env", "lane-follow", "--steps", "2000", "--envs", "3"]
    assert main(["train", *flags, "--out", str(folder), "--quiet"]) == OK
    out = capsys.readouterr().out
    assert "5 scenarios of lane-follow, with 95 % intervals:" in out
    assert f"--ads {folder}/policy.npz" in out
    card = yaml.safe_load((folder / "policy.yaml").read_text())
    assert card["trained_by"].endswith("train --env lane-follow --algo ppo --steps 2000 --seed 0 --envs 3")
    assert card["evaluation"]["scenarios"] == 5
    assert main(["train", *flags, "--out", str(folder)]) == BAD_INPUT
    assert "is not empty: resume with --resume" in capsys.readouterr().err
    assert main(["train", "--resume", str(folder), "--quiet"]) == OK  # there is nothing left to learn
    assert yaml.safe_load((folder / "policy.yaml").read_text()) == card
    assert main(["train", "--resume", str(folder), "--steps", "9"]) == BAD_INPUT
    assert "--steps cannot be changed with --resume: the training has 2000" in capsys.readouterr().err


@pytest.mark.parametrize(("command", "name"), [("train", "training.yaml"), ("retrain", "retraining.yaml")])
def test_a_configuration_that_is_lost_is_not_taken_for_the_defaults(command, name, tmp_path, capsys):
    (tmp_path / name).touch()
    assert main([command, "--resume", str(tmp_path)]) == BAD_INPUT
    assert f"{name} is empty" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (["--env", "lane-folow"], "did you mean 'lane-follow'"),
        (["--algo", "sac"], "Unknown algorithm 'sac'"),
        (["--resume", "nowhere"], "is not the folder of a training"),
    ],
)
def test_wrong_flags_are_refused_and_leave_nothing(flags, message, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["train", *flags]) == BAD_INPUT
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
