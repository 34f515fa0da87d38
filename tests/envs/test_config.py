"""The environments' configuration: highway-env's own works as it is, and what is wrong is named."""

import gymnasium
import highway_env  # noqa: F401 - registers its environments
import numpy as np
import pytest

import behavexplor
from behavexplor.envs.config import ACTIONS, OBSERVATIONS
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
