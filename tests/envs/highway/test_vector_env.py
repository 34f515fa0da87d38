"""The compiled vector environments give what gymnasium's vector environments of the originals give, bit by bit."""

import copy
import os

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from highway_env.envs import HighwayEnvFast, IntersectionEnv, MergeEnv, ParkingEnv, TwoWayEnv
from highway_env.road.road import Road
from highway_env.vehicle.behavior import IDMVehicle
from hypothesis import given, settings
from hypothesis import strategies as st
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env

from behavexplor.envs import source_gate
from behavexplor.envs.highway import highway_vector_env as registered
from behavexplor.envs.highway.highway_vector_env import HighwayVectorEnv
from behavexplor.envs.observation_types import FEATURES
from behavexplor.envs.sb3_vec_env import HighwayVecEnv
from behavexplor.errors import InputError
from tests.envs.highway.comparison import many
from tests.envs.highway.environments import DoublyRewardedEnv, DriftingRoadEnv
from tests.envs.highway.side_by_side import IDS, assert_equal, compare, compare_in_child

MODES = ("NextStep", "SameStep")
SHORT = {"highway-v0": 3}  # decisions, which take ten times as long in highway-env
ENDLESS = ("merge-v0", "merge-v1", "merge-generic-v0", "merge-generic-v1", "two-way-v0")  # without a duration
CONFIGS = {
    "many lanes": ("highway-fast-v0", {"lanes_count": 5, "vehicles_count": 9, "vehicles_density": 2.5}),
    "one lane": ("highway-fast-v0", {"lanes_count": 1, "initial_lane_id": 0, "vehicles_count": 0}),
    "linear vehicles": (
        "highway-fast-v0",
        {"other_vehicles_type": "highway_env.vehicle.behavior.LinearVehicle", "vehicles_count": 5},
    ),
    "unnormalized": ("highway-fast-v0", {"normalize_reward": False, "offroad_terminal": True, "on_road_reward": 0.3}),
    "continuous": ("highway-fast-v0", {"action": {"type": "ContinuousAction"}, "vehicles_count": 5}),
    "discrete at the roundabout": ("roundabout-v0", {"action": {"type": "DiscreteAction"}}),
    "a long merge": ("merge-v1", {"policy_frequency": 5, "action": {"type": "DiscreteMetaAction", "lateral": False}}),
    "times on the highway": (
        "highway-fast-v0",
        {"observation": {"type": "TimeToCollision", "horizon": 7}, "policy_frequency": 2, "vehicles_count": 8},
    ),
    "times at the intersection": ("intersection-v2", {"observation": {"type": "TimeToCollision"}, "destination": None}),
    "aggressive at the intersection": (
        "intersection-v0",
        {"other_vehicles_type": "highway_env.vehicle.behavior.AggressiveVehicle", "spawn_probability": 1.0},
    ),
    "continuous at the intersection": (
        "intersection-v1",
        {"action": {"type": "ContinuousAction", "dynamical": False}, "normalize_reward": True},
    ),
    "own vehicles at the intersection": (
        "tests.envs.highway.environments:QuietIntersectionEnv",
        {"duration": 3, "spawn_probability": 1.0},
    ),
    "everything observed": (
        "merge-v0",
        {"observation": {"type": "Kinematics", "features": list(FEATURES), "vehicles_count": 8, "see_behind": True}},
    ),
    "shuffled": (
        "roundabout-v1",
        {"observation": {"type": "Kinematics", "order": "shuffled", "features": list(FEATURES), "normalize": False}},
    ),
    "shuffled at the exit": ("exit-v1", {"observation": {"type": "ExitObservation", "order": "shuffled"}}),
    "intentions": (
        "intersection-v0",
        {
            "observation": {
                "type": "Kinematics",
                "features": ["cos_d", "sin_d", "heading", "x"],
                "observe_intentions": True,
                "features_range": {"heading": [-1, 1], "x": [-50, 50]},
                "clip": False,
            }
        },
    ),
}


def is_apart(env_id):
    """Return whether an environment needs a process of its own, because it changes a class of highway-env."""
    return "ntersection" in env_id


@pytest.fixture(scope="module")
def results():
    calls = {
        (env_id, mode): {
            "env_id": env_id,
            "mode": mode,
            "decisions": SHORT.get(env_id, 5),
            "config": {} if env_id in ENDLESS else {"duration": 2},
        }
        for env_id in IDS
        for mode in MODES
    }
    calls |= {
        name: {"env_id": env_id, "config": config, "decisions": 4, "num_envs": 1, "seed": 5}
        for name, (env_id, config) in CONFIGS.items()
    }
    found = {}
    for apart in (False, True):
        group = {name: call for name, call in calls.items() if is_apart(call["env_id"]) == apart}
        found |= dict(zip(group, compare_in_child(*group.values()), strict=True))
    return found


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("env_id", IDS)
def test_observations_rewards_ends_and_infos_are_equal_to_the_last_bit(env_id, mode, results):
    assert_equal(results[env_id, mode])


