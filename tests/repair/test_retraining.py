"""Retraining: resumable, reproducible, and it keeps the best round."""

import io
import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest
import torch
import yaml
from stable_baselines3 import DQN, PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecNormalize

from behavexplor.ads.learned.network_file import read_network
from behavexplor.ads.learned.shipped import policy_file
from behavexplor.ads.sb3.archive import read_archive
from behavexplor.ads.sb3.description import trained_in
from behavexplor.commands import BAD_INPUT, EXECUTION_FAILED, OK, main
from behavexplor.commands.retrain import comparison
from behavexplor.data.scenario import parse_scenario
from behavexplor.data.target import Target
from behavexplor.envs.functional import LaneChangeEnv
from behavexplor.envs.sb3_vec_env import HighwayVecEnv
from behavexplor.errors import InputError
from behavexplor.repair import retraining, trainees
from behavexplor.repair.retraining import retrain
from behavexplor.repair.retraining_rounds import ROUNDS, RetrainingConfig, Round, append_round, best, finished_rounds
from behavexplor.repair.trainees import copy_policy, open_trainee

POLICY = "learned:lane-change"
SMALL = {"env": "lane-change", "rounds": 2, "steps": 400, "envs": 2, "budget": 6, "validation": 6, "pool": "both"}


class CutError(Exception):
    """Pulls the plug."""


@pytest.fixture(scope="module")
def retrained(tmp_path_factory):
    folder = tmp_path_factory.mktemp("retrained")
    seen = []
    rounds = retrain(RetrainingConfig(policy=POLICY, **SMALL), folder, lambda _: None, seen.append)
    assert rounds == seen
    return folder


def layers(path):
    return [array for layer in read_network(path).layers for array in layer]


def ruin(model, *_, **__):
    with torch.no_grad():
        next(model.policy.parameters()).fill_(float("nan"))


@pytest.mark.parametrize("at", ["begin", "end"])
def test_a_training_that_diverges_ends_in_a_sentence_and_keeps_the_best_policy(at, tmp_path, capsys, monkeypatch):
    """At the beginning, torch itself refuses to go on; after the last step, the weights are looked at."""
    if at == "begin":
        monkeypatch.setattr(trainees, "begin_stage", ruin)
    else:
        monkeypatch.setattr(PPO, "learn", ruin)
    words = [f"--{name}={value}" for name, value in {**SMALL, "pool": "none"}.items()]
    assert main(["retrain", POLICY, *words, "--out", str(tmp_path / "out"), "--quiet"]) == EXECUTION_FAILED
    told = capsys.readouterr().err
    assert "the training diverged in round 1" in told
    assert f"The best policy until then is in {tmp_path / 'out' / 'policy.npz'}" in told
    given, kept = layers(policy_file(POLICY)), layers(tmp_path / "out" / "policy.npz")
    assert all(np.array_equal(one, other) for one, other in zip(given, kept, strict=True))
    assert len(finished_rounds(tmp_path / "out")) == 1


def test_a_retraining_that_was_cut_off_ends_as_if_it_had_not_been(retrained, tmp_path):
    config = RetrainingConfig(policy=POLICY, **SMALL)

    def cut(one):
        if one.number == 1:
            raise CutError

    with pytest.raises(CutError):
        retrain(config, tmp_path, lambda _: None, cut)
    assert [one.number for one in finished_rounds(tmp_path)] == [0, 1]
    rounds = retrain(config, tmp_path, lambda _: None, lambda _: None)
    assert rounds == finished_rounds(retrained)
    last = "rounds/round-0002.npz"
    assert all(map(np.array_equal, layers(tmp_path / last), layers(retrained / last)))


def test_the_first_round_is_the_policy_as_it_was(retrained):
    assert all(map(np.array_equal, layers(retrained / "rounds/round-0000.npz"), layers(policy_file(POLICY))))
    assert not np.array_equal(layers(retrained / "rounds/round-0002.npz")[0], layers(policy_file(POLICY))[0])


def test_a_retrained_network_says_where_it_was_trained(tmp_path):
    open_trainee(Target("lane-change", POLICY), seed=0, envs=1).write(tmp_path / "round.npz")
    copy_policy(tmp_path / "round.npz", tmp_path / "policy.npz")
    assert trained_in(str(tmp_path / "policy.npz")) == "lane-change"


def test_the_best_round_becomes_the_policy(retrained):
    rounds = finished_rounds(retrained)
    chosen = f"rounds/round-{best(rounds).number:04d}.npz"
    assert all(map(np.array_equal, layers(retrained / "policy.npz"), layers(retrained / chosen)))


def test_the_best_round_fails_least_and_what_it_fixed_and_broke_is_counted():
    rounds = [Round(0, 0, 10, (1, 2), 7), Round(1, 9, 10, (3,), 8), Round(2, 18, 10, (2,), 9)]
    assert best(rounds).number == 2
    assert (rounds[1].fixed(rounds[0]), rounds[1].broken(rounds[0])) == (2, 1)
    assert rounds[0].at_fault == 0.2


