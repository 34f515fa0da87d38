"""highway-env's environments, played from their own draws."""

import copy
import pickle

import gymnasium
import numpy as np
import pytest
from highway_env.vehicle.behavior import IDMVehicle
from scipy.stats import binomtest

from behavexplor.data.scenario import parse_scenario
from behavexplor.data.trace import ABSENT, Trace
from behavexplor.envs.engine.vehicle_parameters import kept_parameters
from behavexplor.envs.making import environment_id, is_highway, make_env
from behavexplor.errors import InputError
from behavexplor.testing import check_env
from tests.envs.highway import subclass
from tests.envs.highway.comparison import many

NAMES = ["highway-fast-v0", "merge-v0", "roundabout-v0", "intersection-v0", "exit-v0", "two-way-v0", "u-turn-v0"]
NAMES += ["racetrack-v0", "parking-v0", "lane-keeping-v0"]
SLOW = ["highway-v0", *NAMES]
MOST = 60  # decisions of an episode here

pytestmark = pytest.mark.filterwarnings("ignore:.*out of date:DeprecationWarning")


def flat(observation):
    values = observation.values() if isinstance(observation, dict) else [observation]
    return np.concatenate([np.ravel(value) for value in values])


def stock_episode(name, seed, config=None):
    """The actions and results of an episode of random actions in highway-env's own environment."""
    env = gymnasium.make(name, config=config or {})
    with kept_parameters():
        env.action_space.seed(seed)
        steps = [(None, flat(env.reset(seed=seed)[0]), 0.0, False, False)]
        while len(steps) <= MOST and not (steps[-1][3] or steps[-1][4]):
            action = env.action_space.sample()
            observation, reward, terminated, truncated, _ = env.step(action)
            steps.append((action, flat(observation), float(reward), terminated, truncated))
    env.close()
    return steps


def drawn_episode(env, steps, **arguments):
    """The results of the same actions in an environment that plays draws, and the last info."""
    observation, info = env.reset(**arguments)
    results = [(None, flat(observation), 0.0, False, False)]
    for action, *_ in steps[1:]:
        observation, reward, terminated, truncated, info = env.step(action)
        results.append((action, flat(observation), reward, terminated, truncated))
    return results, info


def assert_equal(results, steps):
    for own, other in zip(results, steps, strict=True):
        assert np.array_equal(own[1], other[1])
        assert own[2:] == other[2:]


def check_replays(name, seeds):
    env = make_env(name, {})
    for seed in seeds:
        steps = stock_episode(name, seed)
        recorded, info = drawn_episode(env, steps, seed=seed)
        assert_equal(recorded, steps)
        scenario = parse_scenario(env.played().to_json())
        again, last = drawn_episode(env, steps, options={"scenario": scenario})
        assert_equal(again, steps)
        if "trace" in info:
            assert last["trace"].to_bytes() == info["trace"].to_bytes()
    env.close()


@pytest.mark.parametrize("name", NAMES)
def test_an_episode_of_highway_env_is_recorded_and_played_to_the_last_bit(name):
    check_replays(name, range(3))


@pytest.mark.slow
@pytest.mark.parametrize("name", SLOW)
def test_many_episodes_are_recorded_and_played_to_the_last_bit(name):
    check_replays(name, range(many(name, 100)))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "action"), [("roundabout-v0", 3), ("intersection-v0", 2), ("u-turn-v0", 1)])
def test_sampled_scenarios_have_the_crash_rate_of_resets(name, action):
    env, crashes = make_env(name, {}), []
    for source in ("seed", "scenario"):
        crashes.append(0)
        for k in range(300):
            scenario = env.logical.sample(np.random.default_rng(k))
            env.reset(**({"seed": k} if source == "seed" else {"options": {"scenario": scenario}}))
            done = False
            while not done:
                _, _, terminated, truncated, info = env.step(action)
                done = terminated or truncated
            crashes[-1] += info["crashed"]
    low, high = binomtest(crashes[1], 300).proportion_ci(0.99)
    assert low <= crashes[0] / 300 <= high


def run(env, action, **arguments):
    env.reset(**arguments)
    while True:
        _, _, terminated, truncated, info = env.step(action)
        if terminated or truncated:
            return info["trace"]


def test_a_crash_ends_the_trace_and_names_the_partner():
    trace = run(make_env("merge-v0", {}), 1, seed=0)
    assert trace.end == "collision"
    assert trace.signals["crashed"].tolist() == [0.0] * (len(trace.time) - 1) + [1.0]
    gap = np.hypot(*(trace.position[-1, trace.partner] - trace.position[-1, 0]))
    assert gap < 6.0
    assert Trace.from_bytes(trace.to_bytes()).to_bytes() == trace.to_bytes()


def test_vehicles_come_and_go():
    trace = run(make_env("intersection-v0", {}), 0, seed=3)
    assert trace.present.shape == trace.heading.shape
    assert trace.present[:, 0].all()
    appearing = trace.present.any(0) & ~trace.present[0]
    assert appearing.any()
    assert (trace.position[~trace.present] == ABSENT).all()
    assert np.abs(trace.position[trace.present]).max() < 1000


