"""The vector environment for Stable-Baselines3: its protocol, and that policies learn in it."""

import gymnasium
import numpy as np
import pytest

from behavexplor.envs.functional.lane_follow import LaneFollowEnv
from behavexplor.envs.vector import vector_env
from behavexplor.errors import InputError

stable_baselines3 = pytest.importorskip("stable_baselines3")

from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor  # noqa: E402

from behavexplor.envs.sb3 import DrivingVecEnv  # noqa: E402

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