@pytest.mark.parametrize("name", CONFIGS)
def test_configurations_are_reproduced_to_the_last_bit(name, results):
    assert_equal(results[name])


def test_episodes_end_and_begin_again_in_the_comparisons(results):
    assert sum(result.episodes for result in results.values()) >= 2 * len(IDS)


@st.composite
def configs(draw):
    """Draw configurations of the highway."""
    lanes = draw(st.integers(1, 4))
    features = draw(st.lists(st.sampled_from(FEATURES), min_size=1, unique=True))
    observation = {
        "type": "Kinematics",
        "features": features,
        "vehicles_count": draw(st.integers(2, 9)),
        "order": draw(st.sampled_from(["sorted", "shuffled"])),
        **{name: draw(st.booleans()) for name in ("absolute", "normalize", "clip", "see_behind", "observe_intentions")},
    }
    return {
        "observation": observation,
        "action": {
            "type": "DiscreteMetaAction",
            "target_speeds": draw(st.sampled_from([[20, 25, 30], [0, 10], [15, 20, 25, 30, 35]])),
            "lateral": draw(st.booleans()),
        },
        "lanes_count": lanes,
        "initial_lane_id": draw(st.none() | st.integers(0, lanes - 1)),
        "vehicles_count": draw(st.integers(0, 6)),
        "vehicles_density": draw(st.floats(0.5, 3.0)),
        "ego_spacing": draw(st.floats(0.5, 3.0)),
        "simulation_frequency": draw(st.integers(2, 6)),
        "policy_frequency": draw(st.sampled_from([0.5, 1, 2])),
        "duration": draw(st.integers(1, 5)),
        "reward_speed_range": sorted(draw(st.tuples(st.integers(0, 20), st.integers(21, 40)))),
        "collision_reward": draw(st.floats(-3, -1)),
        "right_lane_reward": draw(st.floats(0, 1)),
        "normalize_reward": draw(st.booleans()),
        "offroad_terminal": draw(st.booleans()),
        "neighbour_vehicles_connected_lanes": draw(st.booleans()),
    }


@settings(max_examples=25)
@given(configs(), st.integers(0, 2**31), st.sampled_from(MODES))
def test_drawn_configurations_have_the_same_outcomes(config, seed, mode):
    result = compare("highway-fast-v0", config, mode=mode, num_envs=1, decisions=3, seed=seed)
    assert not result.different or set(result.different) <= {"speed", "rewards.high_speed_reward"}  # in the last bits
    assert result.worst < 1e-5


def test_making_an_intersection_leaves_the_class_of_its_vehicles_alone():
    before = IDMVehicle.DISTANCE_WANTED, IDMVehicle.COMFORT_ACC_MAX, IDMVehicle.COMFORT_ACC_MIN
    env = HighwayVectorEnv(IntersectionEnv, 2)
    env.reset(seed=0)
    assert before == (IDMVehicle.DISTANCE_WANTED, IDMVehicle.COMFORT_ACC_MAX, IDMVehicle.COMFORT_ACC_MIN)


def test_an_environment_may_make_its_own_vehicles():
    result = compare(
        "tests.envs.highway.environments:CrowdedEnv", {"most_others": 4, "duration": 2}, mode="SameStep", decisions=6
    )
    assert not result.different
    assert result.worst < 1e-9
    assert result.episodes >= 2


@pytest.mark.parametrize(
    ("env_class", "message"),
    [
        (DoublyRewardedEnv, "does not know the method DoublyRewardedEnv._reward"),
        (ParkingEnv, "does not know ParkingEnv; it knows ExitEnv, HighwayEnv"),
    ],
)
def test_environments_with_other_rules_are_refused(env_class, message):
    with pytest.raises(InputError, match=message):
        HighwayVectorEnv(env_class)


def test_a_road_that_changes_is_refused():
    with pytest.raises(InputError, match="The road of DriftingRoadEnv changes"):
        HighwayVectorEnv(DriftingRoadEnv).reset(seed=0)


