"""The vector environment does what the single one does, step by step and in gymnasium's own format."""

import copy
import json
import math
import os
import pickle
from collections import Counter
from dataclasses import replace
from typing import NamedTuple

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import behavexplor
from behavexplor.data.npc_motion import motion_table
from behavexplor.data.scripted import NPC, ScriptedScenario, Waypoint
from behavexplor.data.trace import RESOLUTION
from behavexplor.envs.functional import (
    IntersectionLeftEnv,
    IntersectionStraightEnv,
    LaneChangeEnv,
    LaneFollowEnv,
    LaneFollowVectorEnv,
)
from behavexplor.envs.observation_types import FEATURES
from behavexplor.envs.plain_simulation import Recorder
from behavexplor.envs.vector_env import DrivingVectorEnv, vector_env
from behavexplor.errors import InputError
from tests.envs.plain import plain

TOLERANCE = 1e-9
SCENARIOS = int(os.environ.get("SCENARIOS", "200"))  # of the slow comparison, by environment and action type
BATCH = 50  # of these at a time
LONG, SHORT = 60.0, 10.0  # time limits of episodes [s]: those of every tenth batch, and of the others
ACTIONS = {
    "continuous": {"type": "ContinuousAction", "acceleration_range": [-8.0, 4.0], "steering_range": [-0.6, 0.6]},
    "longitudinal": {"type": "ContinuousAction", "lateral": False, "speed_range": [0, 9]},
    "lateral": {"type": "ContinuousAction", "longitudinal": False, "clip": False, "speed_range": [6, 9]},
    "discrete": {"type": "DiscreteAction", "actions_per_axis": 5, "steering_range": [-0.2, 0.2]},
    "meta": {"type": "DiscreteMetaAction", "target_speeds": [0, 4, 8, 12]},
    "meta, speeds": {"type": "DiscreteMetaAction", "lateral": False},
}
OBSERVATIONS = {
    "scene": {"type": "Scene"},
    "kinematics": {"type": "Kinematics"},
    "all features": {
        "type": "Kinematics",
        "features": list(FEATURES),
        "vehicles_count": 4,
        "see_behind": True,
        "observe_intentions": True,
    },
    "raw": {
        "type": "Kinematics",
        "features": list(FEATURES),
        "vehicles_count": 9,
        "normalize": False,
        "absolute": True,
    },
}
ENVS = (IntersectionStraightEnv, IntersectionLeftEnv, LaneFollowEnv, LaneChangeEnv)


class Driver:
    """Random actions that get somewhere: along the route more or less, at some speed, with noise or without."""

    def __init__(self, env, rng):
        self.env, self.rng = env, rng
        self.speed = rng.choice([0.0, 5.0, 9.0, 11.0])
        self.noise = rng.choice([0.0, 0.1, 0.6])
        self.dtype = rng.choice([np.float32, np.float64])
        self.held = 0
        self.action = env.action_space.sample()

    def __call__(self):
        kind, space = self.env.config["action"]["type"], self.env.action_space
        if kind == "ContinuousAction":
            action = self.towards_route()
            action = action if len(action) == space.shape[0] else action[[int(self.env.action_type.lateral)]]
            return (action + self.rng.normal(0, self.noise, space.shape)).astype(self.dtype)
        if self.held == 0:
            self.action, self.held = int(self.rng.integers(space.n)), int(self.rng.integers(1, 25))
        self.held -= 1
        return self.action

    def towards_route(self):
        ego, route = self.env.vehicle, self.env.logical.roadmap.ego_route
        station, offset = route.project(*ego.position)
        wanted = route.pose(station + 4.0)[2] - math.atan(offset / 6)
        turn = math.remainder(wanted - ego.heading, 2 * math.pi)
        return np.array([np.clip(self.speed - ego.speed, -1, 1), np.clip(turn, -0.5, 0.5)])


