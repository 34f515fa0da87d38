import gymnasium
import numpy as np
import pytest

import behavexplor  # noqa: F401 - registers the environments
from behavexplor.ads.rule import Parameters, RulePlanner
from behavexplor.envs.functional import IntersectionStraightEnv
from behavexplor.errors import InputError
from behavexplor.execution.rollout import rollout
from behavexplor.judge.specs import judge
from tests.ads.rule.world import scene

LOGICAL = IntersectionStraightEnv.logical

ROADMAP = LOGICAL.roadmap


@pytest.fixture(scope="module")
def planner():
    return RulePlanner(ROADMAP)


def scenes(count, seed=0):
    """Random scenes with the ego anywhere on its way."""
    rng = np.random.default_rng(seed)
    rows = []
    for _ in range(count):
        npcs = []
        for _ in range(5):
            route = ROADMAP.npc_routes[rng.integers(len(ROADMAP.npc_routes))]
            npcs.append((*route.pose(rng.uniform(60, 160)), rng.uniform(0, 11), rng.uniform(-2, 2)))
        rows.append(scene((*ROADMAP.ego_route.pose(rng.uniform(20, 170)), rng.uniform(0, 11)), npcs))
    return np.array(rows)


def test_actions_and_states_of_a_row_do_not_depend_on_the_batch(planner):
    observation = scenes(250)
    together, state = planner.predict(observation)
    again, later = planner.predict(observation, state)
    for i in range(250):
        alone, own = planner.predict(observation[i : i + 1])
        np.testing.assert_array_equal(alone[0], together[i])
        np.testing.assert_array_equal(planner.predict(observation[i : i + 1], own)[0][0], again[i])
    assert np.abs(together).max() <= 1
    assert together.shape == (250, 2)
    assert later.shape == state.shape


def test_the_state_handed_in_is_kept_and_episode_starts_forget_it(planner):
    observation = scenes(6)
    fresh, state = planner.predict(observation)
    _, state = planner.predict(observation, state)
    before = state.copy()
    start = np.array([True, False] * 3)
    actions, _ = planner.predict(observation, state, start)
    np.testing.assert_array_equal(state, before)
    np.testing.assert_array_equal(actions[start], fresh[start])
    np.testing.assert_array_equal(actions[~start], planner.predict(observation, state)[0][~start])


def test_the_log_has_a_row_for_every_ego(planner):
    _, state = planner.predict(scenes(3))
    log = planner.log(state)
    assert set(log) == {"decision", "manoeuvre", "lane", "survived", "reached", "triggered"}
    assert {values.shape for values in log.values()} == {(3,)}


def test_no_acceleration_is_not_the_middle_of_the_range(planner):
    cruising = scene((*ROADMAP.ego_route.pose(150.0), ROADMAP.speed_limit))
    actions, _ = planner.predict(cruising[None])
    assert actions[0] == pytest.approx([1 / 3, 0], abs=1e-9)


@pytest.mark.parametrize("value", [-1.0, float("nan"), float("inf"), "2"])
def test_a_wrong_parameter_is_refused(value):
    with pytest.raises(InputError, match="stop_gap"):
        Parameters(stop_gap=value)


def test_in_the_real_environment_it_arrives_nearly_always_and_never_touches_a_line(planner):
    config = {key: getattr(planner, key) for key in ("observation", "action", "policy_frequency")}
    env = gymnasium.make("behavexplor/intersection-straight-v0", config=config, disable_env_checker=True)
    rng = np.random.default_rng(11)
    traces = [rollout(env, planner, LOGICAL.sample(rng)) for _ in range(40)]
    env.close()
    assert sum(trace.end == "arrived" for trace in traces) >= 36
    assert all(not judge(trace).violated or trace.end == "collision" for trace in traces)
    assert all(trace.decisions["decision"].shape == trace.action_frame.shape for trace in traces)