def test_gymnasium_makes_the_compiled_environment_and_the_original():
    made = gymnasium.make_vec(
        "behavexplor/two-way-v0", num_envs=3, vectorization_mode="vector_entry_point", autoreset_mode="SameStep"
    )
    assert isinstance(made, HighwayVectorEnv)
    made.reset(seed=1)
    ends = [made.step(np.ones(3, dtype=np.int64))[2:4] for _ in range(15)]
    assert all(bool(truncated.all() or terminated.any()) for terminated, truncated in ends[-1:])
    assert isinstance(gymnasium.make("behavexplor/merge-v1").unwrapped, MergeEnv)
    refused = pytest.raises(InputError, match=r"action.dynamical: .*vectorization_mode='sync'")
    with pytest.warns(DeprecationWarning, match="out of date"), refused:
        gymnasium.make_vec("behavexplor/intersection-v1", vectorization_mode="vector_entry_point")


def test_another_release_of_highway_env_runs_itself_and_says_so(monkeypatch):
    digests = copy.deepcopy(source_gate.ported_sources())
    digests["highway_env.vehicle.behavior"]["IDMVehicle"]["act"] = "0" * 16
    digests["highway_env.road.road"]["Road"]["gone"] = "0" * 16
    monkeypatch.setattr(source_gate, "ported_sources", lambda: digests)
    monkeypatch.setattr(source_gate, "_guards", {})
    with pytest.warns(UserWarning, match=r"highway-env itself runs, .* another Road.gone, IDMVehicle.act than"):
        env = registered.vector_env(TwoWayEnv, num_envs=2, autoreset_mode="SameStep", max_episode_steps=3)
    assert isinstance(env, SyncVectorEnv)
    assert env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    env.reset(seed=0)
    assert [bool((step := env.step(np.ones(2, dtype=np.int64)))[2].any() or step[3].all()) for _ in range(3)][-1]


@pytest.mark.parametrize(
    ("name", "value"), [("n_vehicles", 10**6), ("n_obstacles", 10**6), ("n_obstacles", -3), ("ego", -1), ("ego", 4)]
)
def test_a_decision_beyond_the_room_of_a_slot_is_refused(name, value):
    env = HighwayVectorEnv(HighwayEnvFast, 2, {"vehicles_count": 3})
    env.reset(seed=0)
    env._slots.episodes[name][1] = value
    before = copy.deepcopy(env._slots)
    with pytest.raises(InputError, match="more vehicles than the 4 that have room"):
        env.step(np.ones(2, dtype=np.int64))
    assert all(np.array_equal(*pair) for pair in zip(before, env._slots, strict=True))


@pytest.mark.parametrize("name", ["n_at_start", "n_others"])
def test_a_start_beyond_the_room_of_a_slot_is_refused(name):
    env = HighwayVectorEnv(HighwayEnvFast, 2, {"vehicles_count": 3})
    env._engine.task.rules[name] = 10**6
    with pytest.raises(InputError, match="have room"):
        env.reset(seed=0)


def test_a_vehicle_with_target_speeds_of_its_own_is_refused():
    env = HighwayVectorEnv(HighwayEnvFast, 1, {"vehicles_count": 3})
    start = HighwayEnvFast({"vehicles_count": 3})
    start.vehicle.target_speeds = np.linspace(0, 90, 30)
    with pytest.raises(InputError, match="A vehicle has the target speeds"):
        env.reset(options={"starts": {0: start}})


def test_a_vehicle_with_a_parameter_of_its_own_that_is_not_read_is_refused():
    env = HighwayVectorEnv(HighwayEnvFast, 1, {"vehicles_count": 3})
    start = HighwayEnvFast({"vehicles_count": 3})
    start.road.vehicles[1].KP_HEADING = 3.0
    with pytest.raises(InputError, match="a KP_HEADING of its own"):
        env.reset(options={"starts": {0: start}})


class Dense(IDMVehicle):
    DELTA_RANGE = (1.0, 1.5)


class Blind(Road):
    def neighbour_vehicles(self, vehicle, lane_index=None):
        return None, None


class BlindEnv(HighwayEnvFast):
    def _create_vehicles(self):
        super()._create_vehicles()
        self.road.__class__ = Blind


def test_the_range_of_an_exponent_is_that_of_the_class():
    config = {"other_vehicles_type": f"{__name__}.Dense", "duration": 6, "vehicles_count": 8}
    result = compare("highway-fast-v0", config, decisions=12)
    assert not result.different
    assert result.worst < 1e-6


def test_a_road_that_behaves_differently_is_refused_by_name():
    with pytest.raises(InputError, match=r"Blind.neighbour_vehicles; .*vectorization_mode='sync'"):
        HighwayVectorEnv(BlindEnv)


