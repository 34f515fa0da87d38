"""The compiled form of environments that play their draws, beside highway-env itself."""

import numpy as np
import pytest

from behavexplor.envs.making import make_env, make_vector_env
from behavexplor.errors import InputError
from tests.envs.highway import subclass

COUNT = 3
TOLERANCE = 1e-4  # [m]; beyond this module's numpy, the arithmetic is equal


def driven(env, scenario, actions):
    """The trace of a scenario and the observations in highway-env itself."""
    observation, _ = env.reset(options={"scenario": scenario})
    seen = [observation]
    for action in actions:
        observation, _, terminated, truncated, info = env.step(action)
        seen.append(observation)
        if terminated or truncated:
            return info["trace"], np.array(seen)
    raise AssertionError("the episode has not ended")


@pytest.mark.parametrize(
    "name", ["highway-fast-v0", "merge-v0", "roundabout-v0", "intersection-v0", "exit-v0", subclass.ID]
)
def test_its_episodes_are_those_of_highway_env(name):
    env, own = make_env(name, {}), make_env(name, {})
    envs = make_vector_env(own, COUNT, {})
    rng = np.random.default_rng(0)
    scenarios = [env.logical.sample(rng) for _ in range(2 * COUNT)]
    actions = rng.integers(env.action_space.n, size=(2 * COUNT, 60))
    running, waiting = dict.fromkeys(range(COUNT)), list(range(2 * COUNT))
    traces, steps = {}, {}
    while waiting or any(number is not None for number in running.values()):
        free = [slot for slot, number in running.items() if number is None][: len(waiting)]
        for slot in free:
            running[slot] = waiting.pop(0)
            steps[running[slot]] = 0
        if free:
            given = [scenarios[running[slot] or 0] for slot in range(COUNT)]
            mask = np.isin(np.arange(COUNT), free)
            envs.reset(options={"scenarios": given, "reset_mask": mask})
        chosen = np.array([actions[running[slot] or 0, steps.get(running[slot], 0)] for slot in range(COUNT)])
        _, _, _, _, infos = envs.step(chosen)
        for slot, number in running.items():
            if number is None:
                continue
            steps[number] += 1
            if infos["_trace"][slot]:
                traces[number] = infos["trace"][slot]
                running[slot] = None
    for number, scenario in enumerate(scenarios):
        reference, _ = driven(env, scenario, actions[number])
        trace = traces[number]
        assert (trace.end, trace.partner) == (reference.end, reference.partner)
        assert trace.position.shape == reference.position.shape
        assert np.abs(trace.position - reference.position).max() < TOLERANCE
        assert np.array_equal(trace.present, reference.present)
        assert np.array_equal(trace.size, reference.size)
        assert np.allclose(trace.route, reference.route, atol=TOLERANCE)
        assert {key: values.tolist() for key, values in trace.signals.items()} == {
            key: values.tolist() for key, values in reference.signals.items()
        }
    envs.close()


def test_observations_are_those_of_highway_env():
    env, own = make_env("merge-v0", {}), make_env("merge-v0", {})
    envs = make_vector_env(own, 1, {})
    scenario = env.logical.sample(np.random.default_rng(1))
    _, reference = driven(env, scenario, [4] * 60)
    seen = [envs.reset(options={"scenarios": [scenario]})[0][0]]
    seen += [envs.step(np.array([4]))[0][0] for _ in range(len(reference) - 1)]
    assert np.allclose(np.array(seen), reference, atol=1e-5)


@pytest.mark.parametrize(
    ("name", "config", "message"),
    [
        ("racetrack-v0", {}, "racetrack|Racetrack"),
        ("parking-v0", {}, "parking|Parking"),
        (
            "highway-fast-v0",
            {"observation": {"type": "Kinematics", "order": "shuffled"}},
            "does not draw anything for observations",
        ),
    ],
)
def test_what_it_does_not_know_is_refused(name, config, message):
    with pytest.raises(InputError, match=message):
        make_vector_env(make_env(name, config), 2, {})


@pytest.mark.parametrize(
    ("name", "config"),
    [
        ("highway-fast-v0", {"initial_lane_id": None, "vehicles_count": 7}),
        ("merge-v0", {}),
        ("roundabout-v0", {"incoming_vehicle_destination": None}),
        ("intersection-v0", {"destination": None, "initial_vehicle_count": 5}),
        ("exit-v0", {"vehicles_count": 6}),
        ("two-way-v0", {}),
        ("u-turn-v0", {}),
    ],
)
def test_the_engine_begins_episodes_as_highway_env_does(name, config):
    own = make_env(name, config)
    envs = make_vector_env(own, COUNT, {})
    assert envs._order is not None
    rng = np.random.default_rng(7)
    for _ in range(5):
        scenario = own.logical.sample(rng)
        observation, _ = own.reset(options={"scenario": scenario})
        shown, _ = envs.reset(options={"scenarios": [scenario] * COUNT})
        assert np.allclose(shown, observation, atol=1e-5)
        first, record = own.record.frames[0], envs._records[1]
        assert len(first.things) == len(record.frames[0].things)
        assert list(own.record.sizes.values()) == list(record.sizes.values())
    envs.close()


@pytest.mark.parametrize(("name", "traffic"), [("merge-v0", "wide"), ("highway-fast-v0", "wide")])
def test_highway_env_begins_episodes_that_the_engine_does_not_know(name, traffic):
    envs = make_vector_env(make_env(name, {}, traffic), COUNT, {})
    assert envs._order is None
    scenarios = [envs.logical.sample(np.random.default_rng(k)) for k in range(COUNT)]
    together, _ = envs.reset(options={"scenarios": scenarios})
    alone, _ = make_env(name, {}, traffic).reset(options={"scenario": scenarios[1]})
    assert np.allclose(together[1], alone, atol=1e-5)
    envs.close()


def test_an_episode_begins_with_at_least_one():
    envs = make_vector_env(make_env("merge-v0", {}), 1, {})
    with pytest.raises(InputError, match="no sub-environment is selected"):
        envs.reset(options={"scenarios": [None], "reset_mask": np.zeros(1, dtype=bool)})
    scenario = make_env("merge-v0", {"policy_frequency": 2}).logical.sample(np.random.default_rng(0))
    with pytest.raises(InputError, match="config"):
        envs.reset(options={"scenarios": [scenario]})