def batch(space, actions):
    return np.array(actions) if isinstance(space, gymnasium.spaces.Discrete) else np.stack(actions)


class Comparison(NamedTuple):
    ends: list[str]
    worst: float  # deviation of all
    terms: set[str]  # of the reward, that were not 0
    different: int  # episodes that end otherwise, or at another decision
    decisions: int


def compare(env_class, config, n_envs, seed, scenarios=None):
    """Drive both to the end of every episode."""
    rng = np.random.default_rng(seed)
    vector = vector_env(env_class)(n_envs, config, autoreset_mode="Disabled")
    singles = [plain(env_class)(config) for _ in range(n_envs)]
    scenarios = scenarios or [None] * n_envs
    observations, infos = vector.reset(seed=seed, options={"scenarios": scenarios})
    worst, terms, different, decisions = 0.0, set(), set(), 0
    for b, env in enumerate(singles):
        observation, info = env.reset(seed=seed + b, options={"scenario": scenarios[b]})
        assert infos["scenario"][b] == info["scenario"]
        worst = max(worst, np.abs(observation - observations[b]).max())
    drivers = [Driver(env, rng) for env in singles]
    actions = [driver() for driver in drivers]
    ends = [None] * n_envs
    while None in ends:
        actions = [
            driver() if end is None else action for driver, end, action in zip(drivers, ends, actions, strict=True)
        ]
        given = batch(vector.single_action_space, actions)
        observations, rewards, terminated, truncated, infos = vector.step(given)
        for b, env in enumerate(singles):
            if ends[b] is not None:
                assert rewards[b] == 0 or b in different
                continue
            observation, reward, *done, info = env.step(given[b])
            decisions += 1
            worst = max(worst, deviation(observation, observations[b]), abs(reward - rewards[b]))
            worst = max(worst, abs(info["speed"] - infos["speed"][b]))
            worst = max(worst, *(abs(value - infos["rewards"][name][b]) for name, value in info["rewards"].items()))
            terms |= {name for name, value in info["rewards"].items() if value}
            end, other = info.get("end"), infos["end"][b] if "end" in infos else None
            ends[b] = end or other
            if (end, *done) != (other, terminated[b], truncated[b]):
                different.add(b)
            elif end is not None:
                worst = max(worst, compare_traces(info["trace"], infos["trace"][b]))
    return Comparison(ends, worst, terms, len(different), decisions)


def deviation(observation, other):
    """Single precision is compared in steps of its own: a last bit may be rounded either way."""
    if observation.dtype == np.float32:
        return 0.0 if np.all(np.abs(observation - other) <= np.spacing(np.abs(observation))) else np.inf
    return np.abs(observation - other).max()


def compare_traces(single, vector):
    for name in ("time", "size", "actions", "action_frame", "route", "destination", "illegal_lines"):
        assert np.array_equal(getattr(single, name), getattr(vector, name)), name
    for name in ("position", "heading", "velocity"):
        assert np.array_equal(getattr(single, name)[:, 1:], getattr(vector, name)[:, 1:]), f"{name} of the NPCs"
    motion = [
        np.abs(getattr(single, name) - getattr(vector, name)).max() for name in ("position", "heading", "velocity")
    ]
    return max(0.0, *(gap - 1.01 * RESOLUTION for gap in motion))  # either side of a half is rounded to its own


@pytest.mark.parametrize("action", ACTIONS.values(), ids=ACTIONS)
@pytest.mark.parametrize("env_class", [IntersectionLeftEnv, LaneChangeEnv])
def test_every_action_type_is_the_single_environment_s(env_class, action):
    config = {"action": action, "observation": {"type": "Scene"}, "duration": 40.0}
    assert compare(env_class, config, 3, seed=1).worst < TOLERANCE


