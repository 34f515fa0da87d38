"""The engine drives as highway-env does: to the last bit where numpy computes as the C library does."""

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from behavexplor.envs.engine.frame_log import make_log
from behavexplor.envs.engine.state import make_scratch, make_slots
from behavexplor.envs.highway.conversion import load_state
from behavexplor.envs.observation_types import FEATURES
from tests.envs.highway.comparison import IDS, N_PLACES, N_STEPS, compare, compare_in_child, make, many, step, world_of

SHORT = {"highway-v0": {"decisions": 2}}  # its decisions take ten times as long in highway-env
VEHICLES = [f"highway_env.vehicle.behavior.{name}Vehicle" for name in ("IDM", "Linear", "Aggressive", "Defensive")]
ACTIONS = {
    "speeds": {"type": "DiscreteMetaAction", "target_speeds": [10, 15, 20, 25, 30, 35]},
    "longitudinal": {"type": "DiscreteMetaAction", "lateral": False},
    "lateral": {"type": "DiscreteMetaAction", "longitudinal": False},
    "discrete": {"type": "DiscreteAction", "actions_per_axis": 5, "steering_range": [-0.1, 0.1]},
    "continuous": {"type": "ContinuousAction"},
    "throttle": {"type": "ContinuousAction", "lateral": False, "speed_range": [0, 25], "acceleration_range": [-3, 8]},
    "wheel": {"type": "ContinuousAction", "longitudinal": False, "steering_range": [-0.1, 0.1], "clip": False},
}
META_ACTIONS = [name for name, action in ACTIONS.items() if action["type"] == "DiscreteMetaAction"]
KINEMATICS = {"observation": {"type": "Kinematics"}}  # TimeToCollision needs meta-actions
OTHERS = {
    **{name.rpartition(".")[2]: ("highway-fast-v0", {"other_vehicles_type": name}) for name in VEHICLES[1:]},
    "linear at the roundabout": ("roundabout-v1", {"other_vehicles_type": VEHICLES[1]}),
    "linear at the intersection": ("intersection-v0", {"other_vehicles_type": VEHICLES[1]}),
    **{name: ("highway-fast-v0", {"action": action}) for name, action in ACTIONS.items()},
    "discrete at the intersection": ("intersection-v2", {"action": ACTIONS["discrete"]}),
    "continuous in the U-turn": ("u-turn-v0", {"action": ACTIONS["continuous"], **KINEMATICS}),
    "two egos, one of them on its own": ("highway-fast-v0", {"controlled_vehicles": 2}),
}
ALL_OBSERVED = {
    "observation": {
        "type": "Kinematics", "features": list(FEATURES), "vehicles_count": 7, "see_behind": True,
        "observe_intentions": True,
    }
}  # fmt: skip
FEW_OBSERVED = {
    "observation": {
        "type": "Kinematics", "features": list(FEATURES), "vehicles_count": 4, "normalize": False, "absolute": True,
        "include_obstacles": False,
    }
}  # fmt: skip
TIMES_OBSERVED = {
    "observation": {"type": "TimeToCollision", "horizon": 7},
    "action": {"type": "DiscreteMetaAction", "target_speeds": [0, 10, 20, 30]},
}
CONNECTED = {"neighbour_vehicles_connected_lanes": True}
SCATTERED = [
    ("highway-fast-v0", {**ALL_OBSERVED, "vehicles_count": 14}),
    ("highway-fast-v0", {**FEW_OBSERVED, "vehicles_count": 14, "action": ACTIONS["continuous"]}),
    ("merge-v0", TIMES_OBSERVED),
    ("merge-v0", {**ALL_OBSERVED, **CONNECTED}),
    ("roundabout-v1", ALL_OBSERVED),
    ("roundabout-v1", {**TIMES_OBSERVED, **CONNECTED}),
    ("intersection-v0", TIMES_OBSERVED),
    ("intersection-v0", {**ALL_OBSERVED, "action": ACTIONS["continuous"]}),
    ("exit-v0", {"vehicles_count": 14}),
    ("two-way-v0", TIMES_OBSERVED),
    ("u-turn-v0", ALL_OBSERVED),
]


def assert_equal(result):
    assert not result.different
    assert set(result.worst.values()) == {0.0}, result.worst


@pytest.fixture(scope="module")
def results():
    calls = [{"env_id": name, "episodes": 1, "decisions": 7, **SHORT.get(name, {})} for name in IDS]
    calls += [{"env_id": name, "config": config, "episodes": 1, "decisions": 5} for name, config in OTHERS.values()]
    return dict(zip([*IDS, *OTHERS], compare_in_child(*calls), strict=True))


