"""The vector environment for Stable-Baselines3: its protocol, and that policies learn in it."""

import gymnasium
import numpy as np
import pytest

from behavexplor.data.scripted import NPC, ScriptedScenario, Waypoint
from behavexplor.envs.functional import LaneFollowEnv
from behavexplor.envs.vector_env import vector_env
from behavexplor.errors import InputError

stable_baselines3 = pytest.importorskip("stable_baselines3")
torch = pytest.importorskip("torch")

from stable_baselines3.common.evaluation import evaluate_policy  # noqa: E402
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor, VecNormalize  # noqa: E402

from behavexplor.envs.sb3_vec_env import DrivingVecEnv  # noqa: E402

torch.set_num_threads(1)  # networks are small: more threads only wait for one another

CONFIG = {"observation": {"type": "Scene"}, "duration": 1.0}


def make(n_envs=3, **config):
    return DrivingVecEnv(vector_env(LaneFollowEnv)(n_envs, {**CONFIG, **config}, autoreset_mode="SameStep"))


class Traceless(gymnasium.Wrapper):
    """Without the trace in the infos: `DummyVecEnv` copies them deeply."""

    def step(self, action):
        *results, info = self.env.step(action)
        info.pop("trace", None)
        return (*results, info)


def test_it_is_a_dummy_vec_env_of_single_environments():
    ours = make()
    theirs = DummyVecEnv([lambda: Traceless(LaneFollowEnv(CONFIG))] * 3)
    ours.seed(4), theirs.seed(4)
    assert ours.reset() == pytest.approx(theirs.reset(), abs=1e-9)
    assert ours.reset_infos == theirs.reset_infos
    rng = np.random.default_rng(0)
    n_ended = 0
    for _ in range(25):
        actions = rng.uniform(-1, 1, (3, 2)).astype(np.float32)
        observations, rewards, dones, infos = ours.step(actions)
        expected, expected_rewards, expected_dones, expected_infos = theirs.step(actions)
        assert observations == pytest.approx(expected, abs=1e-9)
        assert rewards == pytest.approx(expected_rewards)
        assert rewards.dtype == expected_rewards.dtype
        assert np.array_equal(dones, expected_dones)
        assert ours.reset_infos == theirs.reset_infos
        for done, info, expected_info in zip(dones, infos, expected_infos, strict=True):
            assert info["TimeLimit.truncated"] == expected_info["TimeLimit.truncated"]
            n_ended += done
            if done:
                assert info.keys() == expected_info.keys() | {"trace"}
                assert info["terminal_observation"] == pytest.approx(expected_info["terminal_observation"], abs=1e-9)
                assert info["rewards"] == pytest.approx(expected_info["rewards"], abs=1e-9)
                assert info["trace"].end == info["end"] == expected_info["end"]
    assert n_ended >= 6


def test_options_hold_for_one_reset():
    env = make()
    scenario = env.get_attr("logical")[0].sample(np.random.default_rng(0))
    env.set_options([{}, {"scenario": scenario}, {}])
    env.reset()
    assert [given == scenario for given in env.get_attr("scenario")] == [False, True, False]
    assert env.get_attr("scenario", indices=[1]) == [scenario]
    env.reset()
    assert scenario not in env.get_attr("scenario")


@pytest.mark.parametrize("action", ["ContinuousAction", "DiscreteMetaAction"])
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_ppo_trains_in_it(action):
    env = VecMonitor(make(8, observation={"type": "Kinematics"}, action={"type": action}))
    model = stable_baselines3.PPO("MlpPolicy", env, n_steps=32, batch_size=64, n_epochs=2, seed=0, device="cpu")
    model.learn(512)
    assert model.num_timesteps == 512
    assert len(model.ep_info_buffer) >= 8
    assert np.isfinite([episode["r"] for episode in model.ep_info_buffer]).all()


def test_what_it_cannot_do_is_refused():
    with pytest.raises(InputError, match="'SameStep'"):
        DrivingVecEnv(vector_env(LaneFollowEnv)(2, CONFIG))
    with pytest.raises(InputError, match="vector environment of this package"):
        DrivingVecEnv(LaneFollowEnv(CONFIG))
    env = make()
    with pytest.raises(InputError, match="cannot be set"):
        env.set_attr("config", {})
    with pytest.raises(InputError, match="no methods of their own"):
        env.env_method("configure", {})
    assert env.env_is_wrapped(object) == [False] * 3
    env.close()


def play(env, steps=30, seed=0):
    """All that random actions bring: observations, rewards, ends and infos of every step."""
    rng = np.random.default_rng(seed)
    log = [env.reset()]
    for _ in range(steps):
        log += env.step(rng.uniform(-1, 1, (env.num_envs, 2)).astype(np.float32))
    return log


