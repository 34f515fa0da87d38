"""Fuzzing during a training of Stable-Baselines3, and models in memory as drivers."""

import importlib
import math
import re
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.logger import configure
from stable_baselines3.common.vec_env import VecFrameStack, VecNormalize

import behavexplor
from behavexplor.ads.in_memory import given_driver
from behavexplor.ads.sb3.model_in_memory import training_env
from behavexplor.envs.sb3_vec_env import HighwayVecEnv
from behavexplor.errors import InputError
from behavexplor.sb3 import FuzzCallback
from behavexplor.sb3.fuzz_callback import BEST, FuzzingRound

CONFIG = {"duration": 6, "vehicles_count": 10}
SEARCH = {"budget": 6, "seed": 3, "confirm": False}


def ppo(n_envs=2, cls=HighwayVecEnv, wrap=lambda envs: envs):
    envs = wrap(make_vec_env("highway-fast-v0", n_envs, seed=1, env_kwargs={"config": CONFIG}, vec_env_cls=cls))
    return PPO("MlpPolicy", envs, n_steps=16, batch_size=16, n_epochs=1, seed=1, device="cpu")


def parameters(model):
    return np.concatenate([value.numpy().ravel() for value in model.policy.state_dict().values()])


def test_a_model_in_memory_is_driven_as_from_its_file(tmp_path):
    model = ppo()
    before = parameters(model)
    run = behavexplor.find_failures(model, out=tmp_path / "a", **SEARCH)
    assert run.config.env == "highway-fast-v0"
    model.save(tmp_path / "model.zip")
    (tmp_path / "model.yaml").write_text(yaml.safe_dump({"env": "highway-fast-v0", "config": CONFIG}))
    by_file = behavexplor.find_failures(
        tmp_path / "model.zip", out=tmp_path / "b", unconfined=True, workers=0, **SEARCH
    )
    assert [record.to_json() for record in run.records] == [record.to_json() for record in by_file.records]
    assert max(record.duration for record in run.records) <= 6.0
    assert (parameters(model) == before).all()
    model.learn(32)  # its layers are still those of torch


@pytest.mark.parametrize("cls", [None, HighwayVecEnv])
def test_the_environment_of_a_training_is_known(cls):
    name, config = training_env(ppo(cls=cls))
    assert name == "highway-fast-v0"
    assert config["duration"] == 6


def test_statistics_and_stacked_frames_are_those_of_the_training():
    model = ppo(wrap=lambda envs: VecFrameStack(VecNormalize(envs), 2))
    model.learn(32)
    policy = given_driver(model).driver
    raw = np.random.default_rng(0).normal(size=(1, 5, 5)).astype(np.float32)
    normalize = model.get_vec_normalize_env()
    assert policy.prepare(raw) == pytest.approx(normalize.normalize_obs(raw))
    assert policy.observation_space.shape == (5, 5)
    actions, _ = policy.predict(raw, None, np.ones(1, dtype=bool))
    stacked = np.concatenate([np.zeros((1, 5, 5), np.float32), normalize.normalize_obs(raw)], axis=-1)
    assert actions == model.predict(stacked, deterministic=True)[0]


def test_a_training_is_fuzzed_and_stays_the_same(tmp_path):
    callback = FuzzCallback(every=32, share=1.0, out=str(tmp_path / "fuzz"), **SEARCH)
    model = ppo()
    model.set_logger(configure(str(tmp_path / "logs"), ["csv"]))
    model.learn(96, callback=callback)
    model.logger.close()
    plain = ppo()
    plain.learn(96)
    assert (parameters(model) == parameters(plain)).all()
    assert [one.steps for one in callback.rounds] == [32, 64, 96]
    run = behavexplor.open_run(callback.rounds[0].folder)
    assert run.summary == callback.rounds[0].summary
    assert run.config.budget == "6"
    fewest = min(one.summary.at_fault for one in callback.rounds)
    assert callback.best.summary.at_fault == fewest
    assert (tmp_path / "fuzz" / "best_model.zip").is_file()
    header, *rows = (tmp_path / "logs" / "progress.csv").read_text().splitlines()
    logged = dict(zip(header.split(","), rows[-1].split(","), strict=True))
    assert float(logged["fuzz/failure_rate"]) == pytest.approx(callback.rounds[-1].summary.failure_rate)
    assert {"fuzz/at_fault_rate", "fuzz/classes", "fuzz/share_of_time"} <= logged.keys()


@pytest.mark.slow
def test_rounds_that_would_take_too_long_are_left_out(tmp_path):
    callback = FuzzCallback("highway-fast-v0", every=32, share=1e-6, out=str(tmp_path), **SEARCH)
    ppo().learn(96, callback=callback)
    assert len(callback.rounds) == 1  # the first one always takes place
    assert callback.share_of_time > 1e-6