@pytest.mark.parametrize("observation", OBSERVATIONS.values(), ids=OBSERVATIONS)
@pytest.mark.parametrize("action", ["continuous", "meta"])
def test_every_observation_is_the_single_environment_s(action, observation):
    config = {"action": ACTIONS[action], "observation": observation, "duration": 15.0}
    assert compare(IntersectionStraightEnv, config, 3, seed=2).worst < TOLERANCE


@pytest.mark.parametrize("config", [{"simulation_frequency": 15, "policy_frequency": 5}, {"logical": {"n_npcs": 2}}])
def test_other_configurations_are_the_single_environment_s(config):
    config = {**config, "duration": 8.03, "reward": {"progress": 3.0}}
    assert compare(LaneFollowEnv, config, 3, seed=3).worst < TOLERANCE


def test_episodes_that_end_otherwise_are_counted(monkeypatch):
    monkeypatch.setattr(Recorder, "standing_frames", lambda *_: math.inf)  # of the single environment alone
    compared = compare(LaneFollowEnv, {"duration": 1.0, "observation": {"type": "Scene"}}, 2, seed=0)
    assert compared.different == 2
    assert compared.ends == ["standstill"] * 2


@pytest.mark.slow
@pytest.mark.parametrize("action", ACTIONS)
@pytest.mark.parametrize("env_class", ENVS)
def test_thousands_of_scenarios_are_the_single_environment_s(env_class, action, capfd):
    """`SCENARIOS=2500 pytest -m slow -k thousands` compares 10 000 for each action type: docs/performance.md."""
    compared = []
    for number, start in enumerate(range(0, SCENARIOS, BATCH)):
        duration = SHORT if number % 10 else LONG
        config = {"action": ACTIONS[action], "observation": {"type": "Scene"}, "duration": duration}
        compared.append(compare(env_class, config, min(BATCH, SCENARIOS - start), seed=100 * number))
    ends = Counter(end for comparison in compared for end in comparison.ends)
    figures = {
        "env": env_class.logical.name,
        "action": action,
        "n": ends.total(),
        "worst": max(comparison.worst for comparison in compared),
        "different": sum(comparison.different for comparison in compared),
        "decisions": sum(comparison.decisions for comparison in compared),
        "ends": ends,
    }
    with capfd.disabled():
        print(json.dumps(figures), flush=True)  # noqa: T201 - the figures of docs/performance.md
    assert figures["worst"] < TOLERANCE
    assert figures["different"] == 0
    assert len(ends) >= 2


def test_npcs_are_the_same_bit_by_bit():
    env = vector_env(IntersectionLeftEnv)(4, {"observation": {"type": "Scene"}}, autoreset_mode="Disabled")
    observations, infos = env.reset(seed=8)
    hold = np.zeros((4, 2))
    for frame in range(0, 500, 2):
        time = np.array([frame / 20])
        for row, scenario in zip(observations, infos["scenario"], strict=True):
            table = motion_table(scenario, env.logical.roadmap, time)[0]
            assert np.array_equal(row[1:, 1:6], table)
        observations, _, terminated, *_ = env.step(hold)
        assert not terminated.any()


def chaser(position, speed, slow_at):
    """A car behind the ego, at one speed up to a place and slowly from there."""
    logical = IntersectionStraightEnv.logical
    ranges = logical.position_ranges(logical.roadmap.routes["south-inner-straight"])
    positions = np.maximum.accumulate([max(low, position) for low, _ in ranges])
    speeds = np.where(positions < slow_at, speed, 0.2)
    speeds[-1] = 0.0
    waypoints = tuple(Waypoint(float(s), float(v)) for s, v in zip(positions, speeds, strict=True))
    return ScriptedScenario("intersection-straight", (NPC("suv", "south-inner-straight", waypoints),))


def test_who_ran_into_whom_is_the_single_environment_s():
    rng = np.random.default_rng(0)
    config = {"observation": {"type": "Scene"}, "action": ACTIONS["continuous"], "duration": 40.0}
    scenarios = [chaser(rng.uniform(2.5, 5.0), rng.uniform(3, 11), rng.choice([0, 500])) for _ in range(8)]
    compared = compare(IntersectionStraightEnv, config, 8, seed=1, scenarios=scenarios)
    assert compared.worst < TOLERANCE
    assert {"rear_end", "progress"} <= compared.terms