def test_every_round_keeps_its_campaign_and_its_pool(retrained):
    for one in finished_rounds(retrained)[1:]:
        assert (retrained / "campaigns" / f"{one.number:04d}" / "campaign.db").is_file()
        lines = (retrained / "rounds" / f"round-{one.number:04d}.jsonl").read_text().splitlines()
        assert len(lines) == one.pool


def test_a_campaign_that_was_cut_off_before_it_began_begins_anew(tmp_path, monkeypatch):
    asked = []

    def opened(*_, resume):
        asked.append(resume)
        raise CutError

    monkeypatch.setattr(retraining, "opened", opened)
    for name in ("", "campaign.lock", "config.yaml"):
        (tmp_path / name).touch()
        with pytest.raises(CutError):
            retraining.found_failures(Target("lane-change", POLICY), "uniform", 5, 1, tmp_path)
    assert asked == [False, False, True]


def test_without_a_pool_there_are_no_campaigns(tmp_path):
    rounds = retrain(
        RetrainingConfig(policy=POLICY, **{**SMALL, "pool": "none", "rounds": 1}),
        tmp_path,
        lambda _: None,
        lambda _: None,
    )
    assert not (tmp_path / "campaigns").exists()
    assert (rounds[-1].found, rounds[-1].pool) == (None, 0)


def test_a_damaged_list_of_rounds_is_named(retrained, tmp_path):
    folder = shutil.copytree(retrained, tmp_path / "copy")
    (folder / ROUNDS).write_text(json.dumps({"number": 0}))
    with pytest.raises(InputError, match=r"rounds\.jsonl cannot be read"):
        finished_rounds(folder)


@pytest.fixture
def trainee(monkeypatch):
    """A policy that cannot learn."""
    venv = SimpleNamespace(close=lambda: None)
    trainee = SimpleNamespace(venv=venv, model=None, scenarios=SimpleNamespace(logical=LaneChangeEnv.logical))
    monkeypatch.setattr(retraining, "open_trainee", lambda *_: trainee)
    return trainee


@pytest.mark.usefixtures("trainee")
@pytest.mark.parametrize(
    ("changed", "message"), [({"method": "unifrom"}, "did you mean 'uniform'"), ({"seed": 2**63 - 1}, "The seed")]
)
def test_a_search_that_cannot_begin_is_refused_before_the_first_round(changed, message):
    config = RetrainingConfig(policy=POLICY, **{**SMALL, **changed})
    with pytest.raises(InputError, match=message):
        retraining.check(config)
    retraining.check(replace(config, pool="own"))


@pytest.mark.usefixtures("trainee")
def test_a_damaged_round_is_named_with_what_helps(tmp_path):
    append_round(tmp_path, Round(0, 0, 10, (), 10))
    (tmp_path / "rounds").mkdir()
    (tmp_path / "rounds" / "round-0000.jsonl").touch()
    (tmp_path / "rounds" / "round-0000.pt").write_bytes(b"rubbish")
    with pytest.raises(InputError, match=r"Cannot resume from .*\.pt: .*; delete the last line of .*rounds\.jsonl"):
        retrain(RetrainingConfig(policy=POLICY, **SMALL), tmp_path, lambda _: None, lambda _: None)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "Give a policy"),
        (["learned:nothing"], "learned:"),
        (["missing.npz"], "missing.npz"),
        (["--resume", "missing"], "has no retraining.yaml"),
        (["learned:lane-change", "--share", "2"], "share: must be a number from 0 to 0.95, got 2.0"),
        (["learned:lane-change", "--env", "highway-v0"], "follows a route on the roads of this package"),
        (["learned:lane-change", "--rate", "-1"], "rate: must be a number from 1e-07 to 0.1, got -1.0"),
    ],
)
def test_wrong_input_is_one_sentence(arguments, message, tmp_path, capsys):
    more = [] if "--resume" in arguments else ["--out", str(tmp_path / "out")]
    assert main(["retrain", *arguments, *more]) == BAD_INPUT
    assert message in capsys.readouterr().err


def test_the_command_says_what_every_round_brought(retrained, tmp_path, capsys):
    folder = shutil.copytree(retrained, tmp_path / "copy")
    config = RetrainingConfig(policy=POLICY, **SMALL)
    (folder / "retraining.yaml").write_text(config.to_yaml())
    assert main(["retrain", "--resume", str(folder), "--quiet"]) == OK
    out = capsys.readouterr().out
    assert "at fault" in out
    assert ("compare learned:lane-change" in out) == (best(finished_rounds(folder)).number > 0)
    for flags in (["--rounds", "9"], ["--envs", "3"]):
        assert main(["retrain", "--resume", str(folder), *flags]) == BAD_INPUT
        assert f"{flags[0]} cannot be changed with --resume: the retraining has " in capsys.readouterr().err


