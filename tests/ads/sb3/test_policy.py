"""Models of Stable-Baselines3 as systems under test: they drive as there, and their files run nothing."""

import base64
import io
import json
import math
import pickle
import time
import zipfile
from collections import OrderedDict
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import torch
import yaml
from stable_baselines3 import SAC, HerReplayBuffer
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.utils import ConstantSchedule
from stable_baselines3.common.vec_env import DummyVecEnv, VecFrameStack, VecNormalize

from behavexplor.ads.sb3.archive import read_archive
from behavexplor.ads.sb3.blocks import BlockwiseNetwork
from behavexplor.ads.sb3.description import STATISTICS, describe, files_of_model
from behavexplor.ads.sb3.highway_fit import how_to_fit
from behavexplor.ads.sb3.normalization import Statistics
from behavexplor.ads.sb3.policy import load_policy
from behavexplor.errors import InputError
from tests.ads.sb3.models import ALGORITHMS, BOX, COMMANDS, Payload, Still, make_model, poison

PLACES = ("lr_schedule", "_last_obs", "new_key", "policy_kwargs", "pytorch_variables.pth", "policy.optimizer.pth")


class Halving(BaseFeaturesExtractor):
    """A user's own extractor."""

    def __init__(self, space):
        super().__init__(space, 35)

    def forward(self, observations):
        return observations.flatten(1) / 2


@pytest.fixture(scope="module")
def observations():
    return np.random.default_rng(0).normal(size=(6, 7, 5)).astype(np.float32)


@pytest.fixture(scope="module")
def ppo(tmp_path_factory):
    path = tmp_path_factory.mktemp("ppo") / "model.zip"
    make_model("PPO").save(path)
    return path


@pytest.mark.parametrize("name", ALGORITHMS)
def test_every_algorithm_answers_as_in_its_library(name, observations, tmp_path):
    model = make_model(name)
    model.save(tmp_path / "model")
    policy = load_policy(tmp_path / "model.zip")
    expected = model.predict(observations, deterministic=True)[0]
    np.testing.assert_allclose(policy.predict(observations)[0], expected, rtol=0, atol=1e-6)
    assert (policy.observation_space, policy.action_space) == (BOX, model.action_space)


@pytest.mark.parametrize("name", ["DQN", "PPO", "SAC", "RecurrentPPO"])
def test_actions_do_not_depend_on_the_batch_to_the_last_bit(name, tmp_path):
    make_model(name).save(tmp_path / "model")
    policy = load_policy(tmp_path / "model.zip")
    many = np.random.default_rng(1).normal(size=(150, 7, 5)).astype(np.float32)
    together, state = policy.predict(many)
    assert len(np.unique(together)) > 1
    for rows in (slice(0, 1), slice(63, 65), slice(100, 150), slice(149, None, -1)):
        np.testing.assert_array_equal(policy.predict(many[rows])[0], together[rows])
    if name == "RecurrentPPO":
        later, _ = policy.predict(many[::-1], state)
        part = (None, tuple(array[:, 70:75] for array in state[1]))
        np.testing.assert_array_equal(policy.predict(many[::-1][70:75], part)[0], later[70:75])