def same(ours, theirs):
    """Whether infos have the same keys and nearly the same values, however nested."""
    assert ours.keys() == theirs.keys()
    for key, value in theirs.items():
        if isinstance(value, dict):
            same(ours[key], value)
        elif value.dtype != object:
            assert ours[key] == pytest.approx(value, abs=TOLERANCE), key
        else:
            assert [type(item) for item in ours[key]] == [type(item) for item in value], key


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_autoreset_is_gymnasium_s(mode):
    config = {"observation": {"type": "Scene"}, "duration": 1.0}
    ours = vector_env(LaneFollowEnv)(3, config, autoreset_mode=mode)
    theirs = SyncVectorEnv([lambda: LaneFollowEnv(config)] * 3, autoreset_mode=mode)
    assert ours.metadata["autoreset_mode"] is mode
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    observations, infos = ours.reset(seed=7)
    expected, expected_infos = theirs.reset(seed=7)
    assert np.array_equal(observations, expected)
    same(infos, expected_infos)
    ours.action_space.seed(0)
    for step in range(35):
        if step in (4, 15):
            mask = np.array([False, True, False])
            observations, infos = ours.reset(options={"reset_mask": mask})
            expected, expected_infos = theirs.reset(options={"reset_mask": mask.copy()})
            assert observations == pytest.approx(expected, abs=TOLERANCE)
            same(infos, expected_infos)
        actions = ours.action_space.sample()
        *results, infos = ours.step(actions)
        *expected_results, expected_infos = theirs.step(actions)
        for result, expected in zip(results, expected_results, strict=True):
            assert result == pytest.approx(expected, abs=TOLERANCE)
            assert result.dtype == expected.dtype
        same(infos, expected_infos)
        for b in np.flatnonzero(infos.get("_final_obs", [])):
            assert infos["final_obs"][b] == pytest.approx(expected_infos["final_obs"][b], abs=TOLERANCE)


def test_without_autoreset_the_ended_rest():
    env = vector_env(LaneFollowEnv)(2, {"duration": 1.0}, autoreset_mode=AutoresetMode.DISABLED)
    env.reset(seed=1)
    for _ in range(9):
        env.step(env.action_space.sample())
    env.reset(options={"reset_mask": np.array([False, True])})
    last, _, _, truncated, infos = env.step(env.action_space.sample())
    assert truncated.tolist() == [True, False]
    assert infos["_trace"].tolist() == [True, False]
    observations, rewards, _, truncated, infos = env.step(env.action_space.sample())
    assert truncated.tolist() == [True, False]
    assert rewards[0] == 0
    assert np.array_equal(observations[0], last[0])
    assert "trace" not in infos
    assert infos["_speed"].tolist() == [False, True]


def test_given_scenarios_are_run():
    env = vector_env(LaneFollowEnv)(3, {"duration": 0.2}, autoreset_mode="SameStep")
    scenarios = [env.logical.sample(np.random.default_rng(seed)) for seed in range(3)]
    _, infos = env.reset(seed=0, options={"scenarios": [scenarios[0], None, scenarios[1]]})
    assert infos["scenario"][0] is scenarios[0]
    assert infos["scenario"][2] is scenarios[1]
    assert infos["scenario"][1] == env.logical.sample(gymnasium.utils.seeding.np_random(1)[0])
    _, infos = env.reset(options={"scenario": scenarios[2]})
    assert list(infos["scenario"]) == [scenarios[2]] * 3
    empty = ScriptedScenario("lane-follow", ())
    _, infos = env.reset(options={"scenario": empty, "reset_mask": np.array([True, False, False])})
    assert infos["_scenario"].tolist() == [True, False, False]
    for _ in range(2):
        *_, infos = env.step(env.action_space.sample())
    assert infos["final_info"]["trace"][0].size.shape == (1, 2)
    assert infos["final_info"]["trace"][1].size.shape == (7, 2)
    assert infos["_scenario"].all()  # that follow are sampled