def test_the_comparison_is_in_the_environment_of_the_training():
    config = RetrainingConfig("merge-v0", "a model.zip")
    assert comparison(config, Path("b.zip")).endswith(" compare 'a model.zip' b.zip --env merge-v0")
    config = replace(config, traffic="wide", env_config={"duration": 5})
    assert comparison(config, Path("b.zip")).endswith(" --env merge-v0 --traffic wide --env-config FILE")


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """A model of Stable-Baselines3 that was trained a little in an environment of highway-env."""
    folder = tmp_path_factory.mktemp("model")
    envs = make_vec_env("highway-fast-v0", n_envs=2, vec_env_cls=HighwayVecEnv)
    settings = {"n_steps": 16, "batch_size": 16, "n_epochs": 1, "policy_kwargs": {"net_arch": [8]}, "device": "cpu"}
    PPO("MlpPolicy", envs, seed=0, **settings).learn(64).save(folder / "model.zip")
    (folder / "model.yaml").write_text("env: highway-fast-v0\nconfig: {duration: 8}\n")
    return folder / "model.zip"


def weights(path):
    return read_archive(path).weights


def test_a_model_of_stable_baselines3_goes_on_where_it_was_trained(model, tmp_path, capsys):
    flags = ["--rounds", "1", "--steps", "200", "--budget", "8", "--validation", "8", "--quiet"]
    assert main(["retrain", str(model), *flags, "--out", str(tmp_path / "out")]) == OK
    is_better = best(finished_rounds(tmp_path / "out")).number > 0
    assert ("No round was better" in capsys.readouterr().out) != is_better
    first, second = ((tmp_path / "out" / "rounds" / f"round-000{i}.zip") for i in (0, 1))
    assert weights(first) == weights(model)
    assert weights(second) != weights(model)
    told = yaml.safe_load((tmp_path / "out" / "policy.yaml").read_text())
    assert (told["env"], told["config"]["duration"]) == ("highway-fast-v0", 8)
    scenarios = (tmp_path / "out" / "rounds" / "round-0001.jsonl").read_text().splitlines()
    assert all(parse_scenario(line).functional == "highway-fast-v0" for line in scenarios)
    assert main(["fuzz", "--ads", str(second), "--budget", "2", "--out", str(tmp_path / "run"), "--quiet"]) == OK


def test_a_model_of_stable_baselines3_goes_on_in_an_environment_of_this_package(tmp_path, capsys):
    envs = gymnasium.make("behavexplor/lane-change-v0")
    PPO("MlpPolicy", envs, n_steps=8, batch_size=8, device="cpu", seed=0).save(tmp_path / "model.zip")
    flags = ["--env", "lane-change", "--rounds", "1", "--steps", "16", "--budget", "2", "--validation", "2", "--quiet"]
    assert main(["retrain", str(tmp_path / "model.zip"), *flags, "--out", str(tmp_path / "out")]) == OK
    assert "at fault" in capsys.readouterr().out
    policy = tmp_path / "out" / "policy.zip"
    assert main(["fuzz", "--ads", str(policy), "--budget", "2", "--out", str(tmp_path / "run"), "--quiet"]) == OK
    assert trained_in(str(policy)) == "lane-change"


def test_a_driver_that_is_no_policy_is_refused_before_its_code_runs(tmp_path, capsys):
    assert (
        main(["retrain", "tests.drivers:cruiser", "--env", "lane-change", "--out", str(tmp_path / "out")]) == BAD_INPUT
    )
    assert "There is no policy tests.drivers:cruiser" in capsys.readouterr().err


def test_normalized_observations_are_refused(model, tmp_path, capsys):
    copy = shutil.copytree(model.parent, tmp_path / "copy")
    envs = VecNormalize(make_vec_env("highway-fast-v0", n_envs=1, vec_env_cls=HighwayVecEnv))
    envs.save(str(copy / "vecnormalize.pkl"))
    assert main(["retrain", str(copy / "model.zip"), "--out", str(tmp_path / "out")]) == BAD_INPUT
    assert "its observations are normalized" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_model_with_a_replay_buffer_resumes_as_if_it_had_not_been_cut_off(tmp_path):
    envs = make_vec_env("highway-fast-v0", n_envs=2, vec_env_cls=HighwayVecEnv)
    settings = {"buffer_size": 300, "batch_size": 8, "learning_starts": 20, "target_update_interval": 8}
    DQN("MlpPolicy", envs, seed=0, policy_kwargs={"net_arch": [8]}, **settings).learn(60).save(tmp_path / "model.zip")
    given = {"env": "highway-fast-v0", "policy": str(tmp_path / "model.zip"), "env_config": {"duration": 5}}
    config = RetrainingConfig(**given, pool="own", rounds=2, steps=60, validation=3)

    def cut(one):
        if one.number == 1:
            raise CutError

    whole = retrain(config, tmp_path / "whole", lambda _: None, lambda _: None)
    with pytest.raises(CutError):
        retrain(config, tmp_path / "cut", lambda _: None, cut)
    assert retrain(config, tmp_path / "cut", lambda _: None, lambda _: None) == whole
    first, second = (read_archive(tmp_path / name / "rounds" / "round-0002.zip") for name in ("whole", "cut"))
    assert same_weights(first, second)


def same_weights(first, second):
    one, other = (torch.load(io.BytesIO(archive.weights), weights_only=True) for archive in (first, second))
    return all(torch.equal(one[name], other[name]) for name in one)