def test_the_same_seed_gives_the_same_episodes():
    env = make()
    logs = []
    for seed in (5, 5, 6):
        assert env.seed(seed) == [seed, seed + 1, seed + 2]
        logs.append(play(env))
    same = [
        all(np.array_equal(a, b) for a, b in zip(logs[0], other, strict=True) if isinstance(a, np.ndarray))
        for other in logs[1:]
    ]
    assert same == [True, False]


def test_the_time_limit_is_told_from_a_real_end():
    """Both happen here: the first ego stands until time is up, the second is struck from behind."""
    ranges = LaneFollowEnv.logical.position_ranges(LaneFollowEnv.logical.roadmap.routes["lane-3"])
    last = len(ranges) - 1
    waypoints = [Waypoint(float(max(low, 40.0)) if low < 240 else float(low), 0.2) for low, _ in ranges]
    waypoints = [Waypoint(w.position, 0.0 if i == last else w.speed) for i, w in enumerate(waypoints)]
    ahead = ScriptedScenario("lane-follow", (NPC("sedan", "lane-3", tuple(waypoints)),))
    env = make(2, duration=6.0)
    env.set_options([{"scenario": ScriptedScenario("lane-follow", ())}, {"scenario": ahead}])
    env.reset()
    seen = {}
    for _ in range(60):
        _, rewards, dones, infos = env.step(np.array([[0.0, 0.0], [1.0, 0.0]]))
        for b in np.flatnonzero(dones):
            seen.setdefault(int(b), (infos[b]["end"], infos[b]["TimeLimit.truncated"], float(rewards[b]) < -15))
    assert seen == {0: ("timeout", True, False), 1: ("collision", False, True)}


def test_the_terminal_observation_is_the_one_before_the_reset():
    env = make(1)
    env.seed(3), env.reset()
    single = LaneFollowEnv(CONFIG)
    single.reset(seed=3)
    for _ in range(10):
        observations, _, dones, infos = env.step(np.full((1, 2), 0.7))
        last = single.step(np.full(2, 0.7))[0]
    assert dones[0]
    assert infos[0]["terminal_observation"] == pytest.approx(last, abs=1e-9)
    assert np.array_equal(observations[0], single.reset()[0])


def test_attributes_are_those_of_the_chosen():
    env = make()
    env.reset()
    assert env.get_attr("config", indices=0) == [env.env.config]
    assert len(env.get_attr("logical", indices=[0, 2])) == 2
    assert env.get_attr("scenario") == [info["scenario"] for info in env.reset_infos]
    assert env.get_attr("render_mode") == [None] * 3
    assert (env.has_attr("logical"), env.has_attr("action_masks")) == (True, False)
    assert env.get_images() == [None] * 3
    assert env.unwrapped is env


def test_stable_baselines3_s_wrappers_and_evaluation_take_it():
    env = VecNormalize(VecMonitor(make(2, observation={"type": "Kinematics"})), gamma=0.9)
    model = stable_baselines3.PPO("MlpPolicy", env, n_steps=16, batch_size=16, n_epochs=1, seed=0, device="cpu")
    model.learn(64)
    env.training = env.norm_reward = False
    returns, lengths = evaluate_policy(model, env, n_eval_episodes=4, return_episode_rewards=True)
    assert len(returns) == 4
    assert lengths == [10] * 4  # decisions in a second
    assert all(-25 < value < 5 for value in returns)
    assert np.abs(env.obs_rms.mean).max() > 0
    env.close()


@pytest.mark.parametrize("kind", ["DQN", "SAC"])
def test_off_policy_methods_learn_in_it(kind):
    action = {"type": "DiscreteMetaAction"} if kind == "DQN" else {"type": "ContinuousAction"}
    env = make(2, observation={"type": "Kinematics"}, action=action)
    model = getattr(stable_baselines3, kind)(
        "MlpPolicy", env, learning_starts=4, batch_size=8, buffer_size=200, device="cpu"
    )
    before = [parameter.detach().clone() for parameter in model.policy.parameters()]
    model.learn(40)
    assert any(not old.equal(new) for old, new in zip(before, model.policy.parameters(), strict=True))
    assert model.replay_buffer.size() == 20  # of two environments each


@pytest.mark.parametrize("actions", [np.zeros(2), np.zeros((2, 2)), np.full((3, 2), np.nan)])
def test_wrong_actions_are_refused(actions):
    env = make()
    env.reset()
    with pytest.raises(InputError, match="actions: expected finite numbers"):
        env.step(actions)


def test_wrong_options_are_refused():
    env = make()
    env.set_options({"scenario": "s1.json"})
    with pytest.raises(InputError, match="A scenario must be a"):
        env.reset()