def test_one_seed_for_each():
    env = vector_env(LaneFollowEnv)(2)
    _, infos = env.reset(seed=[5, 5])
    assert infos["scenario"][0] == infos["scenario"][1]
    _, again = env.reset(seed=4)
    assert again["scenario"][1] == infos["scenario"][0]
    assert env.np_random.random() == np.random.default_rng(4).random()
    _, infos = env.reset(seed=[None, 0])
    assert infos["scenario"][1] == env.logical.sample(np.random.default_rng(0))
    assert infos["scenario"][0] != again["scenario"][0]


class OwnRule(LaneFollowEnv):
    def _find_end(self):
        return None


@pytest.mark.parametrize(
    ("env_class", "config", "message"),
    [
        (LaneFollowEnv, {"observation": {"type": "OccupancyGrid"}}, "OccupancyGridObservation"),
        (LaneFollowEnv, {"observation": {"type": "Kinematics", "order": "shuffled"}}, "'shuffled'"),
        (LaneFollowEnv, {"action": {"type": "ContinuousAction", "dynamical": True}}, "dynamical vehicles"),
        (OwnRule, {}, "OwnRule._find_end"),
    ],
)
def test_what_is_not_supported_is_refused_by_name(env_class, config, message):
    with pytest.raises(InputError, match=f"does not support .*{message}.*gymnasium.make"):
        vector_env(env_class)(2, config)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"num_envs": 0}, "num_envs: expected a whole number from 1"),
        ({"num_envs": 2.0}, "num_envs: expected a whole number"),
        ({"num_envs": True}, "num_envs: expected a whole number"),
        ({"autoreset_mode": "SameSteps"}, "did you mean 'SameStep'"),
        ({"autoreset_mode": None}, "Unknown autoreset mode 'None'"),
        ({"config": [1]}, "config: expected keys and values"),
        ({"config": {"duratio": 3}}, "did you mean 'duration'"),
        ({"render_mode": "human"}, "cannot render"),
    ],
)
def test_wrong_arguments_are_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        vector_env(LaneFollowEnv)(**arguments)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"options": {"scenari": None}}, "did you mean 'scenario'"),
        ({"options": {"scenarios": [None]}}, "scenarios: expected a list of 2"),
        ({"options": {"scenarios": 7}}, "scenarios: expected a list of 2"),
        ({"options": {"scenarios": {"a": 1, "b": 2}}}, "scenarios: expected a list of 2"),
        ({"options": {"scenario": "s1.json"}}, "must be a behavexplor.data.scripted.ScriptedScenario"),
        ({"options": {"scenarios": [None, ScriptedScenario("intersection-left", ())]}}, "not of 'lane-follow'"),
        ({"options": {"reset_mask": [True, False]}}, "expected an array of 2 booleans"),
        ({"options": {"reset_mask": np.zeros(2, dtype=bool)}}, "at least one"),
        ({"options": {"reset_mask": np.ones(2, dtype=np.int64)}}, "expected an array of 2 booleans"),
        ({"options": {"reset_mask": np.ones(3, dtype=bool)}}, "expected an array of 2 booleans"),
        ({"options": {"reset_mask": np.ones((2, 1), dtype=bool)}}, "expected an array of 2 booleans"),
        ({"seed": [1]}, "seed: expected one seed, or a list of 2"),
        ({"seed": 1.5}, "seed: expected one seed, or a list of 2"),
        ({"seed": [1, 1.5]}, "seed: expected whole numbers from 0"),
        ({"seed": -1}, "seed: expected whole numbers from 0"),
        ({"seed": [0, -1]}, "seed: expected whole numbers from 0"),
    ],
)
def test_wrong_resets_are_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        vector_env(LaneFollowEnv)(2).reset(**arguments)


