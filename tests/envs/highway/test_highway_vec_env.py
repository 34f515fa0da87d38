"""The Stable-Baselines3 form of the compiled environments takes the place of `DummyVecEnv`."""

import gymnasium
import highway_env  # noqa: F401 - registers the environments
import numpy as np
import pytest
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv

from behavexplor.envs.sb3_vec_env import HighwayVecEnv
from behavexplor.errors import InputError

CONFIG = {"vehicles_count": 6, "duration": 3}


def make(vec_env_cls, count=2, env_id="highway-fast-v0", config=CONFIG, **arguments):
    env = make_vec_env(
        env_id, n_envs=count, vec_env_cls=vec_env_cls, env_kwargs={"config": config} if config else {}, **arguments
    )
    env.seed(4)
    return env


def shown(info):
    """Return an info without what is drawn without a seed, or depends on the time."""
    episode = {key: value for key, value in info.get("episode", {}).items() if key != "t"}
    terminal = np.asarray(info.get("terminal_observation", 0.0)).tolist()
    kept = {key: value for key, value in info.items() if key not in ("action", "episode", "terminal_observation")}
    return kept | {"episode": episode, "terminal": terminal}


def test_steps_are_those_of_dummy_vec_env():
    ours, theirs = make(HighwayVecEnv), make(DummyVecEnv)
    assert (ours.observation_space, ours.action_space) == (theirs.observation_space, theirs.action_space)
    np.testing.assert_allclose(ours.reset(), theirs.reset(), atol=1e-6)
    assert [info.keys() for info in ours.reset_infos] == [info.keys() for info in theirs.reset_infos]
    rng, ends = np.random.default_rng(0), 0
    for _ in range(12):
        actions = rng.integers(5, size=2)
        our_step, their_step = ours.step(actions), theirs.step(actions)
        for these, those in zip(our_step[:3], their_step[:3], strict=True):
            assert these.dtype == those.dtype
            np.testing.assert_allclose(these, those, atol=1e-6)
        for these, those in zip(our_step[3], their_step[3], strict=True):
            assert alike(shown(these), shown(those))
        ends += int(our_step[2].sum())
    assert ends >= 4


def alike(these, those):
    """Return whether nested values are equal, floats to 1e-6."""
    if isinstance(these, dict):
        return these.keys() == those.keys() and all(alike(these[key], those[key]) for key in these)
    if isinstance(these, list):
        return np.allclose(these, those, atol=1e-6)
    return bool(these == pytest.approx(those, abs=1e-6))


def test_ppo_learns_on_it_and_reports_episodes():
    env = make(HighwayVecEnv, 4)
    model = PPO("MlpPolicy", env, n_steps=16, batch_size=32, device="cpu")
    before = [parameter.detach().clone() for parameter in model.policy.parameters()]
    model.learn(64)
    assert any(not old.equal(new) for old, new in zip(before, model.policy.parameters(), strict=True))
    assert len(model.ep_info_buffer) >= 4
    assert env.env_is_wrapped(Monitor) == [True] * 4
    env.get_attr("config")[0]["vehicles_count"] = 7  # a copy
    assert env.get_attr("config")[0]["vehicles_count"] == 6


def test_the_monitor_s_file_has_all_episodes(tmp_path):
    env = make(HighwayVecEnv, 3, monitor_dir=str(tmp_path))
    env.reset()
    for _ in range(3):
        env.step(np.ones(3, dtype=np.int64))
    env.close()
    (file,) = tmp_path.glob("*.csv")
    assert len(file.read_text().splitlines()) == 2 + 3


def test_a_time_limit_truncates():
    env = HighwayVecEnv([lambda: Monitor(gymnasium.make("two-way-v0", max_episode_steps=3))] * 2)
    env.seed(0)  # some other episodes end earlier, with a crash
    env.reset()
    for _ in range(3):
        *_, dones, infos = env.step(np.full(2, 4))
    assert dones.all()
    assert all(info["TimeLimit.truncated"] for info in infos)
    assert [info["episode"]["l"] for info in infos] == [3, 3]


def test_other_wrappers_are_refused():
    with pytest.raises(InputError, match="no counterpart of the wrapper FlattenObservation; use DummyVecEnv"):
        HighwayVecEnv([lambda: gymnasium.wrappers.FlattenObservation(gymnasium.make("highway-fast-v0"))])


def test_reset_options_are_refused():
    env = HighwayVecEnv([lambda: gymnasium.make("highway-fast-v0")])
    env.set_options({"config": {"lanes_count": 2}})
    with pytest.raises(InputError, match="no reset options"):
        env.reset()


def made(duration=3):
    return gymnasium.make("highway-fast-v0", config={"vehicles_count": 6, "duration": duration})


class Maker:
    """Makes environments of a duration."""

    def __init__(self, duration):
        self.duration = duration

    def make(self):
        return made(self.duration)


@pytest.mark.parametrize(
    "makers",
    [
        [lambda d=d: made(d) for d in (3, 8)],
        [lambda *, d=d: made(d) for d in (3, 8)],
        [Maker(d).make for d in (3, 8)],
        [made, lambda: gymnasium.make("merge-v1")],
        [lambda: made(), lambda: made(), lambda: made(4)],  # noqa: PLW0108 - functions of their own
    ],
)
def test_functions_that_make_different_environments_are_refused(makers):
    with pytest.raises(InputError, match=rf"env_fns\[{len(makers) - 1}\] makes another environment than env_fns\[0\]"):
        HighwayVecEnv(makers)


def test_functions_that_make_the_same_are_called_only_if_they_might_differ():
    calls = []

    def maker(number):
        def make():
            calls.append(number)
            return made()

        return make

    same = maker(0)
    assert HighwayVecEnv([same, same, *[lambda: made() for _ in range(2)]]).num_envs == 4  # noqa: PLW0108
    assert calls == [0]
    assert HighwayVecEnv([maker(1), maker(2)]).num_envs == 2
    assert calls == [0, 1, 2]


def test_what_is_no_environment_of_highway_env_is_refused():
    with pytest.raises(InputError, match=r"runs environments of highway-env, not .*CartPole"):
        HighwayVecEnv([lambda: gymnasium.make("CartPole-v1")])
    with pytest.raises(InputError, match="at least one function"):
        HighwayVecEnv([])


def test_configurations_with_arrays_are_compared():
    def make(speeds):
        action = {"type": "DiscreteMetaAction", "target_speeds": np.array(speeds)}
        return lambda: gymnasium.make("highway-fast-v0", config={"vehicles_count": 3, "action": action})

    assert HighwayVecEnv([make([20, 25, 30]), make([20, 25, 30])]).num_envs == 2
    with pytest.raises(InputError, match=r"env_fns\[1\] makes another environment"):
        HighwayVecEnv([make([20, 25, 30]), make([10, 25, 30])])
