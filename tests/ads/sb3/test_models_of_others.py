"""Models and configurations as other people have them: unusual networks, lost parts, and files named otherwise."""

import base64
import json
import pickle
import zipfile
from contextlib import suppress
from opcode import opmap

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.wrappers import NormalizeObservation
from sb3_contrib import ARS
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.vec_env import (
    DummyVecEnv,
    VecCheckNan,
    VecEnvWrapper,
    VecExtractDictObs,
    VecFrameStack,
    VecMonitor,
    VecNormalize,
)

from behavexplor.ads.loading import check_name, load_ads
from behavexplor.ads.sb3.archive import read_archive
from behavexplor.ads.sb3.description import describe, files_of_model
from behavexplor.ads.sb3.highway_fit import how_to_fit
from behavexplor.ads.sb3.model_in_memory import policy_of
from behavexplor.ads.sb3.normalization import Statistics
from behavexplor.ads.sb3.policy import load_policy
from behavexplor.errors import InputError
from behavexplor.execution.preflight import preflight_warnings
from behavexplor.execution.simulation import Simulation
from behavexplor.repair.trainees import copy_policy
from tests.ads.sb3.models import make_model
from tests.ads.sb3.test_policy import rewritten

SEEN = gymnasium.spaces.Box(-1.0, 1.0, (5, 5), np.float32)
GRAY = {"type": "GrayscaleObservation", "stack_size": 4, "weights": [0.3, 0.6, 0.1]}


def test_a_recurrent_policy_of_another_width_in_memory_answers_as_it_does():
    model = make_model("RecurrentPPO", SEEN, policy_kwargs={"lstm_hidden_size": 8, "net_arch": [9]})
    seen = SEEN.sample()[None]
    expected = model.predict(seen, deterministic=True)[0]
    np.testing.assert_allclose(policy_of(model).predict(seen)[0], expected, rtol=0, atol=1e-6)


def test_a_linear_policy_of_ars_in_memory_answers_as_it_does():
    model = ARS("LinearPolicy", "CartPole-v1", device="cpu", seed=0)
    seen = np.array([[0.1, 0.2, -0.3, 0.4]], np.float32)
    np.testing.assert_array_equal(policy_of(model).predict(seen)[0], model.predict(seen, deterministic=True)[0])


def test_lost_statistics_of_a_model_in_memory_are_named(tmp_path):
    def make():
        return gymnasium.make("highway-fast-v0", config={"vehicles_count": 5, "duration": 4})

    envs = VecNormalize(DummyVecEnv([make]))
    model = PPO("MlpPolicy", envs, n_steps=16, batch_size=16, n_epochs=1, device="cpu", seed=0).learn(16)
    model.save(tmp_path / "model")
    whole, lost = policy_of(model), policy_of(PPO.load(tmp_path / "model", device="cpu"))
    named = [
        preflight_warnings(Simulation("highway-fast-v0", one, env_config={"duration": 4})) for one in (whole, lost)
    ]
    assert not any("VecNormalize" in finding for finding in named[0])
    assert any("statistics of VecNormalize missing" in finding for finding in named[1])


@pytest.mark.parametrize("name", ["PPO", "MaskablePPO"])
def test_a_policy_whose_masks_are_missing_is_named(name, tmp_path):
    make_model(name, SEEN, gymnasium.spaces.Discrete(5)).save(tmp_path / "model")
    found = preflight_warnings(Simulation("highway-fast-v0", str(tmp_path / "model.zip"), env_config={"duration": 2}))
    assert any("masks of actions" in finding for finding in found) == (name == "MaskablePPO")


@pytest.mark.parametrize("ending", [".yaml", ".yml"])
def test_the_settings_beside_a_model_may_have_both_endings(ending, tmp_path):
    make_model("DQN", SEEN).save(tmp_path / "model")
    (tmp_path / f"model{ending}").write_text("frame_stack: 3")
    assert describe(tmp_path / "model.zip").frame_stack == 3
    copy_policy(tmp_path / "model.zip", tmp_path / "copy.zip")
    assert describe(tmp_path / "copy.zip").frame_stack == 3