@pytest.mark.parametrize("mode", AutoresetMode)
def test_steps_need_a_reset(mode):
    env = vector_env(LaneFollowEnv)(2, autoreset_mode=mode)
    with pytest.raises(ResetNeeded, match="call reset before step"):
        env.step(env.action_space.sample())
    env.reset(seed=0, options={"reset_mask": np.array([True, False])})
    with pytest.raises(ResetNeeded, match="A sub-environment has not begun"):
        env.step(env.action_space.sample())


@pytest.mark.parametrize(
    ("action", "actions"),
    [
        ("ContinuousAction", np.zeros((1, 2))),
        ("ContinuousAction", np.zeros(2)),
        ("ContinuousAction", np.zeros((2, 3))),
        ("ContinuousAction", np.full((2, 2), np.nan)),
        ("ContinuousAction", np.full((2, 2), np.inf)),
        ("ContinuousAction", np.full((2, 2), "go")),
        ("ContinuousAction", None),
        ("DiscreteMetaAction", np.array([1])),
        ("DiscreteMetaAction", np.array([0, 5])),
        ("DiscreteMetaAction", np.array([-1, 0])),
        ("DiscreteMetaAction", np.array([1.0, 2.0])),
        ("DiscreteMetaAction", np.array([[1], [2]])),
        ("DiscreteAction", 3),
    ],
)
def test_what_is_no_action_for_each_is_refused(action, actions):
    """By the vector environment and, one by one, by the single one; nothing has moved afterwards."""
    env = vector_env(LaneFollowEnv)(2, {"action": {"type": action}, "observation": {"type": "Scene"}})
    before, _ = env.reset(seed=0)
    with pytest.raises(InputError, match="actions: expected finite numbers of"):
        env.step(actions)
    egos = env._episodes.slots.state.vehicles[:, 0]
    assert np.array_equal(np.stack([egos["x"], egos["y"], egos["heading"]], axis=1), before[:, 0, 1:4])
    assert (env._episodes.slots.runs["frame"] == 0).all()


@pytest.mark.parametrize("name", behavexplor.FUNCTIONAL_SCENARIOS)
def test_gymnasium_makes_it(name):
    config = {"duration": 5.0}
    env = gymnasium.make_vec(
        f"behavexplor/{name}-v0", num_envs=3, vectorization_mode="vector_entry_point", config=config
    )
    assert isinstance(env, DrivingVectorEnv)
    assert env.logical.name == name
    observations, _ = env.reset(seed=2)
    assert env.observation_space.contains(observations)
    assert env.step(env.action_space.sample())[0] is not env.step(env.action_space.sample())[0]
    env.close()


def step_until_end(env, actions):
    """The last step's results; its episode of sub-environment 0 has just ended."""
    while True:
        *results, terminated, truncated, infos = env.step(actions)
        if terminated[0] or truncated[0]:
            return *results, infos


def test_the_step_after_an_end_resets_and_takes_no_action():
    env = vector_env(LaneFollowEnv)(2, {"duration": 1.0, "observation": {"type": "Scene"}})
    single = LaneFollowEnv({"duration": 1.0, "observation": {"type": "Scene"}})
    single.reset(seed=5)
    second, info = single.reset()
    env.reset(seed=5)
    actions = np.full((2, 2), 0.8)
    step_until_end(env, actions)
    observations, rewards, terminated, truncated, infos = env.step(actions)
    assert np.array_equal(observations[0], second)
    assert infos["scenario"][0] == info["scenario"] == env.scenarios[0]
    assert not np.any([rewards, terminated, truncated])
    assert set(infos) == {"scenario", "_scenario"}


