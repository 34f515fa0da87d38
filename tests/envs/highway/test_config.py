"""Every key of highway-env's configurations is reproduced, changes pictures only, or is refused by name."""

import inspect

import pytest
from gymnasium.envs.registration import load_env_creator
from highway_env.envs import HighwayEnv

import behavexplor
from behavexplor.envs.env_config import ACTIONS
from behavexplor.envs.highway.config_check import DRAWING, OBSERVATIONS, ONLY, known_class
from behavexplor.envs.highway.highway_vector_env import HighwayVectorEnv
from behavexplor.envs.tasks.highway_tasks import KINDS, NUMBERS
from behavexplor.errors import InputError
from tests.envs.highway.side_by_side import assert_equal, compare_in_child

IDS = ("highway-fast-v0", "merge-v0", "roundabout-v0", "u-turn-v0", "two-way-v0", "exit-v0", "intersection-v0")
BASE = {  # to save time, and to see small differences
    "highway-fast-v0": {"vehicles_count": 8},
    "exit-v0": {"vehicles_count": 8},
    "two-way-v0": {"observation": {"type": "Kinematics"}},
}
DECISIONS = {
    "merge-v0": 8,
    "roundabout-v0": 4,
    "u-turn-v0": 3,
    "two-way-v0": 6,
    "exit-v0": 5,
    "intersection-v0": 7,
}  # until every key has had its effect
SEEDS = {"exit-v0": 6}  # with an early change of lane
CHANGES = {
    "observation": {"type": "Kinematics", "vehicles_count": 3},
    "action": {"type": "DiscreteMetaAction", "target_speeds": [5, 12, 19]},
    "simulation_frequency": 10,
    "policy_frequency": 2,
    "other_vehicles_type": "highway_env.vehicle.behavior.LinearVehicle",
    "neighbour_vehicles_connected_lanes": True,
    "lanes_count": 2,
    "vehicles_count": 4,
    "initial_lane_id": 1,
    "duration": 1,
    "ego_spacing": 0.7,
    "vehicles_density": 2.0,
    "reward_speed_range": [3, 50],
    "normalize_reward": None,  # the opposite
    "offroad_terminal": True,
    "incoming_vehicle_destination": 2,
    "destination": "o3",
    "initial_vehicle_count": 3,
    "spawn_probability": 0.0,
    "screen_width": 100,
    "screen_height": 100,
    "centering_position": [0.1, 0.1],
    "scaling": 2.0,
    "show_trajectories": True,
    "render_agent": False,
    "offscreen_rendering": True,
    "real_time_rendering": True,
}
NO_EFFECT_HERE = {  # on these few decisions
    ("merge-v0", "neighbour_vehicles_connected_lanes"),
    ("two-way-v0", "neighbour_vehicles_connected_lanes"),
    ("highway-fast-v0", "neighbour_vehicles_connected_lanes"),
    ("exit-v0", "neighbour_vehicles_connected_lanes"),
    *((env_id, "collision_reward") for env_id in IDS),  # it needs a crash
    *((env_id, "offroad_terminal") for env_id in IDS),  # it needs an ego off the road
    *((env_id, "arrived_reward") for env_id in IDS),
    ("exit-v0", "goal_reward"),
    ("exit-v0", "normalize_reward"),  # from [0, 1] to [0, 1]
}


def default(env_id):
    return load_env_creator(behavexplor.HIGHWAY_ENV[env_id]).default_config()


def changed(env_id, key):
    value = CHANGES.get(key, 0.37)  # of weights
    return not default(env_id)[key] if value is None else value


def kind(env_id):
    return KINDS[NUMBERS[known_class(load_env_creator(behavexplor.HIGHWAY_ENV[env_id]))]]


QUICK = "merge-v0"  # its episodes are the shortest; the others take half a minute each


@pytest.mark.parametrize("env_id", [pytest.param(one, marks=() if one == QUICK else pytest.mark.slow) for one in IDS])
def test_every_key_of_the_default_configuration_is_accounted_for(env_id):
    keys = [key for key in default(env_id) if key not in ONLY]
    call = {"env_id": env_id, "num_envs": 1, "decisions": DECISIONS.get(env_id, 2), "seed": SEEDS.get(env_id, 0)}
    base = BASE.get(env_id, {})
    calls = [{**call, "config": {**base, key: changed(env_id, key)}} for key in keys]
    plain, *results = compare_in_child({**call, "config": base}, *calls)
    without_effect = DRAWING | kind(env_id).unread
    for key, result in zip(keys, results, strict=True):
        assert_equal(result)
        if (env_id, key) not in NO_EFFECT_HERE:
            assert (result.digest == plain.digest) == (key in without_effect), key


KINEMATICS = {
    "features": ["vx", "x", "sin_h"],
    "vehicles_count": 3,
    "features_range": {"x": [-30, 30], "vx": [0, 5]},
    "absolute": True,
    "order": "shuffled",
    "normalize": False,
    "clip": False,
    "see_behind": True,
    "observe_intentions": True,
    "include_obstacles": False,
}
OPTIONS = {
    "Kinematics": ("merge-v0", KINEMATICS),
    "ExitObservation": ("exit-v0", KINEMATICS),
    "TimeToCollision": ("u-turn-v0", {"horizon": 4}),
    "ContinuousAction": (
        "highway-fast-v0",
        {
            "acceleration_range": [-1, 4],
            "steering_range": [-0.01, 0.02],
            "speed_range": [0, 24],
            "longitudinal": False,
            "lateral": False,
            "clip": False,
        },
    ),
    "DiscreteAction": (
        "highway-fast-v0",
        {
            "acceleration_range": [-1, 4],
            "steering_range": [-0.01, 0.02],
            "longitudinal": False,
            "lateral": False,
            "clip": False,
            "actions_per_axis": 4,
        },
    ),
    "DiscreteMetaAction": (
        "highway-fast-v0",
        {"longitudinal": False, "lateral": False, "target_speeds": [0, 7, 14, 21]},
    ),
}
FEATURES = {"features": ["presence", "x", "y", "vx", "vy", "cos_d", "sin_d"], "clip": True, "vehicles_count": 6}


