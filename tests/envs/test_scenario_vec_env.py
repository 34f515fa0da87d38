"""Training in chosen scenarios."""

import numpy as np
import pytest

from behavexplor.envs.making import make_env, make_vector_env
from behavexplor.envs.sb3_vec_env import ScenarioVecEnv


@pytest.fixture(params=[("lane-change", {"duration": 4}), ("highway-fast-v0", {})], ids=lambda given: given[0])
def env(request):
    name, config = request.param
    made = ScenarioVecEnv(make_vector_env(make_env(name, config), 3, {}, rewards=True))
    yield made
    made.close()


def drive(env, steps):
    """Random actions; the observations, rewards and ends."""
    env.action_space.seed(1)
    seen = [(env.reset(), None, None)]
    infos = []
    for _ in range(steps):
        observation, rewards, dones, info = env.step([env.action_space.sample() for _ in range(env.num_envs)])
        seen.append((observation, rewards, dones))
        infos.append(info)
    return seen, infos


def test_the_same_seed_gives_the_same_scenarios(env):
    env.seed(5)
    first, _ = drive(env, 40)
    env.seed(5)
    second, _ = drive(env, 40)
    for one, other in zip(first, second, strict=True):
        for a, b in zip(one, other, strict=True):
            np.testing.assert_array_equal(a, b)
    assert any(dones.any() for _, _, dones in first[1:])


def test_every_episode_drives_a_drawn_scenario_and_ends_with_its_trace(env):
    drawn = []

    def sampler(rng):
        drawn.append(env.logical.sample(rng))
        return drawn[-1]

    env.sampler = sampler
    seen, infos = drive(env, 60)
    ended = [(dones, info) for (_, _, dones), info in zip(seen[1:], infos, strict=True) if dones.any()]
    assert len(drawn) == env.num_envs + sum(int(dones.sum()) for dones, _ in ended)
    assert env.get_attr("scenario") == env.scenarios
    assert set(env.scenarios) <= set(drawn)
    dones, info = ended[0]
    last = info[int(dones.argmax())]
    assert last["end"] == last["trace"].end
    assert last["terminal_observation"].shape == env.observation_space.shape
    assert "trace" not in info[int(dones.argmin())] or dones.all()


def test_an_episode_that_ends_gives_way_to_another_at_once(env):
    seen, infos = drive(env, 60)
    step = next(i for i, (_, _, dones) in enumerate(seen[1:]) if dones.any())
    observation, _, dones = seen[step + 1]
    b = int(dones.argmax())
    assert not np.array_equal(observation[b], infos[step][b]["terminal_observation"])


def test_rewards_are_those_of_the_environment():
    single = make_env("highway-fast-v0", {})
    env = ScenarioVecEnv(make_vector_env(make_env("highway-fast-v0", {}), 2, {}, rewards=True))
    env.reset()
    single.reset(options={"scenario": env.scenarios[0]})
    for _ in range(5):
        _, rewards, dones, _ = env.step([1, 1])
        _, expected, *_ = single.step(1)
        assert rewards[0] == pytest.approx(expected, abs=1e-6)
        assert not dones[0]
    env.close()
    single.close()