def test_the_default_configuration_may_be_stated(tmp_path):
    make_model("DQN", SEEN).save(tmp_path / "model")
    assert not Simulation("highway-fast-v0", str(tmp_path / "model.zip")).is_configured
    (tmp_path / "model.yaml").write_text("config: {}")
    assert Simulation("highway-fast-v0", str(tmp_path / "model.zip")).is_configured


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ("{policy_frequency: 0}", "policy_frequency: expected a number above 0"),
        ("{duration: -1}", "duration: expected a number above 0"),
        ("{policy_frequency: 10}", "policy_frequency 10 must not exceed simulation_frequency 5"),
    ],
)
def test_a_configuration_that_highway_env_would_misread_is_refused(config, message, tmp_path):
    make_model("DQN", SEEN).save(tmp_path / "model")
    (tmp_path / "model.yaml").write_text(f"config: {config}")
    with pytest.raises(InputError, match=message):
        Simulation("highway-fast-v0", str(tmp_path / "model.zip"))


def test_a_policy_on_pictures_is_configured_by_yaml(tmp_path):
    pictures = gymnasium.spaces.Box(0, 255, (4, 40, 30), np.uint8)
    make_model("DQN", pictures).save(tmp_path / "model")
    config = {"observation": {**GRAY, "observation_shape": [40, 30]}, "vehicles_count": 3}
    (tmp_path / "model.yaml").write_text(f"config: {config}")
    simulation = Simulation("highway-fast-v0", str(tmp_path / "model.zip"))
    assert simulation.env.observation_space.shape == (4, 40, 30)


def test_a_model_without_its_ending_is_pointed_to(tmp_path):
    make_model("DQN", SEEN).save(tmp_path / "model")
    with pytest.raises(InputError, match=r"did you mean .*model\.zip\?"):
        check_name(str(tmp_path / "model"))


@pytest.mark.parametrize("missing", ["policy_class", "observation_space", "action_space"])
def test_a_model_without_its_main_settings_is_refused_without_a_hint_to_trust(missing, tmp_path):
    make_model("DQN", SEEN).save(tmp_path / "model")
    with zipfile.ZipFile(tmp_path / "model.zip") as file:
        data = json.loads(file.read("data"))
    del data[missing]
    other = rewritten(tmp_path / "model.zip", tmp_path / "other.zip", data=json.dumps(data).encode())
    for trust in ((), (read_archive(other).digest,)):
        with pytest.raises(InputError, match=f"is not a model of Stable-Baselines3: its data has no {missing}$"):
            load_policy(other, trust)


@pytest.mark.parametrize(
    ("seen", "commands", "hint"),
    [
        ((5, 20), gymnasium.spaces.Discrete(5), "the other one can be {action: {type: DiscreteMetaAction}}"),
        ((3, 3, 8), gymnasium.spaces.Discrete(5), "Give highway-env's `observation` configuration"),
        ((5, 5), gymnasium.spaces.Discrete(25), "action: {type: DiscreteAction, actions_per_axis: 5}}"),
        ((5, 5), gymnasium.spaces.Discrete(3), "or with `longitudinal: false` instead of `lateral: false`"),
        ((5, 5), gymnasium.spaces.Discrete(6), "Give highway-env's `action` configuration"),
    ],
)
def test_what_spaces_do_not_show_is_not_said_to_fit(seen, commands, hint):
    sentence = how_to_fit(gymnasium.spaces.Box(-1, 1, seen), commands)
    assert hint in sentence
    assert sentence.startswith("A configuration that fits") == ("Give" not in hint and "other one" not in hint)


