"""The environments' configuration: highway-env's own works as it is, and what is wrong is named."""

import math

import gymnasium
import highway_env  # noqa: F401 - registers its environments
import numpy as np
import pytest

import behavexplor
from behavexplor.envs.env_config import ACTIONS, OBSERVATIONS
from behavexplor.envs.functional import LaneFollowEnv
from behavexplor.envs.tasks.scripted_outcome import WEIGHTS
from behavexplor.errors import InputError

IDS = [f"behavexplor/{name}-v0" for name in behavexplor.FUNCTIONAL_SCENARIOS]
S1 = "behavexplor/intersection-straight-v0"
EXTRA = {
    "GrayscaleObservation": {
        "observation_shape": (64, 64),
        "stack_size": 2,
        "weights": [0.3, 0.6, 0.1],
        "scaling": 1.75,
    },
    "TupleObservation": {"observation_configs": [{"type": "Kinematics"}, {"type": "LidarObservation"}]},
}


def play(env, steps):
    observation, _ = env.reset(seed=1)
    assert env.observation_space.contains(observation)
    env.action_space.seed(0)
    for _ in range(steps):
        observation, reward, terminated, truncated, _ = env.step(env.action_space.sample())
        assert np.isfinite(reward)
        if terminated or truncated:
            observation, _ = env.reset()


@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize("name", OBSERVATIONS)
def test_observation_types(env_id, name):
    config = {"observation": {"type": name, **EXTRA.get(name, {})}, "action": {"type": "DiscreteMetaAction"}}
    env = gymnasium.make(env_id, config=config).unwrapped
    play(env, 5)
    env.close()


@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize("name", ACTIONS)
def test_action_types(env_id, name):
    env = gymnasium.make(env_id, config={"action": {"type": name}, "policy_frequency": 5}).unwrapped
    play(env, 30)


@pytest.mark.parametrize(
    ("theirs", "observation", "action"),
    [
        ("intersection-v0", (15, 7), "Discrete(3)"),
        ("intersection-v1", (5, 8), "Box(-1.0, 1.0, (2,), float32)"),
        ("highway-v0", (5, 5), "Discrete(5)"),
    ],
)
@pytest.mark.filterwarnings("ignore:.*is out of date:DeprecationWarning")
def test_policies_of_highway_env_find_their_spaces(theirs, observation, action):
    """A policy trained there sees and commands the same here, at the same frequencies."""
    original = gymnasium.make(theirs).unwrapped
    keys = ("observation", "action", "simulation_frequency", "policy_frequency")
    env = gymnasium.make(S1, config={key: original.config[key] for key in keys}).unwrapped
    assert env.observation_space == original.observation_space
    assert env.action_space == original.action_space
    assert env.observation_space.shape == observation
    assert str(env.action_space) == action
    play(env, 20)


def test_traffic_can_be_made_denser_and_slower():
    config = {"logical": {"n_npcs": 9, "min_speed": 3.0, "vehicle_types": ["school-bus"]}}
    env = gymnasium.make(S1, config=config).unwrapped
    scenario = env.reset(seed=0)[1]["scenario"]
    assert len(scenario.npcs) == 9
    assert {npc.type for npc in scenario.npcs} == {"school-bus"}
    assert min(waypoint.speed for npc in scenario.npcs for waypoint in npc.waypoints[:-1]) >= 3.0
    assert type(env).logical.n_npcs == 5
    assert gymnasium.make(S1).unwrapped.logical.n_npcs == 5


def test_no_traffic_at_all():
    env = gymnasium.make(S1, config={"logical": {"n_npcs": 0}}).unwrapped
    assert env.reset()[1]["scenario"].npcs == ()
    play(env, 5)


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ({"observations": {}}, "did you mean 'observation'"),
        ({"observation": {"type": "Kinematic"}}, "did you mean 'Kinematics'"),
        ({"observation": {"type": "Kinematics", "vehicle_count": 3}}, "did you mean 'vehicles_count'"),
        ({"observation": "Kinematics"}, "observation: expected keys and values"),
        ({"action": {"type": "MetaAction"}}, "did you mean 'DiscreteMetaAction'"),
        ({"action": {"type": "ContinuousAction", "steering": [-1, 1]}}, "did you mean 'steering_range'"),
        ({"observation": {"type": "TimeToCollision"}}, "needs the action type DiscreteMetaAction"),
        ({"reward": {"colision": -1}}, "did you mean 'collision'"),
        ({"reward": {"collision": "bad"}}, "reward.collision: expected a number"),
        ({"logical": {"n_npc": 3}}, "did you mean 'n_npcs'"),
        ({"logical": {"n_npcs": 2.5}}, "logical.n_npcs: expected a whole number"),
        ({"logical": {"n_npcs": -1}}, "logical.n_npcs: expected a whole number from 0"),
        ({"logical": {"vehicle_types": ["tank"]}}, "'tank'"),
        ({"logical": {"min_speed": 20.0}}, "logical.min_speed: 20.0 exceeds the speed limit"),
        ({"policy_frequency": 3}, "must be a multiple of policy_frequency 3"),
        ({"policy_frequency": 0}, "policy_frequency: expected a whole number from 1"),
        ({"duration": "long"}, "duration: expected a number above 0"),
    ],
)
def test_what_is_wrong_is_named(config, message):
    with pytest.raises(InputError) as error:
        gymnasium.make(S1, config=config)
    assert message in str(error.value)