def test_a_sub_environment_rests_after_its_episode_without_autoreset():
    env = HighwayVectorEnv(HighwayEnvFast, 3, {"duration": 2, "vehicles_count": 2}, autoreset_mode="Disabled")
    env.reset(seed=[4, 5, None])
    env.step(np.ones(3, dtype=np.int64))
    last, _, _, truncated, _ = env.step(np.ones(3, dtype=np.int64))
    assert truncated.all()
    mask = np.array([False, True, False])
    fresh, infos = env.reset(options={"reset_mask": mask})
    assert (fresh[~mask] == last[~mask]).all()
    assert (fresh[mask] != last[mask]).any()
    assert infos["_speed"].tolist() == mask.tolist()
    rested, rewards, _, truncated, infos = env.step(np.ones(3, dtype=np.int64))
    assert (rested[~mask] == last[~mask]).all()
    assert rewards[~mask].tolist() == [0.0, 0.0]
    assert truncated.tolist() == [True, False, True]
    assert infos["_speed"].tolist() == mask.tolist()


def test_wrong_use_is_refused():
    env = HighwayVectorEnv(HighwayEnvFast, 2, {"vehicles_count": 2})
    with pytest.raises(ResetNeeded):
        env.step(np.ones(2, dtype=np.int64))
    with pytest.raises(InputError, match="Unknown reset option 'config'"):
        env.reset(options={"config": {}})
    env.reset()
    with pytest.raises(InputError, match="actions: expected"):
        env.step(np.full(2, 5))
    with pytest.raises(InputError, match="cannot render"):
        HighwayVectorEnv(HighwayEnvFast, render_mode="rgb_array")
    with pytest.raises(InputError, match="num_envs: expected"):
        HighwayVectorEnv(HighwayEnvFast, 0)


@pytest.mark.parametrize(
    "actions",
    [
        np.array([1, 5]),
        np.array([1, -1]),
        np.array([1, 2**63], dtype=np.uint64),
        np.array([1.0, 1.0]),
        np.array([True, True]),
        np.ones(3, dtype=np.int64),
        np.ones((2, 1), dtype=np.int64),
    ],
)
def test_refused_actions_change_nothing(actions):
    env = HighwayVectorEnv(HighwayEnvFast, 2, {"vehicles_count": 2}, max_episode_steps=1, autoreset_mode="Disabled")
    env.reset(seed=0)
    before = env.state(0)
    with pytest.raises(InputError, match="actions: expected"):
        env.step(actions)
    assert all((one == other).all() for one, other in zip(before, env.state(0), strict=True))
    assert env.step(np.ones(2, dtype=np.int8))[3].all()


@pytest.mark.parametrize("mode", MODES)
def test_later_steps_leave_earlier_results_alone(mode):
    env = HighwayVectorEnv(IntersectionEnv, 2, {"duration": 2}, autoreset_mode=mode)
    env.reset(seed=0)
    actions = np.array([0, 2], dtype=np.int8)
    shown = [env.step(actions) for _ in range(4)]
    kept = copy.deepcopy(shown)
    actions[:] = 1
    env.step(actions)
    env.reset()
    for now, before in zip(shown, kept, strict=True):
        assert all((one == other).all() for one, other in zip(now[:4], before[:4], strict=True))
        assert now[4]["action"].dtype == np.int8
        assert repr(now[4]) == repr(before[4])


EPISODES = int(os.environ.get("EPISODES", "200"))  # of the slow comparison, by environment


@pytest.mark.slow
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("env_id", IDS)
def test_many_episodes_are_equal_to_the_last_bit(env_id, mode):
    episodes = many(env_id, EPISODES // 2)
    (result,) = compare_in_child(
        {"env_id": env_id, "mode": mode, "num_envs": 4, "decisions": 10**9, "episodes": episodes}
    )
    assert_equal(result)
    assert result.episodes >= episodes


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*out of date")
@pytest.mark.parametrize("env_id", IDS)
def test_episodes_of_a_trained_policy_are_equal_to_the_last_bit(env_id, tmp_path):
    torch.set_num_threads(1)
    env = make_vec_env(env_id, n_envs=16, seed=0, vec_env_cls=HighwayVecEnv)
    model = PPO("MlpPolicy", env, n_steps=64, batch_size=256, n_epochs=4, seed=0, device="cpu").learn(20_000)
    model.save(tmp_path / "policy.zip")
    episodes = many(env_id, EPISODES // 4)
    (result,) = compare_in_child(
        {"env_id": env_id, "num_envs": 4, "decisions": 10**9, "episodes": episodes}
        | {"policy": str(tmp_path / "policy.zip")}
    )
    assert_equal(result)
    assert result.episodes >= episodes