@pytest.mark.parametrize(
    ("layer", "module", "rows"),
    [
        (torch.nn.Linear(4, 1), "stable_baselines3.x", 64),
        (torch.nn.Linear(4, 1), "own", 1),
        (torch.nn.Conv1d(1, 1, 2), "stable_baselines3.x", 1),
    ],
)
def test_a_network_of_other_than_linear_layers_is_asked_for_one_row_at_a_time(layer, module, rows):
    class Counting(BasePolicy):
        def _predict(self, observation, deterministic=False):
            raise NotImplementedError

        def predict(self, observation, state, episode_start, deterministic):
            asked.append(len(observation))
            return observation[:, :1], None

    asked = []
    seen = np.arange(3 * 4.0).reshape(3, 4)
    network = Counting(BOX, BOX)
    network.layer = torch.nn.Sequential(layer, torch.nn.Tanh())
    Counting.__module__ = module
    actions, memory = BlockwiseNetwork(network).ask(seen, None, None)
    assert asked == [rows] * (3 // rows or 1)
    assert actions[:, 0].tolist() == [0, 4, 8]
    assert memory is None


def test_the_number_of_threads_is_left_as_it_was(ppo, observations):
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    two = load_policy(ppo).predict(observations)[0]
    assert torch.get_num_threads() == 2
    torch.set_num_threads(1)
    np.testing.assert_array_equal(load_policy(ppo).predict(observations)[0], two)
    torch.set_num_threads(before)


def test_a_recurrent_policy_carries_its_state_and_forgets_it_at_an_episode_start(tmp_path):
    model = make_model("RecurrentPPO")
    model.save(tmp_path / "model")
    policy = load_policy(tmp_path / "model.zip")
    drives = np.random.default_rng(2).normal(size=(8, 2, 7, 5)).astype(np.float32)
    state, starts = None, np.ones(2, dtype=bool)
    got = []
    for step, observation in enumerate(drives):
        starts = np.array([step == 0, step in (0, 5)])  # the second ego begins another episode at step 5
        actions, state = policy.predict(observation, state, starts)
        got.append(actions)
    alone, memory = [], None
    for step in range(5, 8):
        action, memory = model.predict(drives[step, 1][None], memory, np.array([step == 5]), deterministic=True)
        alone.append(action[0])
    np.testing.assert_allclose([actions[1] for actions in got[5:]], alone, atol=1e-6)
    blank = [model.predict(drives[step, 0][None], deterministic=True)[0][0] for step in range(1, 8)]
    assert np.abs(np.array([actions[0] for actions in got[1:]]) - blank).max() > 1e-4


GOALS = gymnasium.spaces.Dict(
    OrderedDict(  # an order that is not the alphabet's
        observation=gymnasium.spaces.Box(-3.0, 9.0, (6,), np.float64),
        desired_goal=gymnasium.spaces.Box(-3.0, 9.0, (2, 3), np.float32),
        achieved_goal=gymnasium.spaces.Discrete(4),
    )
)


def goals(count):
    GOALS.seed(4)
    samples = [GOALS.sample() for _ in range(count)]
    return {key: np.array([sample[key] for sample in samples]) for key in GOALS}


@pytest.mark.parametrize("name", ["SAC", "PPO", "DQN", "RecurrentPPO"])
def test_a_policy_on_dictionaries_answers_as_in_its_library(name, tmp_path):
    model = make_model(name, GOALS)
    model.save(tmp_path / "model")
    policy = load_policy(tmp_path / "model.zip")
    seen = goals(70)
    expected = model.predict(dict(seen), deterministic=True)[0]
    together = policy.predict(seen)[0]
    np.testing.assert_allclose(together, expected, rtol=0, atol=1e-6)
    part = {key: array[60:63] for key, array in seen.items()}
    np.testing.assert_array_equal(policy.predict(part)[0], together[60:63])
    assert policy.observation_space == GOALS
    assert list(policy.observation_space) == list(GOALS)


def test_a_policy_for_parking_is_read_with_its_buffer_of_hindsight(tmp_path):
    env = gymnasium.make("parking-v0")
    model = SAC("MultiInputPolicy", env, replay_buffer_class=HerReplayBuffer, buffer_size=200, device="cpu")
    model.learn(2)
    model.save(tmp_path / "model")
    assert read_archive(tmp_path / "model.zip").suspicions == ()
    policy = load_policy(tmp_path / "model.zip")
    assert how_to_fit(policy.observation_space, policy.action_space).endswith(
        "as those of highway-env's parking-v0 are"
    )
    observation, _ = env.reset(seed=3)
    action = policy.predict({key: array[None] for key, array in observation.items()})[0]
    np.testing.assert_allclose(action[0], model.predict(observation, deterministic=True)[0], atol=1e-6)
    assert {key: array.shape for key, array in policy.last_trained_on.items()} == dict.fromkeys(
        env.observation_space, (1, 6)
    )


@pytest.mark.parametrize("keys", [["observation"], ["observation", "desired_goal"]])
def test_dictionaries_are_prepared_as_in_training(keys, tmp_path):
    statistics = VecNormalize(DummyVecEnv([lambda: Still(GOALS)]), norm_obs_keys=keys, clip_obs=1.5)
    statistics.reset()
    for _ in range(20):
        statistics.step(np.zeros((1, 2)))
    statistics.training = False
    statistics.save(str(tmp_path / "saved.pkl"))
    scaled = Statistics.read(tmp_path / "saved.pkl").scale(seen := goals(50))
    for key, expected in statistics.normalize_obs(seen).items():
        np.testing.assert_array_equal(scaled[key], expected)


def test_frames_of_dictionaries_are_stacked_as_in_training(tmp_path):
    parts = {key: part for key, part in GOALS.items() if key != "achieved_goal"}
    statistics = VecNormalize(DummyVecEnv([lambda: Still(gymnasium.spaces.Dict(parts))]), norm_obs_keys=["observation"])
    env = VecFrameStack(statistics, 3)
    prepared = env.reset()
    model = make_model("PPO", env.observation_space)
    model.save(tmp_path / "model")
    statistics.training = False
    statistics.save(str(tmp_path / "vecnormalize.pkl"))
    (tmp_path / "model.yaml").write_text("frame_stack: 3\n")
    policy = load_policy(tmp_path / "model.zip")
    assert policy.observation_space == gymnasium.spaces.Dict(parts)
    state, start = None, np.ones(1, dtype=bool)
    for _ in range(5):
        action, state = policy.predict(statistics.get_original_obs(), state, start)
        np.testing.assert_allclose(action, model.predict(prepared, deterministic=True)[0], atol=1e-6)
        prepared, *_ = env.step(action)
        start = np.zeros(1, dtype=bool)


@pytest.mark.parametrize(
    "space",
    [gymnasium.spaces.Tuple([BOX]), gymnasium.spaces.Dict(a=gymnasium.spaces.Dict(b=BOX)), gymnasium.spaces.Text(3)],
    ids=["tuple", "dictionary in a dictionary", "text"],
)
def test_a_space_that_no_policy_has_is_refused_without_a_hint_to_trust(space, tmp_path, ppo):
    pickled = base64.b64encode(pickle.dumps(space)).decode()
    with pytest.raises(InputError, match=r"with a space of the kind (Tuple|Dict|Text) .* is not supported$"):
        load_policy(with_data(ppo, tmp_path / "model.zip", {"observation_space": pickled}))


def test_statistics_of_other_keys_are_refused(tmp_path):
    make_model("PPO", GOALS).save(tmp_path / "model")
    other = gymnasium.spaces.Dict(other=BOX)
    VecNormalize(DummyVecEnv([lambda: Still(other)])).save(str(tmp_path / "vecnormalize.pkl"))
    with pytest.raises(InputError, match=r"for observations of shape \{'other': \(7, 5\)\}, the policy's have"):
        load_policy(tmp_path / "model.zip")


def normalized(stack):
    """Stable-Baselines3's own preparation of observations, its statistics those of some random steps."""
    env = VecNormalize(DummyVecEnv([lambda: Still(gymnasium.spaces.Box(-3.0, 9.0, (7, 5), np.float32))]), clip_obs=1.5)
    env.reset()
    for _ in range(20):
        env.step(np.zeros((1, 2)))
    env.training = False
    return env, (VecFrameStack(env, stack) if stack > 1 else env)


@pytest.mark.parametrize("stack", [1, 3])
def test_observations_are_prepared_as_in_training(stack, tmp_path):
    statistics, env = normalized(stack)
    model = make_model("PPO", env.observation_space)
    model.save(tmp_path / "model")
    statistics.save(str(tmp_path / "vecnormalize.pkl"))
    if stack > 1:
        with pytest.raises(
            InputError, match=r"shape \(7, 5\), the policy's have \(7, 15\): .* say `frame_stack: 3` in"
        ):
            load_policy(tmp_path / "model.zip")
    (tmp_path / "model.yaml").write_text(f"frame_stack: {stack}\n")
    policy = load_policy(tmp_path / "model.zip")
    prepared = env.reset()
    state, start = None, np.ones(1, dtype=bool)
    for _ in range(6):
        action, state = policy.predict(statistics.get_original_obs(), state, start)
        np.testing.assert_allclose(action, model.predict(prepared, deterministic=True)[0], atol=1e-6)
        prepared, *_ = env.step(action)
        start = np.zeros(1, dtype=bool)


def test_stacked_frames_are_scaled_as_in_training(tmp_path):
    stacks = VecFrameStack(DummyVecEnv([lambda: Still(gymnasium.spaces.Box(-3.0, 9.0, (7, 5), np.float32))]), 3)
    env = VecNormalize(stacks, clip_obs=1.5)
    env.reset()
    for _ in range(20):
        env.step(np.zeros((1, 2)))
    env.training = False
    model = make_model("PPO", env.observation_space)
    model.save(tmp_path / "model")
    env.save(str(tmp_path / "vecnormalize.pkl"))
    (tmp_path / "model.yaml").write_text("frame_stack: 3\n")
    policy = load_policy(tmp_path / "model.zip")
    prepared = env.reset()
    state, start = None, np.ones(1, dtype=bool)
    for _ in range(6):
        newest = env.get_original_obs()[..., -5:]
        action, state = policy.predict(newest, state, start)
        np.testing.assert_allclose(action, model.predict(prepared, deterministic=True)[0], atol=1e-6)
        prepared, *_ = env.step(action)
        start = np.zeros(1, dtype=bool)


@pytest.mark.parametrize(
    ("space", "axis"),
    [
        (gymnasium.spaces.Box(0, 255, (4, 40, 36), np.uint8), 1),
        (gymnasium.spaces.Box(-3.0, 9.0, (4, 6, 5), np.float32), 3),
    ],
    ids=["channels of an image", "columns of a grid"],
)
def test_frames_are_stacked_as_in_training(space, axis, tmp_path):
    env = VecFrameStack(DummyVecEnv([lambda: Still(space)] * 2), 3)
    seen = env.reset()
    make_model("PPO", env.observation_space).save(tmp_path / "model")
    (tmp_path / "model.yaml").write_text("frame_stack: 3\n")
    policy = load_policy(tmp_path / "model.zip")
    assert policy.observation_space == space
    state, start = None, np.ones(2, dtype=bool)
    for _ in range(5):
        newest = np.split(seen, 3, axis)[-1]
        _, state = policy.predict(newest, state, start)
        np.testing.assert_array_equal(state[0], seen)
        seen, *_ = env.step(np.zeros((2, 2)))
        start = np.zeros(2, dtype=bool)


def test_what_cannot_be_stacked_frames_is_refused(tmp_path):
    make_model("PPO", gymnasium.spaces.Discrete(6)).save(tmp_path / "model")
    (tmp_path / "model.yaml").write_text("frame_stack: 3\n")
    with pytest.raises(InputError, match=r"observations are of Discrete\(6\), which cannot be 3 stacked frames"):
        load_policy(tmp_path / "model.zip")


def test_statistics_are_those_of_vecnormalize(tmp_path):
    env, _ = normalized(1)
    env.save(str(tmp_path / "saved.pkl"))
    statistics = Statistics.read(tmp_path / "saved.pkl")
    raw = np.random.default_rng(3).uniform(-30, 30, (50, 7, 5)).astype(np.float32)
    np.testing.assert_array_equal(statistics.scale(raw), env.normalize_obs(raw))
    assert statistics.suspicions == ()


@pytest.mark.parametrize("name", STATISTICS)
@pytest.mark.parametrize("place", [".", "intersection-v1"])
def test_statistics_are_found_by_both_names_beside_the_model_and_in_a_folder_of_rl_zoo(name, place, tmp_path, ppo):
    folder = zoo(tmp_path / "run", ppo, settings={"normalize": True})
    env, _ = normalized(1)
    env.save(str(folder / place / name))
    assert describe(folder / "best_model.zip").statistics == folder / place / name
    assert np.abs(load_policy(folder).prepare(np.full((1, 7, 5), 9e9))).max() == env.clip_obs


def test_the_files_of_rl_zoo_may_be_beside_the_model_as_on_the_hub(tmp_path, ppo):
    folder = zoo(tmp_path / "run", ppo, settings={"normalize": True})
    for file in (folder / "intersection-v1").iterdir():
        file.rename(folder / file.name)
    env, _ = normalized(1)
    env.save(str(folder / "vec_normalize.pkl"))
    found = describe(folder / "best_model.zip")
    assert (found.statistics, found.simulation_frequency) == (folder / "vec_normalize.pkl", 15)


def test_another_pickle_with_the_name_of_the_model_is_not_its_statistics(tmp_path, ppo):
    (tmp_path / "model.zip").write_bytes(ppo.read_bytes())
    (tmp_path / "model.pkl").write_bytes(pickle.dumps({"replay": "buffer"}))
    assert describe(tmp_path / "model.zip").statistics is None
    assert files_of_model(str(tmp_path / "model.zip")) == [tmp_path / "model.zip"]
    assert load_policy(tmp_path / "model.zip")


def test_two_files_of_statistics_are_refused(tmp_path, ppo):
    (tmp_path / "model.zip").write_bytes(ppo.read_bytes())
    env, _ = normalized(1)
    for name in STATISTICS:
        env.save(str(tmp_path / name))
    with pytest.raises(InputError, match=r"has vecnormalize.pkl and vec_normalize.pkl: name one .* in model\.yaml"):
        load_policy(tmp_path / "model.zip")
    (tmp_path / "model.yaml").write_text("statistics: vec_normalize.pkl\n")
    assert describe(tmp_path / "model.zip").statistics == tmp_path / "vec_normalize.pkl"


def test_statistics_that_leave_observations_alone_are_none(tmp_path):
    env, _ = normalized(1)
    env.norm_obs = False
    env.save(str(tmp_path / "saved.pkl"))
    assert Statistics.read(tmp_path / "saved.pkl") is None


def test_statistics_of_other_observations_are_refused(tmp_path, ppo):
    env = VecNormalize(DummyVecEnv([lambda: Still(gymnasium.spaces.Box(0.0, 1.0, (4, 5), np.float32))]))
    (tmp_path / "model.zip").write_bytes(ppo.read_bytes())
    env.save(str(tmp_path / "vecnormalize.pkl"))
    with pytest.raises(InputError, match=r"of shape \(4, 5\), the policy's have \(7, 5\)"):
        load_policy(tmp_path / "model.zip")


@pytest.mark.parametrize("content", [b"", b"rubbish", b"\x80\x04N."])
def test_rubbish_instead_of_statistics_is_refused(content, tmp_path, ppo):
    (tmp_path / "model.zip").write_bytes(ppo.read_bytes())
    (tmp_path / "vecnormalize.pkl").write_bytes(content)
    with pytest.raises(InputError, match=r"vecnormalize\.pkl contains no statistics"):
        load_policy(tmp_path / "model.zip")


@pytest.mark.parametrize("place", PLACES)
def test_a_payload_does_nothing_and_is_named(place, tmp_path, ppo, caplog):
    proof = tmp_path / "proof"
    poisoned = poison(ppo, tmp_path / "poisoned.zip", place, proof)
    try:
        load_policy(poisoned)
        named = caplog.text
    except InputError as error:
        named = str(error)
    assert "posix.mkdir" in named
    assert place in named or "needs" in named
    assert not proof.exists()


def test_a_payload_among_the_weights_does_nothing_and_is_named(tmp_path, ppo):
    poisoned = poison(ppo, tmp_path / "poisoned.zip", "policy.pth", tmp_path / "proof")
    with pytest.raises(InputError, match="weights contain objects other than tensors, which were not loaded"):
        load_policy(poisoned)
    assert "policy.pth calls posix.mkdir, which was not run" in read_archive(poisoned).suspicions
    assert not (tmp_path / "proof").exists()


def test_a_payload_in_the_statistics_does_nothing_and_is_named(tmp_path, ppo, caplog):
    env, _ = normalized(1)
    env.extra = Payload(tmp_path / "proof")
    env.save(str(tmp_path / "vecnormalize.pkl"))
    (tmp_path / "model.zip").write_bytes(ppo.read_bytes())
    load_policy(tmp_path / "model.zip")
    assert "vecnormalize.pkl calls posix.mkdir" in caplog.text
    assert not (tmp_path / "proof").exists()


def linear(begin):
    return lambda part: begin * part


@pytest.mark.parametrize("rate", [1e-3, linear(1e-3), ConstantSchedule(1e-3)], ids=["number", "closure", "schedule"])
@pytest.mark.parametrize("name", ["PPO", "A2C", "DQN", "SAC", "TD3"])
def test_an_ordinary_file_is_not_suspected(name, rate, tmp_path):
    make_model(name, learning_rate=rate).save(tmp_path / "model")
    assert read_archive(tmp_path / "model.zip").suspicions == ()


SCHEDULES = json.loads((Path(__file__).parent / "schedules.json").read_text())


@pytest.mark.parametrize("which", SCHEDULES)
def test_a_file_of_an_earlier_version_is_not_suspected(which, tmp_path, ppo):
    key = which.partition(" ")[0]
    assert read_archive(with_data(ppo, tmp_path / "model.zip", {key: SCHEDULES[which]})).suspicions == ()


def test_a_schedule_that_is_an_object_of_the_files_own_class_is_named(tmp_path):
    schedule = type("Schedule", (), {"__module__": "__main__", "__call__": lambda self, part: 1e-3 * part})
    make_model("PPO", learning_rate=schedule()).save(tmp_path / "model")
    assert (
        "'lr_schedule' of its data calls code of its own, which was not run"
        in read_archive(tmp_path / "model.zip").suspicions
    )


def test_code_of_the_users_own_needs_trust_in_that_very_file(tmp_path, observations):
    model = make_model("PPO", policy_kwargs={"features_extractor_class": Halving})
    model.save(tmp_path / "model")
    with pytest.raises(InputError, match=r"Halving.*add --trust sha256:[0-9a-f]{64}") as refused:
        load_policy(tmp_path / "model.zip")
    digest = str(refused.value).rpartition(" ")[2]
    with pytest.raises(InputError, match="add --trust"):
        load_policy(tmp_path / "model.zip", trust=[f"sha256:{'0' * 64}"])
    policy = load_policy(tmp_path / "model.zip", trust=[digest])
    expected = model.predict(observations, deterministic=True)[0]
    np.testing.assert_allclose(policy.predict(observations)[0], expected, rtol=0, atol=1e-6)


def with_data(source: Path, target: Path, pickles) -> Path:
    """A copy of a model's file with other pickles, in base64, among its settings."""
    with zipfile.ZipFile(source) as file:
        data = json.loads(file.read("data"))
    data |= {key: {":serialized:": pickled} for key, pickled in pickles.items()}
    return rewritten(source, target, data=json.dumps(data).encode())


def rewritten(source: Path, target: Path, **members) -> Path:
    """A copy of a zip file with other members; None leaves one out."""
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as new:
        for name in old.namelist():
            content = members.get(name.replace(".", "_"), old.read(name))
            if content is not None:
                new.writestr(name, content)
    return target


@pytest.mark.parametrize(
    ("members", "message"),
    [
        ({"data": None}, "it has no data"),
        ({"policy_pth": None}, r"it has no policy\.pth"),
        ({"data": b"{"}, "damaged"),
        ({"data": b"[]"}, "damaged"),
        ({"data": b"{}"}, "its data has no policy_class, observation_space, action_space"),
        ({"policy_pth": b"rubbish"}, r"damaged: its policy\.pth is not a file that torch wrote"),
        ({"data": b" " * 50_000_000}, "which no model needs"),
    ],
)
def test_a_file_that_is_no_model_is_refused(members, message, tmp_path, ppo):
    with pytest.raises(InputError, match=message):
        load_policy(rewritten(ppo, tmp_path / "model.zip", **members))


def tensors(pickled, content=b""):
    """A file of tensors as torch writes it, but with compressed contents of the tensors."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as new:
        new.writestr("archive/data.pkl", pickled)
        new.writestr("archive/data/0", content, zipfile.ZIP_DEFLATED)
    return file.getvalue()


def legacy():
    """A file of tensors as torch wrote it before 1.6."""
    file = io.BytesIO()
    torch.save({}, file, _use_new_zipfile_serialization=False)
    return file.getvalue()


def program():
    """A program of TorchScript, with whose methods torch would load it."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as new:
        new.writestr("archive/data.pkl", b"N.")
        new.writestr("archive/code/__torch__.py", "")
    return file.getvalue()


LAUGHS = b"\x80\x04)" + b"2\x86" * 30 + b"."  # a tuple, 30 times paired with itself


@pytest.mark.parametrize(
    ("members", "message"),
    [
        (
            {"policy_pth": tensors(b"N.", bytes(10**8))},
            r"policy\.pth in .* would unpack to \d+ bytes, which torch never",
        ),
        ({"policy_pth": bytes(3 * 10**8)}, "would unpack to 3000.* bytes, which no model needs"),
        ({"policy_pth": program()}, r"policy\.pth in .* is a program of TorchScript, which is not run"),
        ({"policy_pth": legacy()}, r"policy\.pth in .* has the format of torch before 1\.6, which is not read"),
        ({"policy_pth": tensors(b"\x80\x04}" + LAUGHS[2:-1] + b"Ns.")}, "a tuple as a key"),
        ({"policy_optimizer_pth": tensors(b"N0" * 200_000 + b"N.")}, "300000 instructions"),
    ],
    ids=["weights", "member", "program", "legacy", "keys", "instructions"],
)
def test_a_file_made_to_take_long_is_refused_at_once(members, message, tmp_path, ppo):
    path = rewritten(ppo, tmp_path / "model.zip", **members)
    before = time.process_time()
    with pytest.raises(InputError, match=message):
        load_policy(path)
    assert time.process_time() - before < 5


@pytest.mark.parametrize("key", ["policy_class", "policy_kwargs", "observation_space", "_last_obs"])
def test_settings_that_repeat_their_parts_are_refused_at_once(key, tmp_path, ppo):
    path = with_data(ppo, tmp_path / "model.zip", {key: base64.b64encode(LAUGHS).decode()})
    before = time.process_time()
    with pytest.raises(InputError, match=f"cannot be read: {key}: its values have more than 100000 parts"):
        load_policy(path)
    assert time.process_time() - before < 5


def test_a_warning_shows_no_control_characters(tmp_path, ppo, caplog):
    pickled = base64.b64encode(pickle.dumps("x")[:-1] + b"0c\x1b[2J\nevil\n.").decode()
    load_policy(with_data(ppo, tmp_path / "model.zip", {"lr_schedule": pickled}))
    (record,) = caplog.records
    assert record.getMessage().isprintable()
    assert "calls \\x1b[2J.evil, which was not run" in record.getMessage()


@pytest.mark.parametrize("keywords", [[8, 8], "net_arch", 3, True])
def test_keywords_of_a_policy_that_have_no_names_are_refused(keywords, tmp_path, ppo):
    with zipfile.ZipFile(ppo) as file:
        data = json.loads(file.read("data")) | {"policy_kwargs": keywords}
    with pytest.raises(InputError, match="cannot be read"):
        load_policy(rewritten(ppo, tmp_path / "model.zip", data=json.dumps(data).encode()))


@pytest.mark.parametrize(
    ("settings", "space"),
    [
        ({"net_arch": [30_000, 30_000]}, None),
        ({"net_arch": {"pi": [8], "vf": [10**12]}}, None),
        ({"net_arch": [8] * 50_000}, None),
        ({"features_extractor_kwargs": {"features_dim": 10**9}}, None),
        ({"lstm_hidden_size": 30_000}, None),
        ({"n_quantiles": 10**9}, None),
        ({"n_critics": 500_000}, None),
        ({"n_critics": 3000, "net_arch": [64, 64]}, None),
        ({}, gymnasium.spaces.Discrete(10**9)),
        ({}, gymnasium.spaces.MultiDiscrete([2, 10**8])),
    ],
    ids=[
        "two wide layers",
        "one wide layer",
        "many layers",
        "many features",
        "wide memory",
        "many quantiles",
        "many critics",
        "many critics of some width",
        "many actions",
        "many actions of an axis",
    ],
)
def test_a_network_larger_than_its_weights_is_never_made(settings, space, tmp_path, ppo, monkeypatch):
    monkeypatch.setattr(torch.nn.Linear, "__init__", None)
    with zipfile.ZipFile(ppo) as file:
        data = json.loads(file.read("data")) | {"policy_kwargs": settings}
    if space is not None:
        data["action_space"] = {":serialized:": base64.b64encode(pickle.dumps(space)).decode()}
    with pytest.raises(InputError, match=r"its weights are too few for the network|more than 100 layers"):
        load_policy(rewritten(ppo, tmp_path / "model.zip", data=json.dumps(data).encode()))


@pytest.mark.parametrize("method", [zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2])
def test_members_that_cannot_be_unpacked_in_bounds_are_refused(method, tmp_path, ppo):
    with zipfile.ZipFile(ppo) as old, zipfile.ZipFile(tmp_path / "model.zip", "w", method) as new:
        for name in old.namelist():
            new.writestr(name, old.read(name))
    with pytest.raises(InputError, match="is compressed by another method than deflate"):
        load_policy(tmp_path / "model.zip")


@pytest.mark.parametrize("n", [math.inf, 10**400, -3])
def test_a_space_without_a_usable_size_is_refused(n, tmp_path, ppo):
    space = gymnasium.spaces.Discrete(5)
    space.n = n
    with zipfile.ZipFile(ppo) as file:
        data = json.loads(file.read("data"))
    data["action_space"] = {":serialized:": base64.b64encode(pickle.dumps(space)).decode()}
    with pytest.raises(InputError, match="cannot be read"):
        load_policy(rewritten(ppo, tmp_path / "model.zip", data=json.dumps(data).encode()))


@pytest.mark.parametrize("layers", [8, "8", [8, [[[8]]]], [8, 8.0], [None], {"pi": 8}, {"pi": [[8]], "vf": [8]}])
def test_layers_that_are_no_widths_are_refused(layers, tmp_path, ppo):
    with zipfile.ZipFile(ppo) as file:
        data = json.loads(file.read("data")) | {"policy_kwargs": {"net_arch": layers}}
    with pytest.raises(InputError, match="its net_arch must be a list of layer widths"):
        load_policy(rewritten(ppo, tmp_path / "model.zip", data=json.dumps(data).encode()))


def test_a_file_cut_short_is_refused_in_a_sentence(tmp_path, ppo):
    data = ppo.read_bytes()
    for length in range(0, len(data), 997):
        (tmp_path / "model.zip").write_bytes(data[:length])
        with pytest.raises(InputError, match=r"is not a (zip file|model) of Stable-Baselines3"):
            load_policy(tmp_path / "model.zip")


def test_weights_of_another_network_are_refused(tmp_path, ppo):
    make_model("PPO", policy_kwargs={"net_arch": [9]}).save(tmp_path / "other")
    with zipfile.ZipFile(tmp_path / "other.zip") as other:
        mixed = rewritten(ppo, tmp_path / "mixed.zip", policy_pth=other.read("policy.pth"))
    with pytest.raises(InputError, match="weights and settings do not fit each other"):
        load_policy(mixed)


def zoo(folder: Path, model: Path, *, arguments=None, settings=None) -> Path:
    """A run folder as rl-zoo3 writes it."""
    inner = folder / "intersection-v1"
    inner.mkdir(parents=True)
    (folder / "intersection-v1.zip").write_bytes(model.read_bytes())
    (folder / "best_model.zip").write_bytes(model.read_bytes())
    tag = "!!python/object/apply:collections.OrderedDict\n"
    arguments = {"algo": "ppo", "env": "intersection-v1", "env_kwargs": None} if arguments is None else arguments
    for name, values in (("args.yml", arguments), ("config.yml", settings or {})):
        (inner / name).write_text(tag + yaml.safe_dump([[[key, value] for key, value in values.items()]]))
    return folder


def test_a_run_of_rl_zoo_says_what_its_policy_observes(tmp_path):
    model = make_model("PPO", gymnasium.spaces.Box(-np.inf, np.inf, (5, 16), np.float32), COMMANDS)
    model.save(tmp_path / "model")
    changed = {"env": "intersection-v1", "env_kwargs": {"config": {"policy_frequency": 5}}}
    folder = zoo(tmp_path / "run", tmp_path / "model.zip", arguments=changed, settings={"frame_stack": 2})
    for path in (folder, folder / "best_model.zip"):
        policy = load_policy(path)
        assert policy.observation["features"][-1] == "ang_off"
        assert policy.action["type"] == "ContinuousAction"
        assert (policy.policy_frequency, policy.simulation_frequency) == (5, 15)
        assert policy.observation_space.shape == (5, 8)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"env_wrapper": "os.system"}, "trained in the wrapper 'os.system', which is not supported"),
        ({"vec_env_wrapper": [{"mine.Scaled": {"by": 2}}]}, "trained in the wrapper .*mine.Scaled.*not supported"),
        ({"env_wrapper": [{"gymnasium.wrappers.TimeLimit": {}}, "mine.Scaled"]}, "the wrapper 'mine.Scaled'"),
        ({"normalize": True}, r"observations were normalized, but vecnormalize\.pkl is missing"),
        ({"frame_stack": "many"}, "frame_stack of .*valid integer"),
        ({"frame_stack": -2}, "greater than or equal to 1"),
    ],
)
def test_a_run_of_rl_zoo_that_cannot_be_repeated_is_refused(settings, message, tmp_path, ppo):
    with pytest.raises(InputError, match=message):
        load_policy(zoo(tmp_path / "run", ppo, settings=settings))