@pytest.mark.parametrize(
    "wrapped",
    [
        lambda: NormalizeObservation(gymnasium.make("highway-fast-v0")),
        lambda: VecExtractDictObs(make_vec_env("parking-v0"), "observation"),
    ],
)
def test_a_model_in_memory_that_was_trained_in_a_wrapper_is_refused(wrapped):
    env = wrapped()
    model = PPO("MlpPolicy", env, n_steps=8, batch_size=8, device="cpu")
    with pytest.raises(InputError, match=f"trained in the wrapper {type(env).__name__}, which is not applied"):
        policy_of(model)


def test_a_pickle_is_no_policy(tmp_path):
    path = tmp_path / "buffer.pkl"
    path.write_bytes(pickle.dumps({"observations": [0.0]}))
    with pytest.raises(InputError, match="is a pickle, such as a replay buffer or the statistics of VecNormalize"):
        load_ads(str(path), None)


@pytest.mark.parametrize("wrapper", [VecNormalize, lambda env: VecFrameStack(env, 2)], ids=["statistics", "frames"])
def test_a_model_in_memory_that_was_trained_in_two_wrappers_of_a_kind_is_refused(wrapper):
    env = wrapper(wrapper(make_vec_env("highway-fast-v0")))
    model = PPO("MlpPolicy", env, n_steps=8, batch_size=8, device="cpu")
    with pytest.raises(InputError, match=f"trained in 2 wrappers {type(env).__name__}, and a campaign applies one"):
        policy_of(model)


class Louder(VecEnvWrapper):
    """A wrapper of a user's own, which changes observations."""

    def reset(self):
        return 2 * self.venv.reset()

    def step_wait(self):
        observation, *others = self.venv.step_wait()
        return 2 * observation, *others


class Quiet(gymnasium.Wrapper):
    """A wrapper of a user's own around a single environment."""


def test_wrappers_of_a_users_own_around_a_model_in_memory_are_named(caplog):
    def make():
        return Quiet(gymnasium.make("highway-fast-v0"))

    model = PPO("MlpPolicy", Louder(VecMonitor(DummyVecEnv([make]))), n_steps=8, batch_size=8, device="cpu")
    policy_of(model)
    assert [record.getMessage().split(",")[0] for record in caplog.records] == [
        f"The model was trained in the wrapper {name}" for name in ("Louder", "Quiet")
    ]


def test_ordinary_wrappers_around_a_model_in_memory_are_not_named(caplog):
    envs = make_vec_env("highway-fast-v0", n_envs=2)  # in a Monitor each
    for wrapped in (VecNormalize(VecCheckNan(envs)), VecFrameStack(envs, 2)):
        policy_of(PPO("MlpPolicy", wrapped, n_steps=8, batch_size=8, device="cpu"))
    assert not caplog.records


class Small(ActorCriticPolicy):
    """A policy that hands on what it gets, as many of other people do."""

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs, net_arch=[8])


def trained_small(path):
    model = PPO(Small, make_model("PPO", SEEN).get_env(), n_steps=16, batch_size=16, device="cpu", seed=0)
    model.save(path)
    return model


def test_a_policy_class_of_their_own_that_hands_on_its_arguments_answers_as_it_does(tmp_path):
    model = trained_small(tmp_path / "model.zip")
    seen = SEEN.sample()[None]
    expected = model.predict(seen, deterministic=True)[0]
    np.testing.assert_array_equal(policy_of(model).predict(seen)[0], expected)
    trust = (read_archive(tmp_path / "model.zip").digest,)
    np.testing.assert_array_equal(load_policy(tmp_path / "model.zip", trust).predict(seen)[0], expected)


def test_code_of_another_python_is_named_before_it_runs(tmp_path, monkeypatch):
    with monkeypatch.context() as patch:  # as if the class stood in a notebook, so that it is in the file
        patch.setattr(Small, "__module__", "__main__")
        trained_small(tmp_path / "model.zip")
    system = b"- OS: x\n- Python: 3.8.10\n- Stable-Baselines3: 1.8.0\n- Gym: 0.21.0\n"
    rewritten(tmp_path / "model.zip", tmp_path / "old.zip", system_info_txt=system)
    archive = read_archive(tmp_path / "old.zip")
    assert archive.versions == ("Python 3.8.10", "Stable-Baselines3 1.8.0", "Gym 0.21.0")
    with pytest.raises(InputError, match=r"needs the class 'Small' of its own\. If you trust"):
        load_policy(tmp_path / "old.zip")
    with pytest.raises(InputError, match=r"contains the class 'Small' of its own as code of Python 3\.8"):
        load_policy(tmp_path / "old.zip", (archive.digest,))