def test_only_what_means_something_is_a_signal():
    def signals(name, action):
        return set(run(make_env(name, {}), action, seed=1).signals) - {"changing_lanes", "way", "wrecks"}

    assert signals("highway-fast-v0", 4) == {"crashed", "off_road"}
    assert signals("intersection-v0", 1) == {"crashed", "arrived"}
    assert signals("roundabout-v0", 4) == {"crashed", "arrived"}
    assert signals("u-turn-v0", 4) == {"crashed"}


def test_a_creeping_policy_never_enters_the_roundabout():
    env = make_env("roundabout-v0", {})
    assert not run(env, 4, seed=0).signals["arrived"].any()
    assert run(env, 3, seed=0).signals["arrived"].any()


def test_the_configuration_is_part_of_the_scenario():
    env, other = make_env("merge-v0", {}), make_env("merge-v0", {"policy_frequency": 5})
    scenario = env.logical.sample(np.random.default_rng(0))
    with pytest.raises(InputError, match="'policy_frequency' in its configuration is 1, not 5"):
        other.reset(options={"scenario": scenario})


def test_it_is_neither_copied_nor_pickled_since_the_copy_would_drive_on_its_road():
    env = gymnasium.make("behavexplor/drawn-v0", env="highway-fast-v0")
    env.reset(seed=3)
    for copied in (copy.copy, copy.deepcopy, pickle.dumps):
        with pytest.raises(InputError, match="cannot be copied: make another one, reset it with the scenario of this"):
            copied(env.unwrapped)
    with pytest.raises(InputError, match="cannot be copied"):
        copy.deepcopy(env)


def test_a_subclass_needs_nothing_of_its_own():
    name = subclass.ID
    assert is_highway(name)
    env = make_env(name, {})
    env.reset(options={"scenario": env.logical.sample(np.random.default_rng(0))})
    assert len(env.inner.road.network.lanes_list()) == 5
    steps = stock_episode(name.rpartition(":")[2], 4)
    recorded, _ = drawn_episode(env, steps, seed=4)
    assert_equal(recorded, steps)


def test_an_intersection_leaves_the_class_of_its_vehicles_as_it_was():
    before = IDMVehicle.DISTANCE_WANTED, IDMVehicle.COMFORT_ACC_MAX
    merge = make_env("merge-v0", {})
    options = {"scenario": merge.logical.sample(np.random.default_rng(0))}
    first = run(merge, 4, options=options)
    intersection = make_env("intersection-v0", {})
    own = run(intersection, 1, seed=0)
    assert before == (IDMVehicle.DISTANCE_WANTED, IDMVehicle.COMFORT_ACC_MAX)
    assert run(merge, 4, options=options).to_bytes() == first.to_bytes()
    assert run(intersection, 1, seed=0).to_bytes() == own.to_bytes()


def test_an_unknown_environment_is_named():
    with pytest.raises(InputError, match="Unknown environment 'highway-fats-v0': did you mean 'highway-fast-v0'"):
        environment_id("highway-fats-v0")
    with pytest.raises(InputError, match="cannot be made: ModuleNotFoundError"):
        make_env("no_such_module:x-v0", {})


def test_wide_traffic_is_wider_and_fair():
    env = make_env("highway-fast-v0", {}, "wide")
    behind = others = 0
    for seed in range(5):
        env.reset(options={"scenario": env.logical.sample(np.random.default_rng(seed))})
        ego, *traffic = env.inner.road.vehicles
        behind += sum(vehicle.position[0] < ego.position[0] for vehicle in traffic)
        others += len(traffic)
        for vehicle in env.inner.road.vehicles:
            front, _ = env.inner.road.neighbour_vehicles(vehicle)
            if front is not None:
                gap = front.position[0] - vehicle.position[0] - 5.0
                closing = max(vehicle.speed - front.speed, 0.0)
                assert gap >= closing**2 / 8.0
    assert 0.3 < behind / others < 0.7
    wanted = {vehicle.TIME_WANTED for vehicle in env.inner.road.vehicles if isinstance(vehicle, IDMVehicle)}
    assert len(wanted) > 10


def test_it_keeps_the_contract_of_environments():
    check_env("merge-v0", scenarios=2)


def test_wide_traffic_is_played_again():
    env = make_env("merge-v0", {}, "wide")
    scenario = env.logical.sample(np.random.default_rng(0))
    first, again = (run(env, 1, options={"scenario": scenario}) for _ in range(2))
    assert first.to_bytes() == again.to_bytes()
    assert len(env.logical.blocks) > 3


@pytest.mark.parametrize(("name", "config"), [("parking-v0", {}), ("highway-fast-v0", {"vehicles_count": 0})])
def test_without_other_vehicles_there_is_no_wide_traffic(name, config):
    with pytest.raises(InputError, match="it begins without other vehicles"):
        make_env(name, config, "wide")