@pytest.mark.parametrize(
    "settings",
    [
        {"vec_env_wrapper": "stable_baselines3.common.vec_env.VecMonitor"},
        {"env_wrapper": "stable_baselines3.common.monitor.Monitor"},
        {"env_wrapper": [{"gymnasium.wrappers.TimeLimit": {"max_episode_steps": 100}}]},
    ],
)
def test_a_run_of_rl_zoo_may_have_wrappers_that_change_no_decision(settings, tmp_path, ppo):
    assert describe(zoo(tmp_path / "run", ppo, settings=settings) / "best_model.zip").env == "intersection-v1"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("frame_stak: 2", "did you mean 'frame_stack'"),
        ("memory_limit: 1", "known are about, action, activation, "),
        ("__pydantic_config__: 1", "Unknown key of"),
        ("frame_stack: 0", "greater than or equal to 1"),
        ("policy_frequency: fast", "policy_frequency"),
        ("statistics: gone.pkl", r"gone\.pkl, which does not exist"),
        ("- 1", "must contain keys and values"),
        ("a: !!python/object/apply:os.mkdir [x]", "cannot be read"),
        ("a: [", "cannot be read"),
        ("frame_stack: 2", "5 columns, which cannot be 2 stacked frames"),
    ],
)
def test_a_wrong_description_is_refused(text, message, tmp_path, ppo):
    (tmp_path / "model.zip").write_bytes(ppo.read_bytes())
    (tmp_path / "model.yaml").write_text(text)
    with pytest.raises(InputError, match=message):
        load_policy(tmp_path / "model.zip")


