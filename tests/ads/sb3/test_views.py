"""Policies that were trained behind wrappers see what these made of the observations."""

import sys
from importlib.util import spec_from_file_location

import gymnasium
import numpy as np
import pytest
from gymnasium.wrappers import FlattenObservation, FrameStackObservation
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecFrameStack, VecNormalize

from behavexplor.ads.loading import load_ads
from behavexplor.ads.sb3.model_in_memory import policy_of
from behavexplor.ads.sb3.policy import load_policy
from behavexplor.errors import InputError
from behavexplor.execution.preflight import preflight_warnings
from behavexplor.execution.simulation import Simulation
from tests.ads.sb3.models import META, make_model

SEEN = gymnasium.spaces.Box(-2.0, 2.0, (5, 5), np.float32)
GOALS = gymnasium.spaces.Dict(
    {key: gymnasium.spaces.Box(-2.0, 2.0, (n,), np.float32) for key, n in (("b", 3), ("a", 4))}
)


class Walk(gymnasium.Env):
    """Gives random observations of a space, as often as it is asked."""

    def __init__(self, space=SEEN):
        self.observation_space, self.action_space = space, META

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.observation_space.seed(seed)
        return self.observation_space.sample(), {}

    def step(self, action):
        return self.observation_space.sample(), 0.0, False, False, {}


WRAPPED = {
    "flat": lambda: FlattenObservation(Walk()),
    "stacked": lambda: FrameStackObservation(Walk(), 3),
    "dictionary": lambda: FlattenObservation(Walk(GOALS)),
}


@pytest.mark.parametrize("name", WRAPPED)
def test_a_policy_sees_what_the_wrapper_made(name, tmp_path):
    env = WRAPPED[name]()
    PPO("MlpPolicy", env, device="cpu").save(tmp_path / "model.zip")
    policy = load_policy(tmp_path / "model.zip")
    inner = policy.seeing(env.unwrapped.observation_space, META)
    assert inner.said
    assert policy.seeing(env.observation_space, META) is policy
    state = given = None
    for episode in range(2):  # one in the place of the other
        seen, _ = env.reset(seed=episode)
        space = env.unwrapped.observation_space
        space.seed(episode)
        for step in range(5):
            plain = space.sample()
            rows = {k: v[None] for k, v in plain.items()} if isinstance(plain, dict) else plain[None]
            action, state = inner.predict(rows, state, np.array([step == 0]))
            expected, given = policy.predict(seen[None], given, np.array([step == 0]))
            assert action == expected
            space.seed(100 * episode + step)
            seen, *_ = env.step(0)
            space.seed(100 * episode + step)


def test_frames_are_joined_as_by_vec_frame_stack(tmp_path):
    env = VecNormalize(VecFrameStack(DummyVecEnv([Walk]), 3))
    env.reset()
    for _ in range(20):
        env.step(np.array([0]))
    PPO("MlpPolicy", env, device="cpu").save(tmp_path / "model.zip")
    env.save(tmp_path / "vecnormalize.pkl")
    policy = load_policy(tmp_path / "model.zip").seeing(SEEN, META)
    assert "VecFrameStack(3)" in policy.said
    frames, state = env.venv.stacked_obs.stacked_obs, None
    for i in range(3):
        action, state = policy.predict(frames[:, :, 5 * i : 5 * i + 5], state, np.array([i == 0]))
    plain = load_policy(tmp_path / "model.zip")
    assert action == plain.predict(frames)[0]
    newest = env.normalize_obs(frames)[:, :, 10:]
    np.testing.assert_allclose(policy.prepare(frames[:, :, 10:]), newest, rtol=1e-6)
    (tmp_path / "model.yaml").write_text("frame_stack: 3")
    said = load_policy(tmp_path / "model.zip")
    np.testing.assert_allclose(said.prepare(frames[:, :, 10:]), newest, rtol=1e-6)


def test_frames_that_are_flattened_must_be_said(tmp_path):
    make_model("DQN", gymnasium.spaces.Box(-2.0, 2.0, (75,), np.float32)).save(tmp_path / "model.zip")
    with pytest.raises(InputError, match=r"observes Box\(75,\)"):
        Simulation("highway-fast-v0", str(tmp_path / "model.zip"))
    (tmp_path / "model.yaml").write_text("{frame_stack: 3, config: {}}")
    simulation = Simulation("highway-fast-v0", str(tmp_path / "model.zip"))
    assert any("(5, 5) are flattened for the policy" in one for one in preflight_warnings(simulation))


def test_a_model_in_memory_is_flattened_and_stacked(caplog):
    for wrapped in (FlattenObservation, lambda env: FrameStackObservation(env, 2)):
        model = PPO("MlpPolicy", wrapped(gymnasium.make("highway-fast-v0")), n_steps=8, batch_size=8, device="cpu")
        Simulation("highway-fast-v0", policy_of(model))
    assert not caplog.text
    padded = FrameStackObservation(gymnasium.make("highway-fast-v0"), 2, padding_type="zero")
    policy_of(PPO("MlpPolicy", padded, n_steps=8, batch_size=8, device="cpu"))
    assert "the wrapper FrameStackObservation, which is not applied" in caplog.text  # here, the first frame is repeated