def test_code_of_another_python_is_recognized_by_itself(tmp_path, monkeypatch):
    """As Python 3.13 writes it, or 3.12 for 3.13 and later, with what the file says of its Python unchanged."""
    monkeypatch.setattr(Small, "__module__", "__main__")
    trained_small(tmp_path / "model.zip")
    trust = (read_archive(tmp_path / "model.zip").digest,)
    load_policy(tmp_path / "model.zip", trust)
    code = Small.__init__.__code__  # pickle makes a class only once in a process, so it is this one that is loaded
    other = code.co_code.replace(bytes([opmap["RESUME"], 0]), bytes([149 if opmap["RESUME"] == 151 else 151, 0]))
    monkeypatch.setattr(Small.__init__, "__code__", code.replace(co_code=other))
    with pytest.raises(InputError, match=r"contains the class 'Small' of its own as code of another version than"):
        load_policy(tmp_path / "model.zip", trust)


def test_nothing_is_said_of_calls_that_are_trusted(tmp_path, caplog):
    model = make_model("PPO", SEEN, policy_kwargs={"activation_fn": lambda: torch.nn.ReLU()})  # noqa: PLW0108
    model.save(tmp_path / "model.zip")
    with suppress(InputError):
        load_policy(tmp_path / "model.zip")
    assert "was not run" in caplog.text
    caplog.clear()
    load_policy(tmp_path / "model.zip", (read_archive(tmp_path / "model.zip").digest,))
    assert caplog.text == ""


def test_statistics_beside_a_checkpoint_are_found(tmp_path):
    envs = VecNormalize(make_model("PPO", SEEN).get_env())
    PPO("MlpPolicy", envs, n_steps=16, batch_size=16, device="cpu").save(tmp_path / "rl_model_64_steps.zip")
    for steps in (32, 64):
        envs.save(tmp_path / f"rl_model_vecnormalize_{steps}_steps.pkl")
    found = describe(tmp_path / "rl_model_64_steps.zip")
    assert found.statistics == tmp_path / "rl_model_vecnormalize_64_steps.pkl"
    assert found.statistics in files_of_model(str(tmp_path / "rl_model_64_steps.zip"))


@pytest.mark.parametrize(("name", "value"), [("epsilon", -1.0), ("clip_obs", float("nan")), ("clip_obs", 0.0)])
def test_statistics_that_cannot_scale_are_refused(name, value, tmp_path):
    envs = VecNormalize(make_model("PPO", SEEN).get_env())
    setattr(envs, name, value)
    envs.save(tmp_path / "vecnormalize.pkl")
    with pytest.raises(InputError, match="contains no usable statistics: clip_obs is"):
        Statistics.read(tmp_path / "vecnormalize.pkl")


@pytest.mark.parametrize("name", ["stable_baselines3.nowhere.x Foo", "stable_baselines3.ppo.policies Foo"])
def test_a_class_that_the_installed_version_lacks_is_named(name, tmp_path):
    make_model("PPO", SEEN).save(tmp_path / "model.zip")
    module, attribute = name.split()
    pickled = base64.b64encode(f"c{module}\n{attribute}\n.".encode()).decode()
    with zipfile.ZipFile(tmp_path / "model.zip") as file:
        data = json.loads(file.read("data")) | {"policy_class": {":serialized:": pickled}}
    path = rewritten(tmp_path / "model.zip", tmp_path / "new.zip", data=json.dumps(data).encode())
    with pytest.raises(InputError, match=f"it needs {module}.{attribute}, which the installed version does not have"):
        load_policy(path)