def test_a_folder_without_one_model_is_refused(tmp_path, ppo):
    with pytest.raises(InputError, match="has none: name the file"):
        load_policy(tmp_path)
    for name in ("a.zip", "b.zip"):
        (tmp_path / name).write_bytes(ppo.read_bytes())
    with pytest.raises(InputError, match=r"has a\.zip, b\.zip: name the file"):
        load_policy(tmp_path)
    with pytest.raises(InputError, match="There is no file or folder"):
        load_policy(tmp_path / "c.zip")


def test_the_last_observations_of_the_training_are_known(tmp_path):
    model = make_model("A2C", n_steps=2)
    model.learn(4)
    model.save(tmp_path / "model")
    np.testing.assert_array_equal(load_policy(tmp_path / "model.zip").last_trained_on, model._last_obs)


def test_settings_without_pickles_suffice(tmp_path, ppo):
    """Every pickle in the data that is not a space or a class may be missing."""
    with zipfile.ZipFile(ppo) as file:
        data = json.loads(file.read("data"))
    kept = {key: data[key] for key in ("policy_class", "policy_kwargs", "observation_space", "action_space")}
    policy = load_policy(rewritten(ppo, tmp_path / "model.zip", data=json.dumps(kept).encode()))
    assert policy.last_trained_on is None


def test_a_configuration_of_rl_zoo_that_is_a_text_is_named(tmp_path, ppo):
    arguments = {"env": "highway-v0", "env_kwargs": {"config": "{'duration': 3}"}}
    with pytest.raises(InputError, match=r"has the config .*duration.*, which is no mapping"):
        load_policy(zoo(tmp_path / "run", ppo, arguments=arguments))