WRAPPERS = """
import gymnasium
import numpy as np


class Twice(gymnasium.ObservationWrapper):
    def __init__(self, env, factor=2.0):
        super().__init__(env)
        self.factor, self.seen = factor, 0
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (25,), np.float32)

    def reset(self, **keywords):
        self.seen = 0
        return super().reset(**keywords)

    def observation(self, observation):
        self.seen += 1
        return np.float32(self.factor * observation.reshape(-1) + self.seen)


class Reversed(gymnasium.ActionWrapper):
    def action(self, action):
        return 4 - action


class Timed(gymnasium.Wrapper):
    pass
"""


@pytest.fixture
def own(tmp_path, monkeypatch):
    """A model with wrappers of the user's own beside it."""
    name = f"wrappers_of_{tmp_path.name.replace('-', '_')}"
    (tmp_path / f"{name}.py").write_text(WRAPPERS)
    monkeypatch.syspath_prepend(tmp_path)
    make_model("DQN", gymnasium.spaces.Box(-np.inf, np.inf, (25,), np.float32)).save(tmp_path / "model.zip")
    settings = tmp_path / "model.yaml"
    settings.write_text(f"wrappers: [{{'{name}:Twice': {{factor: 3.0}}}}, '{name}:Reversed']")
    return tmp_path / "model.zip", settings, name


def digest_asked_for(path):
    with pytest.raises(InputError, match="is code and was not loaded: if you trust it, add --trust sha256:") as caught:
        load_ads(str(path), None)
    return str(caught.value).rpartition(" ")[2]


def test_wrappers_of_the_user_are_applied_only_if_they_are_trusted(own):
    path, settings, name = own
    digest = digest_asked_for(path)
    policy = load_ads(str(path), None, (digest,)).seeing(SEEN, META)
    plain = load_policy(path)
    observations = np.random.default_rng(3).normal(size=(20, 5, 5)).astype(np.float32)
    state = None
    for i, observation in enumerate(observations):
        begins = i % 7 == 0
        action, state = policy.predict(observation[None], state, np.array([begins]))
        seen = np.float32(3.0 * observation.reshape(-1) + (i % 7 + 1))
        assert action == 4 - plain.predict(seen[None])[0]
    assert f"sees and acts through {name}:Twice and {name}:Reversed" in policy.said
    module = path.parent / f"{name}.py"
    module.write_text(WRAPPERS + "\n# changed\n")
    assert digest_asked_for(path) != digest
    settings.write_text(settings.read_text() + "\n# changed\n")
    assert digest_asked_for(path) != digest


def test_all_wrappers_of_a_mapping_are_applied(own):
    path, settings, name = own
    settings.write_text(f"wrappers: [{{'{name}:Twice': {{factor: 3.0}}, '{name}:Reversed': {{}}}}]")
    policy = load_ads(str(path), None, (digest_asked_for(path),)).seeing(SEEN, META)
    assert f"sees and acts through {name}:Twice and {name}:Reversed" in policy.said


def test_modules_that_another_finder_finds_count_in_the_digest(own, monkeypatch, tmp_path):
    path, settings, _ = own
    hidden = tmp_path / "hidden" / "found_elsewhere.py"  # as an editable installation finds it
    hidden.parent.mkdir()
    hidden.write_text(WRAPPERS)

    class Finder:
        @staticmethod
        def find_spec(name, path=None, target=None):
            return spec_from_file_location(name, hidden) if name == "found_elsewhere" else None

    monkeypatch.setattr(sys, "meta_path", [*sys.meta_path, Finder])
    settings.write_text("wrappers: ['found_elsewhere:Reversed']")
    digest = digest_asked_for(path)
    hidden.write_text(WRAPPERS + "\n# changed\n")
    assert digest_asked_for(path) != digest


def test_other_wrappers_are_refused(own):
    path, settings, name = own
    for named, message in (
        (f"{name}:Timed", "is no gymnasium.ObservationWrapper or ActionWrapper"),
        (f"{name}:Missing", "cannot be imported"),
        ("there_is_none:Missing", "cannot be imported"),
    ):
        settings.write_text(f"wrappers: ['{named}']")
        with pytest.raises(InputError, match=message):
            load_ads(str(path), None, (digest_asked_for(path),))


def test_a_policy_in_wrappers_drives(own):
    path, *_ = own
    simulation = Simulation("highway-fast-v0", str(path), (digest_asked_for(path),))
    scenario = simulation.logical.sample(np.random.default_rng(0))
    assert simulation.run(scenario).to_bytes() == simulation.run(scenario).to_bytes()


def test_wrappers_that_do_not_suit_an_environment_are_refused(own):
    path, *_ = own
    policy = load_ads(str(path), None, (digest_asked_for(path),))
    with pytest.raises(InputError, match="does not suit the environment: AttributeError"):
        policy.seeing(GOALS, META)
    with pytest.raises(InputError, match=r"commands Discrete\(5\), but the environment has .* and Discrete\(3\) in"):
        policy.seeing(SEEN, gymnasium.spaces.Discrete(3))
    with pytest.raises(InputError, match=r"observes Box\(-inf, inf, \(25,\), float32\)"):
        policy.seeing(gymnasium.spaces.Box(-1, 1, (6, 5), np.float32), META)
