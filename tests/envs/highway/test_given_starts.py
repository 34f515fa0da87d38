"""Episodes begin as environments of highway-env that are handed over, and go on with given draws."""

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from highway_env.envs import HighwayEnvFast, IntersectionEnv, RoundaboutEnv

from behavexplor.envs.highway.highway_vector_env import HighwayVectorEnv
from behavexplor.errors import InputError
from tests.envs.highway.environments import CrowdedEnv
from tests.envs.highway.frame_by_frame import compare_in_child


def draws(count, seed):
    """Draw rows, of which most let a vehicle appear."""
    rng = np.random.default_rng(seed)
    choices = [rng.choice(4, size=2, replace=False) for _ in range(count)]
    return [[rng.random() * 0.7, *map(int, pair), *rng.normal(size=2), rng.random()] for pair in choices]


CALLS = {
    "highway-fast-v0": {"decisions": 6},
    "merge-v1": {"decisions": 6},
    "roundabout-v0": {"decisions": 6},
    "exit-v0": {"decisions": 4, "config": {"observation": {"type": "ExitObservation"}}},
    "intersection-v0": {"decisions": 10, "seed": 2},  # after the start, it draws as the environment's generator
    "some draws": {"env_id": "intersection-v2", "decisions": 12, "draws": draws(6, 0)},
    "all draws": {"env_id": "intersection-v0", "decisions": 13, "seed": 7, "draws": draws(13, 1)},
}


@pytest.fixture(scope="module")
def results():
    calls = [{"env_id": name, "is_given": True, **call} for name, call in CALLS.items()]
    return dict(zip(CALLS, compare_in_child(*calls), strict=True))


@pytest.mark.parametrize("name", CALLS)
def test_a_given_start_goes_on_as_highway_env_to_the_last_bit(name, results):
    assert not results[name].different
    assert results[name].worst == 0.0
    assert results[name].decisions > 2


def test_vehicles_appear_in_the_comparisons(results):
    assert results["all draws"].decisions == 13
    assert results["all draws"].numbers > results["roundabout-v0"].numbers


def test_slots_without_a_start_begin_as_ever():
    config = {"vehicles_count": 4}
    env, plain = HighwayVectorEnv(HighwayEnvFast, 3, config), HighwayVectorEnv(HighwayEnvFast, 3, config)
    given = HighwayEnvFast(config)
    expected, _ = given.reset(seed=9)
    mask = np.array([True, True, False])
    plain.reset(seed=5)
    env.reset(seed=5)
    shown, _ = env.reset(seed=5, options={"starts": {1: given}, "reset_mask": mask})
    assert (shown[[0, 2]] == plain.reset(seed=5)[0][[0, 2]]).all()
    np.testing.assert_allclose(shown[1], expected, atol=1e-6)


@pytest.mark.parametrize("see_behind", [False, True])
def test_the_edges_of_what_is_observed_are_highway_env_s(see_behind):
    """At the greatest distance, two lengths behind, and as far ahead as behind."""
    gaps = [200.0, -200.0, 199.5, -10.0, -9.5, 5.0, -5.0]
    config = {"vehicles_count": len(gaps), "observation": {"type": "Kinematics", "vehicles_count": 8}}
    config["observation"] |= {"see_behind": see_behind, "normalize": False}
    env, given = HighwayVectorEnv(HighwayEnvFast, 1, config), HighwayEnvFast(config)
    for gap, vehicle in zip([0.0, *gaps], given.road.vehicles, strict=True):
        vehicle.position, vehicle.heading = np.array([400.0 + gap, 4.0]), 0.0
        vehicle.on_state_update()
    shown, _ = env.reset(options={"starts": {0: given}})
    np.testing.assert_allclose(shown[0], given.observation_type.observe(), atol=1e-6)
    assert np.count_nonzero(shown[0, :, 0]) == (6 if see_behind else 5)


def test_times_to_collision_of_nothing_are_highway_env_s():
    """The centers of two vehicles, and the ends of others, are side by side."""
    config = {"vehicles_count": 3, "observation": {"type": "TimeToCollision"}}
    env, given = HighwayVectorEnv(HighwayEnvFast, 1, config), HighwayEnvFast(config)
    for vehicle, *position in zip(given.road.vehicles, [400.0, 400.0, 405.0, 395.0], [4.0, 0.0, 8.0, 8.0], strict=True):
        vehicle.position, vehicle.heading, vehicle.speed = np.array(position), 0.0, 25.0
        vehicle.on_state_update()
    shown, _ = env.reset(options={"starts": {0: given}})
    assert np.array_equal(shown[0], given.observation_type.observe())
    assert shown[0, :, :, 0].any()


def test_given_draws_end_with_the_episode():
    challenger, place_of_ego = [0.5, 0.1, 0.1, 0.0, 0.0, 0.5], [0.0]
    never = [0.99, 0.1, 0.1, 0.0, 0.0, 0.0]  # above the probability
    draws = [*challenger, *place_of_ego, *never, *never, *never]
    config = {"initial_vehicle_count": 1, "spawn_probability": 0.9, "duration": 2}
    env = HighwayVectorEnv(IntersectionEnv, 1, config, autoreset_mode=AutoresetMode.SAME_STEP, log_frames=True)
    env.reset(seed=0, options={"draws": {0: draws}})
    counts = []
    for _ in range(8):
        env.step(np.ones(1, dtype=np.int64))
        counts.append(int(env.frame_log.frames[0, -1].n_things))
    assert counts[:2] == [counts[0]] * 2
    assert max(counts) > counts[0]


def test_a_shuffled_observation_of_an_own_start_has_highway_env_s_order():
    config = {"observation": {"type": "Kinematics", "order": "shuffled"}}
    env, own = HighwayVectorEnv(CrowdedEnv, 1, config), CrowdedEnv(config)
    for seed in range(3):
        np.testing.assert_allclose(env.reset(seed=seed)[0][0], own.reset(seed=seed)[0], atol=1e-6)
        np.testing.assert_allclose(env.step(np.ones(1, dtype=np.int64))[0][0], own.step(1)[0], atol=1e-6)


@pytest.mark.parametrize(
    ("env_class", "options", "message"),
    [
        (HighwayEnvFast, {"starts": [1]}, "starts: expected a value for each slot"),
        (HighwayEnvFast, {"starts": {2: None}}, "starts: 2 is not a slot that is reset"),
        (HighwayEnvFast, {"starts": {0: None}}, "starts: expected HighwayEnvFast that have been reset, unwrapped"),
        (HighwayEnvFast, {"starts": {0: RoundaboutEnv()}}, "starts: expected HighwayEnvFast that have been reset"),
        (HighwayEnvFast, {"starts": {0: HighwayEnvFast({"duration": 5})}}, "starts: duration is 5, but must be 30"),
        (HighwayEnvFast, {"starts": {0: HighwayEnvFast({"vehicles_count": 40})}}, "41 vehicles .* room for 21"),
        (HighwayEnvFast, {"draws": {0: [[0.5]]}}, r"draws: expected finite numbers of shape \(n,\)"),
        (IntersectionEnv, {"draws": {0: [0.5, np.inf]}}, "draws: expected finite numbers"),
        (IntersectionEnv, {"draws": {0: ["a"]}}, "draws: expected finite numbers"),
        (IntersectionEnv, {"draws": {3: [0.5]}}, "draws: 3 is not a slot that is reset"),
    ],
)
def test_what_cannot_be_a_start_is_refused(env_class, options, message):
    with pytest.raises(InputError, match=message):
        HighwayVectorEnv(env_class, 2).reset(options=options)
