"""The Kinematics observation: bit for bit highway-env's own."""

import numpy as np
import pytest
from highway_env.envs.common.observation import KinematicObservation
from highway_env.vehicle.objects import Landmark, Obstacle

from behavexplor.envs.functional import IntersectionLeftEnv, LaneChangeEnv
from behavexplor.envs.observation_types import FEATURES, Kinematics

CONFIGS = {
    "default": {},
    "all features": {"features": list(FEATURES), "vehicles_count": 7, "see_behind": True},
    "intentions": {"features": list(FEATURES), "observe_intentions": True, "absolute": True, "normalize": False},
    "unclipped": {"features": ["y", "x", "presence"], "clip": False, "vehicles_count": 3},
    "ranges": {"features_range": {"x": [-30, 50], "vx": [-9, 9], "heading": [-4, 4]}, "features": list(FEATURES)},
    "shuffled": {"order": "shuffled", "see_behind": True, "vehicles_count": 6},
}


def scenes(env, count):
    """The env in random states: random scenarios, the ego anywhere."""
    rng = np.random.default_rng(0)
    env.reset(seed=0)
    for _ in range(count):
        env.reset()
        for _ in range(rng.integers(3)):
            env.step(rng.uniform(-1, 1, 2))
        ego = env.vehicle
        ego.position = ego.position + rng.normal(0, (30, 30))
        ego.heading, ego.speed = rng.uniform(-4, 4), rng.uniform(-3, 15)
        ego.on_state_update()
        yield env


def both(env, **config):
    observations = []
    for kind in (KinematicObservation, Kinematics):
        generator = env.np_random.bit_generator.state
        observations.append(kind(env, **config).observe())
        env.np_random.bit_generator.state = generator
    return observations


@pytest.mark.parametrize("env_class", [IntersectionLeftEnv, LaneChangeEnv])
@pytest.mark.parametrize("config", CONFIGS.values(), ids=CONFIGS)
def test_it_is_highway_envs(env_class, config):
    for env in scenes(env_class(), 12):
        expected, observation = both(env, **config)
        assert observation.dtype == expected.dtype
        assert np.array_equal(observation, expected)


@pytest.mark.slow
@pytest.mark.parametrize("env_class", [IntersectionLeftEnv, LaneChangeEnv])
@pytest.mark.parametrize("config", CONFIGS.values(), ids=CONFIGS)
def test_it_is_highway_envs_in_many_scenes(env_class, config):
    for env in scenes(env_class(), 500):
        assert np.array_equal(*both(env, **config))


@pytest.mark.parametrize("include_obstacles", [True, False])
def test_obstacles(include_obstacles):
    for env in scenes(LaneChangeEnv(), 12):
        x, y = env.vehicle.position
        env.road.objects = [Obstacle(env.road, [x + 5, y]), Landmark(env.road, [x - 4, y + 3])]
        config = {"features": list(FEATURES), "vehicles_count": 8, "include_obstacles": include_obstacles}
        expected, observation = both(env, **config)
        assert np.isnan(observation).any() == include_obstacles
        assert np.array_equal(observation, expected, equal_nan=True)


def test_default_ranges_are_those_of_the_first_observation():
    env = LaneChangeEnv()
    env.reset(seed=1)
    theirs, ours = KinematicObservation(env), Kinematics(env)
    theirs.observe(), ours.observe()
    env.vehicle.position = np.array([50.0, -2.0])  # two lanes there, not four
    env.vehicle.heading = np.pi
    env.vehicle.on_state_update()
    assert np.array_equal(theirs.observe(), ours.observe())


def test_one_row_is_the_ego_s():
    env = LaneChangeEnv(config={"observation": {"type": "Kinematics", "vehicles_count": 1}})
    observation, _ = env.reset(seed=1)
    assert env.observation_space.contains(observation)
