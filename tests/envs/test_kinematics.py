"""The Kinematics observation of the engine beside highway-env's own, on the objects that show the same episode."""

import numpy as np
import pytest
from highway_env.envs.common.observation import KinematicObservation

from behavexplor.envs.functional import IntersectionLeftEnv, LaneChangeEnv
from behavexplor.envs.observation_types import FEATURES

CONFIGS = {
    "default": {},
    "all features": {"features": list(FEATURES), "vehicles_count": 7, "see_behind": True},
    "intentions": {"features": list(FEATURES), "observe_intentions": True, "absolute": True, "normalize": False},
    "unclipped": {"features": ["y", "x", "presence"], "clip": False, "vehicles_count": 3},
    "ranges": {"features_range": {"x": [-30, 50], "vx": [-9, 9], "heading": [-4, 4]}, "features": list(FEATURES)},
}
ENVIRONMENTS = pytest.mark.parametrize("env_class", [IntersectionLeftEnv, LaneChangeEnv])
OPTIONS = pytest.mark.parametrize("config", CONFIGS.values(), ids=CONFIGS)


def assert_alike(env_class, config, episodes):
    """Compare observations of the start, and of decisions of an ego that jumps anywhere."""
    env, rng = env_class({"observation": {"type": "Kinematics", **config}}), np.random.default_rng(0)
    n_compared = 0
    for seed in range(episodes):
        observation, _ = env.reset(seed=seed)
        theirs = KinematicObservation(env, **config)
        for _ in range(6):
            expected = theirs.observe()
            assert observation.dtype == expected.dtype
            assert np.allclose(observation, expected, atol=1e-5)
            n_compared += 1
            ego = env.vehicle
            ego.position = ego.position + rng.normal(0, (30, 30))
            ego.heading, ego.speed = rng.uniform(-4, 4), rng.uniform(-3, 15)
            ego.on_state_update()
            observation, _, terminated, truncated, _ = env.step(rng.uniform(-1, 1, 2))
            if terminated or truncated:
                break
    assert n_compared > 2 * episodes


@ENVIRONMENTS
@OPTIONS
def test_it_is_highway_envs(env_class, config):
    assert_alike(env_class, config, episodes=12)


@pytest.mark.slow
@ENVIRONMENTS
@OPTIONS
def test_it_is_highway_envs_in_many_scenes(env_class, config):
    assert_alike(env_class, config, episodes=300)


@pytest.mark.parametrize("order", ["sorted", "shuffled"])
def test_one_row_is_the_ego_s(order):
    env = LaneChangeEnv(config={"observation": {"type": "Kinematics", "vehicles_count": 1, "order": order}})
    observation, _ = env.reset(seed=1)
    assert env.observation_space.contains(observation)
    assert observation[0, 0] == 1