@pytest.mark.slow
def test_a_policy_that_is_good_enough_ends_the_training(tmp_path):
    numbers = {"budget": np.int64(SEARCH["budget"]), "seed": np.int64(0)}  # as searches for hyperparameters give them
    callback = FuzzCallback(every=32, share=1.0, stop_below=1.0, out=str(tmp_path), **{**SEARCH, **numbers})
    model = ppo()
    model.learn(96, callback=callback)
    assert model.num_timesteps == 32


def test_a_hyperparameter_file_can_name_it():
    """As rl-zoo3 makes the callbacks of its YAML files."""
    text = "callback: [{behavexplor.sb3.FuzzCallback: {env: highway-fast-v0, every: 10000, budget: 50, share: 0.1}}]"
    ((name, settings),) = yaml.safe_load(text)["callback"][0].items()
    module, _, kind = name.rpartition(".")
    assert isinstance(getattr(importlib.import_module(module), kind)(**settings), BaseCallback)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("every", 0),
        ("share", 0.0),
        ("share", 2.0),
        ("share", math.nan),
        ("stop_below", math.nan),
        ("stop_below", 0.0),  # no rate is below it
        ("stop_below", 5),
        ("stop_below", ""),
        ("share", "1e-1"),  # as YAML reads it
        ("every", None),
    ],
)
def test_values_out_of_range_are_refused(name, value):
    with pytest.raises(behavexplor.InputError, match=f"{name}="):
        FuzzCallback(**{name: value})


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"budget": "abc"}, "The budget 'abc' is neither"),
        ({"metod": "uniform"}, "Unknown key of the configuration 'metod': did you mean 'method'"),
        ({"method": "unifrom"}, "Unknown search method 'unifrom'"),
        ({"env": "nonexist-v0"}, "Unknown environment 'nonexist-v0'"),
        ({"specs": ["nomod:f"]}, "The spec 'nomod:f' cannot be imported"),
        ({"options": {"epsilon": 3}}, "options of uniform"),
    ],
)
def test_a_mistake_is_named_before_the_training_begins(settings, message, tmp_path):
    model = ppo()
    with pytest.raises(InputError, match=message):
        model.learn(64, callback=FuzzCallback(**{"every": 32, "out": str(tmp_path), **settings}))
    assert model.num_timesteps == 0


def test_each_training_has_a_best_policy_of_its_own_and_a_first_round(tmp_path, monkeypatch):
    """The rounds of the second training are worse, and each takes too long for its share."""
    callback, at_fault = FuzzCallback(every=32, share=1e-9, out=str(tmp_path), **SEARCH), iter([0, 9])

    def made_up(self):
        summary = SimpleNamespace(at_fault=next(at_fault), at_fault_rate=1.0)
        self.rounds.append(FuzzingRound(self.num_timesteps, self.folder, summary, 60.0))
        return self.rounds[-1]

    monkeypatch.setattr(FuzzCallback, "_round", made_up)
    monkeypatch.setattr(FuzzCallback, "_log", lambda *_: None)
    model = ppo()
    for count in (1, 2):
        model.learn(64, callback=callback)
        assert len(callback.rounds) == count
        assert callback.best is callback.rounds[-1]
        assert (callback.folder / BEST).is_file()


def test_a_second_training_has_rounds_of_its_own(tmp_path):
    model, callback = ppo(), FuzzCallback(every=32, share=1.0, method="uniform", out=str(tmp_path), **SEARCH)
    for number, steps in enumerate(([32, 64], [32, 64], [32, 64, 96])):
        model.learn(steps[-1], callback=callback, reset_num_timesteps=number < 2)
        begun = 32 * 2 * (number == 2)
        assert [found.steps - begun for found in callback.rounds[2 * number :]] == steps
    assert callback.folder == tmp_path / "training-2"
    assert {found.folder.parent for found in callback.rounds[:2]} == {tmp_path}
    assert {found.folder.parent for found in callback.rounds[2:]} == {tmp_path / "training-2"}
    assert callback.best in callback.rounds[2:]
    assert (tmp_path / "training-2" / BEST).is_file()
    another = FuzzCallback(every=32, share=1.0, method="uniform", out=str(tmp_path), **SEARCH)
    ppo().learn(32, callback=another)
    assert another.rounds[0].folder.parent == tmp_path / "training-3"


def test_a_path_may_begin_with_the_home_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("USERPROFILE", str(tmp_path))  # on Windows
    (tmp_path / "model.zip").touch()
    assert given_driver("~/model.zip").name == str(tmp_path / "model.zip")
    with pytest.raises(InputError, match=re.escape(str(tmp_path / "none.zip"))):
        given_driver("~/none.zip")
