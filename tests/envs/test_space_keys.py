"""Typos inside the observation and action of a configuration, which highway-env would ignore."""

import gymnasium
import pytest
from highway_env.envs import HighwayEnvFast
from highway_env.envs.common.action import action_factory
from highway_env.envs.common.observation import ObservationType, observation_factory

from behavexplor import evaluate, find_failures
from behavexplor.envs.env_config import HIGHWAY_ACTIONS, HIGHWAY_OBSERVATIONS
from behavexplor.envs.making import check_keys, make_registered
from behavexplor.errors import InputError

KINEMATICS = {"type": "Kinematics", "vehicles_count": 7, "features": ["presence", "x"]}
OWN = f"{__name__}:own-keys-v0"
OWN_TYPE = f"{__name__}:own-type-v0"


class OwnKeys(HighwayEnvFast):
    """An environment that reads a key of its own in its observation."""

    @classmethod
    def default_config(cls):
        config = super().default_config()
        return config | {"observation": {"type": "Kinematics", "blur": 0.1}}


class OwnType(HighwayEnvFast):
    """An environment that makes its own observation."""

    def define_spaces(self):
        self.observation_type = Blurred(self, self.config["observation"].get("blur", 0.0))
        self.action_type = action_factory(self, self.config["action"])
        self.observation_space, self.action_space = self.observation_type.space(), self.action_type.space()


class Blurred(ObservationType):
    def __init__(self, env, blur):
        super().__init__(env)
        self.blur = blur

    def space(self):
        return gymnasium.spaces.Box(0.0, 1.0, (1,))

    def observe(self):
        return self.space().low + self.blur


gymnasium.register("own-keys-v0", entry_point=OwnKeys)
gymnasium.register("own-type-v0", entry_point=OwnType)


@pytest.mark.parametrize(
    ("config", "message"),
    [
        (
            {"observation": {"type": "Kinematics", "vehicle_count": 7}},
            "observation 'vehicle_count': .* 'vehicles_count'",
        ),
        ({"observation": {**KINEMATICS, "features": ["presense"]}}, "observation.features 'presense': .* 'presence'"),
        ({"observation": {**KINEMATICS, "features_range": {"z": [0, 1]}}}, "observation.features_range 'z': known are"),
        ({"observation": {"type": "OccupancyGrid", "features": ["on_raod"]}}, "features 'on_raod': .* 'on_road'"),
        (
            {"action": {"type": "DiscreteMetaAction", "target_speed": [1, 2]}},
            "action 'target_speed': .* 'target_speeds'",
        ),
        (
            {"observation": {"type": "TupleObservation", "observation_configs": [KINEMATICS, {"type": "Kinematic"}]}},
            r"Unknown observation.observation_configs\[1\] type 'Kinematic': .* 'Kinematics'",
        ),
        ({"observation": {"type": "Sonar"}}, "Unknown observation type 'Sonar': known are AttributesObservation, "),
        ({"action": {"lateral": False}}, "action needs a type"),
        ({"observation": {**KINEMATICS, "features": [["x"]]}}, "feature in observation.features \"\\['x'\\]\""),
        ({"observation": 3}, "observation: expected keys and values, got 3"),
    ],
)
def test_what_highway_env_would_ignore_is_refused_by_name(config, message):
    with pytest.raises(InputError, match=message):
        check_keys("highway-fast-v0", config)


@pytest.mark.parametrize(
    ("env", "config"),
    [
        ("highway-fast-v0", {"observation": KINEMATICS}),
        ("highway-fast-v0", {"observation": {"type": "OccupancyGrid", "vehicles_count": 7}}),  # as in its documentation
        ("parking-v0", {"observation": {"type": "KinematicsGoal", "scales": [1, 1], "features": ["x", "y"]}}),
        (OWN, {"observation": {"type": "Kinematics", "blur": 0.2}}),
        (OWN_TYPE, {"observation": {"type": "Blurred", "blur": 0.2}}),
    ],
)
def test_what_is_known_is_not_refused(env, config):
    check_keys(env, config)


@pytest.mark.parametrize("name", ["racetrack-v0", "intersection-multi-agent-v0", "intersection-v1", "lane-keeping-v0"])
def test_the_configurations_of_highway_env_itself_are_known(name):
    check_keys(name, make_registered(name, {}).unwrapped.config)


def test_the_types_are_those_of_highway_env():
    env = make_registered("highway-fast-v0", {}).unwrapped
    needed = {
        "attributes": [],
        "scales": [1],
        "observation_shape": (8, 8),
        "stack_size": 1,
        "weights": [1, 1, 1],
        "observation_configs": [KINEMATICS],
        "observation_config": KINEMATICS,
        "action_config": {"type": "DiscreteMetaAction"},
    }
    for name, kind in HIGHWAY_OBSERVATIONS.items():
        assert type(observation_factory(env, {**needed, "type": name})) is kind
    for name, kind in HIGHWAY_ACTIONS.items():
        assert type(action_factory(env, {**needed, "type": name})) is kind


def slower(observation):
    return 4


slower.observation = {"type": "Kinematics", "vehicle_count": 7}


def test_what_a_driver_declares_is_checked_as_well_from_python(tmp_path):
    with pytest.raises(InputError, match="Unknown key of observation 'vehicle_count'"):
        find_failures(slower, "highway-fast-v0", budget=1, out=tmp_path / "run")
    config = {"action": {"type": "DiscreteAction", "laterl": True}}
    with pytest.raises(InputError, match="Unknown key of action 'laterl': did you mean 'lateral'"):
        evaluate(lambda _: 4, "highway-fast-v0", scenarios=1, env_config=config)


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ({"duration": "5"}, r"duration of highway-fast-v0: expected a number, got '5'$"),
        (
            {"collision_reward": "-1e-1"},
            r"got '-1e-1' \(in YAML, an exponent needs a sign, and a point before it: 1\.0e",
        ),
        ({"collision_reward": "1.0e5"}, r"got '1\.0e5' \(in YAML, an exponent needs a sign"),
    ],
)
def test_a_text_in_place_of_a_number_is_refused(config, message):
    with pytest.raises(InputError, match=message):
        check_keys("highway-fast-v0", config)
