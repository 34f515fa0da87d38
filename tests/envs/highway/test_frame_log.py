"""The log of the frames has what highway-env's vehicles do, frame by frame."""

import numpy as np
import pytest
from highway_env.envs import HighwayEnvFast, IntersectionEnv

from behavexplor.envs.engine.frame_log import make_log
from behavexplor.envs.engine.state import make_scratch, make_slots
from behavexplor.envs.highway.conversion import load_state
from behavexplor.envs.highway.highway_vector_env import HighwayVectorEnv
from behavexplor.errors import InputError
from tests.envs.highway.comparison import N_PLACES, N_STEPS, make, step, world_of
from tests.envs.highway.frame_by_frame import compare_in_child

CALLS = {
    "highway-fast-v0": {"decisions": 8, "seed": 3},
    "merge-v0": {"decisions": 12},
    "roundabout-v0": {"decisions": 8},
    "intersection-v0": {"decisions": 13, "seed": 2, "config": {"spawn_probability": 1.0}},
}


@pytest.fixture(scope="module")
def results():
    calls = [{"env_id": env_id, **call} for env_id, call in CALLS.items()]
    return dict(zip(CALLS, compare_in_child(*calls), strict=True))


@pytest.mark.parametrize("env_id", CALLS)
def test_every_frame_is_highway_env_s_to_the_last_bit(env_id, results):
    assert not results[env_id].different
    assert results[env_id].worst == 0.0
    assert results[env_id].frames >= 5 * results[env_id].decisions > 0


def test_obstacles_and_new_vehicles_are_logged(results):
    assert results["merge-v0"].obstacles == results["merge-v0"].frames
    assert results["intersection-v0"].numbers > results["roundabout-v0"].numbers == 5


def test_only_the_slots_that_take_an_action_are_logged():
    env = HighwayVectorEnv(
        HighwayEnvFast, 2, {"duration": 2, "vehicles_count": 3}, max_episode_steps=2, log_frames=True
    )
    env.reset(seed=0)
    env.step(np.ones(2, dtype=np.int64))
    assert env.frame_log.frames["n_things"].tolist() == [[4] * 5] * 2
    first = env.frame_log.things["x"].copy()
    env.step(np.ones(2, dtype=np.int64))
    assert (env.frame_log.things["x"][:, 0, 0] > first[:, -1, 0]).all()
    env.step(np.ones(2, dtype=np.int64))  # begins the next episodes
    assert not env.frame_log.frames["n_things"].any()


@pytest.mark.parametrize("env_class", [IntersectionEnv, HighwayEnvFast])
def test_the_log_of_egos_alone_is_that_of_the_egos(env_class):
    both = [HighwayVectorEnv(env_class, 3, log_frames=True) for _ in range(2)]
    both[1].log_egos(alone=True)
    for env in both:
        env.reset(seed=0)
        env.step(np.ones(3, dtype=np.int64))
    (frames, things), (egos_frames, egos) = (env.frame_log for env in both)
    assert (egos_frames["n_things"] == 1).all()
    assert np.array_equal(frames["is_on_road"], egos_frames["is_on_road"])
    own = np.take_along_axis(things, frames["ego"][..., None], axis=2)
    assert np.array_equal(own, egos)
    both[1].log_egos(alone=False)
    both[1].reset(seed=0)
    both[1].step(np.ones(3, dtype=np.int64))
    assert np.array_equal(both[1].frame_log.frames, frames)


def test_a_reset_logs_the_start_and_not_what_happened_before_it():
    env = HighwayVectorEnv(IntersectionEnv, 1, log_frames=True)
    env.reset(seed=0)
    frames, things = env.frame_log
    assert (frames["n_things"][0, 1:] == 0).all()
    count, ego, is_on_road = frames[0, 0].tolist()
    start = env.state(0)
    assert (count, ego, is_on_road) == (len(start.vehicles), start.episode["ego"], True)
    assert (things["lane"][0, 0, :count] == start.vehicles["lane"]).all()
    assert (things["target_lane"][0, 0, :count] == start.vehicles["target_lane"]).all()
    assert (things["x"][0, 0, :count] == start.vehicles["x"]).all()


def test_nothing_is_logged_beyond_the_log():
    env = make("highway-fast-v0")
    env.reset(seed=0)
    world, slots, log = world_of(env), make_slots(1, N_PLACES, N_STEPS), make_log(1, 3, N_PLACES)
    load_state(env, world, slots, 0)
    shorter = log._replace(frames=log.frames[:, :2], things=log.things[:, :2])
    step(world, slots, make_scratch(3, N_PLACES), np.zeros((1, 2)), np.array([True]), shorter)
    assert slots.episodes["frames"] == 5
    assert (log.frames["n_things"] > 0).tolist() == [[True, True, False]]
    assert not log.things[:, 2]["x"].any()


@pytest.mark.parametrize("aside", [1.95, 2.0, 2.05])
def test_the_edge_of_the_road_is_highway_env_s(aside):
    config = {"vehicles_count": 3}
    env, start = HighwayVectorEnv(HighwayEnvFast, 1, config, log_frames=True), HighwayEnvFast(config)
    start.reset(seed=0)
    start.vehicle.position = np.array([300.0, -aside])  # beside the first lane
    start.vehicle.on_state_update()
    env.reset(options={"starts": {0: start}})
    assert env.frame_log.frames["is_on_road"][0, 0] == start.vehicle.on_road == (aside <= 2.0)


def test_without_asking_there_is_no_log():
    env = HighwayVectorEnv(HighwayEnvFast, 2, {"vehicles_count": 3})
    env.reset(seed=0)
    env.step(np.ones(2, dtype=np.int64))
    assert env.frame_log.frames.size == env.frame_log.things.size == 0
    with pytest.raises(InputError, match="log_frames: expected True or False"):
        HighwayVectorEnv(HighwayEnvFast, 1, log_frames="yes")