@pytest.mark.parametrize("name", OPTIONS)
def test_every_option_of_observations_and_actions_is_reproduced(name):
    env_id, options = OPTIONS[name]
    types = {**OBSERVATIONS, **ACTIONS}
    parameters = set(inspect.signature(types[name]).parameters) - {"env", "kwargs", "dynamical"}
    assert parameters == set(options)
    what = "observation" if name in OBSERVATIONS else "action"
    plain = {"type": name, **(FEATURES if "features" in options else {})}
    call = {"env_id": env_id, "num_envs": 1, "decisions": 3}
    configs = [{**BASE.get(env_id, {}), what: {**plain, **change}} for change in [{}, *each(options)]]
    first, *results = compare_in_child(*({**call, "config": config} for config in configs))
    for option, result in zip(options, results, strict=True):
        assert_equal(result)
        if option not in ("clip", "observe_intentions", "include_obstacles"):  # which matter in few states
            assert result.digest != first.digest, option


def each(options):
    return [{name: value} for name, value in options.items()]


@pytest.mark.parametrize(
    ("env_id", "config", "message"),
    [
        ("highway-v0", {"controlled_vehicles": 2}, "controlled_vehicles: the compiled engine supports 1 only"),
        ("highway-v0", {"manual_control": True}, "manual_control: the compiled engine supports False only"),
        ("highway-v0", {"lanes_count": 0}, "lanes_count: expected a whole number from 1"),
        ("highway-v0", {"initial_lane_id": 4}, "initial_lane_id: 4 must be below lanes_count 4"),
        ("highway-v0", {"duration": -1}, "duration: expected a number above 0"),
        ("highway-v0", {"policy_frequency": 20}, "policy_frequency: 20 must not exceed simulation_frequency 15"),
        ("highway-v0", {"collision_reward": 0.5}, "normalize_reward: the least and greatest reward"),
        ("highway-v0", {"collision_reward": "no"}, "collision_reward: expected a number"),
        ("highway-v0", {"other_vehicles_type": "nowhere.Car"}, "other_vehicles_type: there is no class 'nowhere.Car'"),
        (
            "merge-v0",
            {"other_vehicles_type": "highway_env.vehicle.kinematics.Vehicle"},
            "other_vehicles_type: the compiled engine knows vehicles that drive",
        ),
        ("exit-v0", {"lanes_count": 1}, "lanes_count: highway-env's exit environment itself needs at least 2"),
        ("intersection-v0", {"destination": "o7"}, "destination: expected one of o0, o1, o2, o3"),
        ("highway-v0", {"observation": {"type": "OccupancyGrid"}}, "observation: .* not OccupancyGrid; use gymnasium"),
        ("highway-v0", {"observation": {"type": "LidarObservation"}}, "observation: .*not LidarObservation; use"),
        ("highway-v0", {"observation": {"type": "ExitObservation"}}, "an ExitObservation needs the lanes of the exit"),
        ("highway-v0", {"observation": {"type": "Kinematics", "vehicles_count": 1}}, "must be at least 2"),
        ("highway-v0", {"observation": {"type": "Kinematics", "features": ["x", "x"]}}, "a feature twice"),
        ("highway-v0", {"observation": {"type": "Kinematics", "sorted": True}}, "Unknown key of observation 'sorted'"),
        ("highway-v0", {"action": {"type": "MultiAgentAction"}}, "action: .* not MultiAgentAction; use gymnasium"),
        ("highway-v0", {"action": {"type": "ContinuousAction", "dynamical": True}}, "action.dynamical"),
        (
            "highway-v0",
            {"action": {"type": "DiscreteMetaAction", "longitudinal": False, "lateral": False}},
            "action: at least one of longitudinal and lateral",
        ),
        (
            "two-way-v0",
            {"action": {"type": "DiscreteAction"}, "observation": {"type": "Kinematics"}},
            "two-way environment itself needs the action type",
        ),
        ("u-turn-v0", {"action": {"type": "DiscreteAction"}}, "TimeToCollision needs the action type"),
        ("merge-v0", {"action": {"type": "ContinuousAction"}}, "reward of this environment itself needs discrete"),
        ("highway-v0", [], "config: expected keys and values"),
    ],
)
def test_what_is_not_reproduced_is_refused_by_name(env_id, config, message):
    with pytest.raises(InputError, match=message):
        HighwayVectorEnv(load_env_creator(behavexplor.HIGHWAY_ENV[env_id]), config=config)


def test_a_key_that_highway_env_ignores_is_named_and_ignored():
    with pytest.warns(
        UserWarning, match="HighwayEnv does not have the key 'lane_count' .*: did you mean 'lanes_count'?"
    ):
        envs = HighwayVectorEnv(HighwayEnv, 2, {"lane_count": 3})
    same = HighwayVectorEnv(HighwayEnv, 2)
    assert envs.reset(seed=1)[0].tobytes() == same.reset(seed=1)[0].tobytes()