@pytest.mark.parametrize("name", [*IDS, *OTHERS])
def test_the_engine_drives_as_highway_env_to_the_last_bit(name, results):
    assert results[name].decisions > 0
    assert_equal(results[name])


def test_any_state_is_observed_and_goes_on_as_in_highway_env_to_the_last_bit():
    frames = {"simulation_frequency": 15, "policy_frequency": 5}
    calls = [{"env_id": name, "config": {**config, **frames}} for name, config in SCATTERED]
    results = compare_in_child(*({**call, "episodes": 10, "decisions": 1, "scattered": True} for call in calls))
    for result in results:
        assert_equal(result)
    assert sum(result.crashes for result in results) > 30


def test_something_happens_in_the_comparisons(results):
    assert sum(result.crashes for result in results.values()) >= 3
    assert sum(result.decisions for result in results.values()) >= 120


@pytest.mark.parametrize("env_id", ["highway-fast-v0", "merge-v1", "intersection-v0"])
def test_outcomes_are_the_same_with_numpy_s_own_trigonometry(env_id):
    result = compare(env_id, episodes=2)
    assert not result.different
    assert max(result.worst["x"], result.worst["y"]) < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("env_id", IDS)
def test_many_episodes_driven_to_the_last_bit(env_id):
    (result,) = compare_in_child({"env_id": env_id, "episodes": many(env_id, 200)})
    assert result.episodes == many(env_id, 200)
    assert_equal(result)


@pytest.mark.slow
@pytest.mark.parametrize("env_id", IDS)
def test_many_episodes_driven_with_the_same_outcomes(env_id):
    result = compare(env_id, episodes=many(env_id, 200))
    assert result.episodes == many(env_id, 200)
    assert not result.different


@st.composite
def configs(draw):
    env_id = draw(st.sampled_from([env_id for env_id in IDS if env_id != "highway-v0"]))
    policy_frequency = draw(st.sampled_from([1, 2, 3, 5]))
    config = {
        "other_vehicles_type": draw(st.sampled_from(VEHICLES)),
        "policy_frequency": policy_frequency,
        "simulation_frequency": policy_frequency * draw(st.integers(2, 5)),
        "neighbour_vehicles_connected_lanes": draw(st.booleans()),
    }
    needs_meta_actions = env_id.startswith(("merge", "roundabout", "two-way"))  # as highway-env's rewards are written
    config |= {"action": ACTIONS[draw(st.sampled_from(META_ACTIONS if needs_meta_actions else sorted(ACTIONS)))]}
    if config["action"]["type"] != "DiscreteMetaAction":
        config |= KINEMATICS
    if "highway" in env_id or "exit" in env_id:
        config |= {"lanes_count": draw(st.integers(2, 6)), "vehicles_count": draw(st.integers(1, 30))}
        config |= {"vehicles_density": draw(st.floats(0.5, 2.5))}
    return {"env_id": env_id, "config": config, "episodes": 1, "decisions": 12, "first_seed": draw(st.integers(0, 999))}


@pytest.mark.slow
@settings(max_examples=20, deadline=None, phases=[Phase.generate])  # an example takes seconds: none is simplified
@given(st.lists(configs(), min_size=10, max_size=10))
def test_any_configuration_to_the_last_bit(calls):
    for call, result in zip(calls, compare_in_child(*calls), strict=True):
        assert not result.different, (call, result)
        assert set(result.worst.values()) == {0.0}, (call, result)


def test_a_slot_does_not_depend_on_the_others():
    """Two slots with the same start, of which one is stepped alone and the other in company."""
    env = make("highway-fast-v0")
    world, scratch = world_of(env), make_scratch(3, N_PLACES)
    alone, many = make_slots(1, N_PLACES, N_STEPS), make_slots(4, N_PLACES, N_STEPS)
    for b in range(4):
        env.reset(seed=b)
        load_state(env, world, many, b)
    env.reset(seed=2)
    load_state(env, world, alone, 0)
    maneuvers = np.array([[3.0, 0.0], [0.0, 0.0], [2.0, 0.0], [4.0, 0.0]])
    for _ in range(5):
        step(world, alone, scratch, maneuvers[2:3], np.array([True]), make_log(1, 0, 0))
        step(world, many, scratch, maneuvers, np.array([True, True, True, False]), make_log(4, 0, 0))
    assert alone.vehicles[0].tolist() == many.vehicles[2].tolist()
    assert alone.episodes[0] == many.episodes[2]
    assert (many.episodes["frames"] == [25, 25, 25, 0]).all()
    assert alone.vehicles[0].tolist() != many.vehicles[1].tolist()