def test_reset_options_do_not_stick():
    env = gymnasium.make(S1).unwrapped
    sampled = env.reset(seed=3)[1]["scenario"]
    other = env.reset(options={"scenario": type(env).logical.sample(np.random.default_rng(9))})[1]["scenario"]
    assert env.reset(seed=3)[1]["scenario"] == sampled != other


ODD = (
    None,
    True,
    False,
    -1,
    0,
    1,
    2,
    2.5,
    1e9,
    10**30,
    math.nan,
    math.inf,
    "x",
    b"x",
    (),
    [],
    [0, 1],
    [1, 0],
    [None, 1],
)
ODD += (
    ["x"],
    [["x"]],
    [[0, 1], [0, 1]],
    {},
    {"x": [0, 1]},
    {"x": "y"},
    {"x": [1, 1]},
    np.ones(2),
    np.ones((2, 2)),
    np.int64(3),
    object,
)
QUICK = {"duration": 1.0, "screen_width": 50, "screen_height": 40, "logical": {"n_npcs": 1}}
TYPE_KEYS = {  # but for two with which highway-env's own observations leave their spaces or warn
    "Kinematics": (
        "features",
        "vehicles_count",
        "features_range",
        "absolute",
        "order",
        "normalize",
        "clip",
        "see_behind",
    ),
    "OccupancyGrid": ("features", "grid_size", "grid_step", "features_range", "absolute", "align_to_vehicle_axes"),
    "LidarObservation": ("cells", "normalize"),
    "TimeToCollision": ("horizon", "flatten"),
    "GrayscaleObservation": ("observation_shape", "stack_size", "weights", "scaling", "centering_position"),
    "TupleObservation": ("observation_configs",),
    "ContinuousAction": (
        "acceleration_range",
        "steering_range",
        "speed_range",
        "longitudinal",
        "lateral",
        "dynamical",
        "clip",
    ),
    "DiscreteAction": ("acceleration_range", "steering_range", "longitudinal", "lateral", "clip", "actions_per_axis"),
    "DiscreteMetaAction": ("longitudinal", "lateral", "target_speeds"),
}


def refused_or_playable(config):
    """Whatever is not refused in one sentence must work; returns whether it was refused."""
    try:
        env = LaneFollowEnv(config)
    except InputError as error:
        assert "\n" not in str(error)
        assert len(str(error)) < 400
        return True
    play(env, 3)
    return False


def test_any_value_of_any_key_is_refused_or_works():
    keys = set(LaneFollowEnv.default_config()) - {"screen_width", "screen_height"}
    refused = {key: sum(refused_or_playable({**QUICK, key: value}) for value in ODD) for key in keys}
    assert min(refused.values()) >= len(ODD) // 2, refused


@pytest.mark.parametrize("name", [*WEIGHTS, "n_npcs", "min_speed", "end_gap", "npc_gap", "ego_gap"])
def test_any_weight_and_any_range_is_refused_or_works(name):
    key = "reward" if name in WEIGHTS else "logical"
    refused = [
        refused_or_playable({**QUICK, key: {"n_npcs": 1, name: value} if key == "logical" else {name: value}})
        for value in ODD
    ]
    assert sum(refused) >= len(ODD) // 2


@pytest.mark.parametrize(("name", "keys"), TYPE_KEYS.items(), ids=TYPE_KEYS)
def test_any_value_of_a_type_s_key_is_refused_or_works(name, keys):
    what = "observation" if name in OBSERVATIONS else "action"
    other = {"action": {"type": "DiscreteMetaAction"}} if what == "observation" else {}
    for key in keys:
        settings = [{"type": name, **EXTRA.get(name, {}), key: value} for value in ODD]
        refused = [refused_or_playable({**QUICK, **other, what: setting}) for setting in settings]
        assert any(refused), key


@pytest.mark.parametrize("value", [3, [], "x", [("duration", 1)]])
def test_a_configuration_has_keys(value):
    with pytest.raises(InputError, match="config: expected keys and values"):
        LaneFollowEnv(value)