def test_an_end_in_the_same_step_shows_both_episodes():
    config = {"duration": 1.0, "observation": {"type": "Scene"}}
    env = vector_env(LaneFollowEnv)(1, config, autoreset_mode="SameStep")
    single = LaneFollowEnv(config)
    env.reset(seed=5), single.reset(seed=5)
    for _ in range(10):
        observations, rewards, _, truncated, infos = env.step(np.full((1, 2), 0.8))
        last, reward, *_, info = single.step(np.full(2, 0.8))
    first, _ = single.reset()
    assert truncated[0]
    assert np.array_equal(observations[0], first)
    assert infos["final_obs"][0] == pytest.approx(last, abs=TOLERANCE)
    assert rewards[0] == pytest.approx(reward)
    assert infos["final_info"]["trace"][0].to_bytes() == info["trace"].to_bytes()
    assert infos["final_info"]["rewards"]["missed"][0] == info["rewards"]["missed"] == -4.0


def test_what_was_returned_does_not_change_afterwards():
    env = vector_env(LaneFollowEnv)(2, {"duration": 1.0, "observation": {"type": "Scene"}}, autoreset_mode="SameStep")
    observations, infos = env.reset(seed=1)
    kept = [(observations, observations.copy())]
    for _ in range(25):
        observations, rewards, terminated, truncated, infos = env.step(np.full((2, 2), 0.5))
        given = [observations, rewards, terminated, truncated]
        given += [infos["final_obs"][0]] if "final_obs" in infos else [infos["speed"], infos["rewards"]["progress"]]
        kept += [(array, array.copy()) for array in given]
    env.reset()
    assert all(np.array_equal(array, copy) for array, copy in kept)


def test_a_mask_leaves_the_others_and_their_generators_alone():
    """Masked resets draw what resets of single environments draw, one after the other."""
    env = vector_env(LaneFollowEnv)(2, {"observation": {"type": "Scene"}})
    singles = [LaneFollowEnv() for _ in range(2)]
    env.reset(seed=8)
    expected = [
        [single.reset(seed=8 + b)[1]["scenario"]] + [single.reset()[1]["scenario"] for _ in range(3)]
        for b, single in enumerate(singles)
    ]
    env.step(np.full((2, 2), 0.9))
    observations, infos = env.reset(options={"reset_mask": np.array([False, True])})
    assert env.scenarios == [expected[0][0], expected[1][1]]
    assert infos["scenario"].tolist() == [None, expected[1][1]]
    assert observations[0, 0, 4] == pytest.approx(0.1 * 0.9 * 5)  # goes on: the speed after one decision
    assert observations[1, 0, 4] == 0
    env.reset(seed=[None, 8], options={"reset_mask": np.array([True, True])})
    assert env.scenarios == [expected[0][1], expected[0][0]]
    env.reset(seed=[np.int64(9), 3], options={"reset_mask": np.array([True, False])})
    assert env.scenarios == [expected[1][0], expected[0][0]]


def test_a_given_scenario_leaves_the_generator_alone():
    env, single = vector_env(LaneFollowEnv)(1), LaneFollowEnv()
    given = env.logical.sample(np.random.default_rng(77))
    first = single.reset(seed=2)[1]["scenario"]
    second = single.reset()[1]["scenario"]
    env.reset(seed=2, options={"scenario": given})
    assert env.scenarios == [given]
    env.reset()
    assert env.scenarios == [first]
    env.reset()
    assert env.scenarios == [second]


@pytest.mark.parametrize("action", ["continuous", "discrete", "meta"])
def test_it_can_be_pickled_in_the_middle_of_an_episode(action):
    env = LaneFollowVectorEnv(2, {"action": ACTIONS[action], "observation": {"type": "Scene"}, "duration": 2.0})
    env.reset(seed=1)
    env.action_space.seed(1)
    for _ in range(5):
        env.step(env.action_space.sample())
    other = pickle.loads(pickle.dumps(env))
    for _ in range(30):
        actions = env.action_space.sample()
        results, expected = other.step(actions), env.step(actions)
        assert all(np.array_equal(a, b) for a, b in zip(results[:4], expected[:4], strict=True))
    assert other.scenarios == env.scenarios