def test_there_is_a_row_for_every_vehicle_unless_another_number_is_asked_for():
    env = LaneFollowEnv({"logical": {"n_npcs": 9}})
    assert env.observation_space.shape == (10, 5)
    observation, _ = env.reset(seed=0)
    near = [npc for npc in env.road.vehicles[1:] if np.hypot(*(npc.position - env.vehicle.position)) < 60]
    assert (observation[:, 0] > 0).sum() >= len(near) > 0
    env.configure({"logical": {"n_npcs": 2}})
    env.reset()
    assert env.observation_space.shape == (3, 5)
    asked = LaneFollowEnv({"logical": {"n_npcs": 9}, "observation": {"type": "Kinematics"}})
    assert asked.observation_space.shape == (5, 5)  # highway-env's own default
    asked.configure({"logical": {"n_npcs": 2}})
    asked.reset()
    assert asked.observation_space.shape == (5, 5)


def test_spaces_stay_the_same_objects_until_the_configuration_changes():
    env = LaneFollowEnv()
    spaces = env.observation_space, env.action_space
    env.action_space.seed(7)
    expected = [env.action_space.sample() for _ in range(4)]
    env.action_space.seed(7)
    for action in expected:
        env.reset()
        assert np.array_equal(env.action_space.sample(), action)
    assert (env.observation_space, env.action_space) == spaces
    assert env.observation_space is spaces[0]
    env.configure({"action": {"type": "DiscreteMetaAction"}, "observation": {"type": "TimeToCollision"}})
    observation, _ = env.reset()
    assert env.action_space == gymnasium.spaces.Discrete(5)
    assert env.observation_space.contains(observation)
    assert env.step(1)[0].shape == observation.shape


def test_a_refused_change_changes_nothing():
    env = LaneFollowEnv()
    before, logical = dict(env.config), env.logical
    for changes in ({"duration": 5.0, "policy_frequency": 7}, {"duration": 5.0, "logical": {"min_speed": 50.0}}):
        with pytest.raises(InputError):
            env.configure(changes)
        assert (env.config, env.logical) == (before, logical)


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ({"screen_width": -5}, "screen_width: expected a whole number from 1 to 10000, got -5"),
        (
            {"observation": {"type": "Kinematics", "vehicles_count": -1}},
            "observation.vehicles_count: expected a whole number",
        ),
        (
            {"observation": {"type": "Kinematics", "features": ["x", "sin_head"]}},
            "observation.features: expected a list of names",
        ),
        (
            {"observation": {"type": "Kinematics", "features": ["x", "on_road"]}},
            "observation.features: expected a list of names",
        ),
        (
            {"observation": {"type": "Kinematics", "order": "random"}},
            "observation.order: expected one of sorted, shuffled",
        ),
        ({"observation": {"type": "AttributesObservation", "attributes": ["time"]}}, "Unknown observation type"),
        (
            {"observation": {"type": "GrayscaleObservation", "stack_size": 2}},
            "GrayscaleObservation needs 'observation_shape'",
        ),
        ({"observation": {"type": "OccupancyGrid", "absolute": True}}, "always relative to the ego"),
        ({"observation": {"type": "TupleObservation", "observation_configs": []}}, "a list of 1 to 16 observations"),
        (
            {"observation": {"type": "TupleObservation", "observation_configs": [{"type": "Kinematics"}] * 17}},
            "a list of 1 to 16 observations",
        ),
        (
            {
                "observation": {
                    "type": "TupleObservation",
                    "observation_configs": [{"type": "Kinematics"}, {"type": "Scene"}],
                }
            },
            "Unknown observation.observation_configs[1] type 'Scene'",
        ),
        (
            {
                "observation": {
                    "type": "TupleObservation",
                    "observation_configs": [{"type": "LidarObservation", "cells": 0}],
                }
            },
            "observation.observation_configs[0].cells: expected a whole number",
        ),
        (
            {"observation": {"type": "TupleObservation", "observation_configs": [{"type": "TimeToCollision"}]}},
            "TimeToCollision needs the action type DiscreteMetaAction",
        ),
        ({"action": {"type": "ContinuousAction", "acceleration_range": [5, -5]}}, "two numbers, the lower first"),
        ({"action": {"type": "DiscreteAction", "speed_range": [0, 9]}}, "'speed_range'"),
        ({"action": {"type": "DiscreteMetaAction", "target_speeds": [0, 4, 5]}}, "in even steps upwards"),
        ({"action": {"type": "DiscreteMetaAction", "lateral": False, "longitudinal": False}}, "at least one of"),
        ({"manual_control": True}, "manual_control: True has no effect"),
        ({"simulation_frequency": True}, "simulation_frequency: expected a whole number"),
        ({"logical": {"end_gap": 200.0}}, "logical.end_gap: 200.0 leaves no room"),
        ({"logical": {"min_speed": math.nan}}, "logical.min_speed: expected a number from 0"),
        ({"logical": {"vehicle_types": []}}, "logical.vehicle_types: expected a list of names"),
    ],
)
def test_a_wrong_value_is_named_with_what_was_expected(config, message):
    with pytest.raises(InputError) as error:
        LaneFollowEnv(config)
    assert message in str(error.value)