def test_gymnasium_s_vector_wrappers_take_it():
    env = gymnasium.make_vec("behavexplor/lane-follow-v0", num_envs=3, config={"duration": 1.0})
    env = gymnasium.wrappers.vector.RecordEpisodeStatistics(env)
    env = gymnasium.wrappers.vector.DictInfoToList(gymnasium.wrappers.vector.NormalizeObservation(env))
    env.reset(seed=0)
    for _ in range(10):
        _, rewards, *_, infos = env.step(np.zeros((3, 2)))
    assert [info["end"] for info in infos] == ["timeout"] * 3
    assert [info["episode"]["l"] for info in infos] == [10] * 3
    assert infos[0]["episode"]["r"] < rewards[0] < 0  # every decision costs something
    env.close()


def test_it_can_be_closed_twice():
    env = vector_env(LaneFollowEnv)(2)
    env.close()
    env.close()
    assert env.closed


class Denser(LaneFollowEnv):
    """What a scenario of another package may look like."""

    logical = replace(LaneFollowEnv.logical, n_npcs=2)
    note = "attributes of its own change no rule"

    @classmethod
    def default_config(cls):
        return super().default_config() | {"duration": 3.0}

    def own_method(self):
        return 1


class DenserVectorEnv(DrivingVectorEnv):
    env_class = Denser


class OwnSpeedLimit(LaneFollowEnv):
    @property
    def vehicle(self):
        return super().vehicle


def test_a_scenario_of_another_package(monkeypatch):
    registry = dict(gymnasium.registry)
    monkeypatch.setattr(gymnasium.envs.registration, "registry", registry)
    here = f"{__name__}:Denser"
    gymnasium.register("others/denser-v3", entry_point=f"{here}Env"[:-3], vector_entry_point=f"{here}VectorEnv")
    single, many = gymnasium.make("others/denser-v3"), gymnasium.make_vec("others/denser-v3", num_envs=2)
    observation, info = single.reset(seed=0)
    observations, infos = many.reset(seed=0)
    assert np.array_equal(observation, observations[0])
    assert infos["scenario"][0] == info["scenario"]
    assert (len(info["scenario"].npcs), many.config["duration"], observation.shape) == (2, 3.0, (3, 5))


def test_overridden_properties_are_noticed():
    with pytest.raises(InputError, match=r"OwnSpeedLimit\.vehicle"):
        vector_env(OwnSpeedLimit)(2)


def make_lane_change():
    env = gymnasium.make_vec("behavexplor/lane-change-v0", num_envs=2, vectorization_mode="vector_entry_point")
    env.reset(seed=0)
    return env


@pytest.mark.parametrize(
    ("field", "value"), [("frame", 10**6), ("frame", -1), ("n_vehicles", 10**6), ("n_vehicles", 0)]
)
def test_a_decision_beyond_the_room_of_a_slot_is_refused(field, value):
    env = make_lane_change()
    (env._episodes.slots.runs if field == "frame" else env._episodes.slots.state.episodes)[field][1] = value
    before = copy.deepcopy(env._episodes.slots)
    with pytest.raises(InputError, match="longer than its record"):
        env.step(env.action_space.sample())
    pairs = zip((*before.state, *before[1:]), (*env._episodes.slots.state, *env._episodes.slots[1:]), strict=True)
    assert all(np.array_equal(*pair) for pair in pairs)


def test_a_scenario_beyond_the_room_of_a_slot_is_refused():
    env = make_lane_change()
    scenario = env.scenarios[0]
    crowded = ScriptedScenario(scenario.functional, scenario.npcs * 100)
    with pytest.raises(InputError, match=r"more than \d+ NPCs, for which there is room"):
        env._begin(np.array([True, False]), [crowded, None])
