"""Networks as systems under test."""

from itertools import pairwise

import numpy as np
import pytest

from behavexplor.ads.interface import ADS, DecisionLog
from behavexplor.ads.learned.deciding import N_ACTIONS
from behavexplor.ads.learned.driver import LearnedDriver
from behavexplor.ads.learned.network_file import RULES, TrainedNetwork, read_network, write_network
from behavexplor.ads.learned.observation import N_FEATURES
from behavexplor.ads.loading import load_ads
from behavexplor.errors import InputError
from tests.ads.learned.scenes import LOGICALS, ego, on_route

ROADMAP = LOGICALS["lane-follow"].roadmap


def random_layers(widths=(N_FEATURES, 16, N_ACTIONS), seed=0):
    generator = np.random.default_rng(seed)
    return [
        (generator.normal(size=(after, before)).astype(np.float32), generator.normal(size=after).astype(np.float32))
        for before, after in pairwise(widths)
    ]


def scenes(count, seed=0):
    generator = np.random.default_rng(seed)
    return np.array(
        [
            [
                ego("lane-follow", generator.uniform(10, 200), generator.normal(), generator.uniform(0, 11)),
                on_route("lane-follow", "lane-2", generator.uniform(10, 200), generator.uniform(0, 11)),
                on_route("lane-follow", "lane-3", generator.uniform(10, 200), generator.uniform(0, 11)),
            ]
            for _ in range(count)
        ]
    )


@pytest.fixture(params=RULES)
def rule(request):
    return request.param


@pytest.fixture
def driver(rule):
    return LearnedDriver(ROADMAP, TrainedNetwork(random_layers(), rule))


def test_it_is_an_ads_with_a_decision_log(driver):
    assert isinstance(driver, ADS)
    assert isinstance(driver, DecisionLog)


def test_no_row_depends_on_the_batch(driver):
    many = scenes(300)
    together, memory = driver.predict(many)
    for i in range(0, 300, 7):
        alone, state = driver.predict(many[i : i + 1])
        np.testing.assert_array_equal(alone[0], together[i])
        np.testing.assert_array_equal(state[0], memory[i])
    assert len(np.unique(together[:, 0])) > 2
    assert np.abs(together).max() <= 1.0


def test_the_state_handed_in_is_not_changed_and_is_forgotten_at_an_episode_start(driver):
    first, second = scenes(2, seed=1), scenes(2, seed=2)
    _, state = driver.predict(first)
    kept = state.copy()
    with_memory, _ = driver.predict(second, state, np.array([False, True]))
    np.testing.assert_array_equal(state, kept)
    fresh, _ = driver.predict(second)
    np.testing.assert_array_equal(with_memory[1], fresh[1])
    assert set(driver.log(state)) == {"wanted_offset"}


def test_a_file_keeps_the_network_and_the_rule(driver, rule, tmp_path):
    write_network(tmp_path / "policy.npz", TrainedNetwork(random_layers(), rule))
    again = load_ads(str(tmp_path / "policy.npz"), ROADMAP)
    many = scenes(50)
    np.testing.assert_array_equal(again.predict(many)[0], driver.predict(many)[0])


@pytest.mark.parametrize("widths", [(N_FEATURES - 1, 16, N_ACTIONS), (N_FEATURES, 16, N_ACTIONS + 1), (N_FEATURES, 16)])
def test_a_network_of_other_sizes_is_refused(widths):
    with pytest.raises(InputError, match=f"{N_FEATURES} inputs and {N_ACTIONS} outputs"):
        LearnedDriver(ROADMAP, TrainedNetwork(random_layers(widths)))


@pytest.mark.parametrize("content", [b"", b"rubbish", b"PK\x03\x04"])
def test_a_file_that_is_no_network_is_refused(content, tmp_path):
    (tmp_path / "policy.npz").write_bytes(content)
    with pytest.raises(InputError, match="contains no network"):
        read_network(tmp_path / "policy.npz")


@pytest.mark.parametrize(("weights", "bias"), [((2, 2), ()), ((2,), (2,)), ((2, 2, 1), (2,)), ((2, 2), (2, 1))])
def test_layers_that_are_no_matrices_are_refused(weights, bias, tmp_path):
    np.savez(tmp_path / "policy.npz", weights_0=np.zeros(weights), bias_0=np.zeros(bias), decision="mean")
    with pytest.raises(InputError, match="weights must be matrices, and biases vectors"):
        read_network(tmp_path / "policy.npz")


def test_a_file_without_all_layers_is_refused(tmp_path):
    np.savez(tmp_path / "policy.npz", weights_0=np.zeros((2, 2)), other=np.zeros(2), decision="mean")
    with pytest.raises(InputError, match="contains no network"):
        read_network(tmp_path / "policy.npz")
    with pytest.raises(InputError, match="There is no file"):
        read_network(tmp_path / "gone.npz")


def test_a_file_without_a_rule_is_refused(tmp_path):
    weights, bias = random_layers((N_FEATURES, N_ACTIONS))[0]
    np.savez(tmp_path / "policy.npz", weights_0=weights, bias_0=bias)
    with pytest.raises(InputError, match="contains no network of this package: it has no array 'decision'"):
        read_network(tmp_path / "policy.npz")


def test_arrays_that_are_no_network_are_said_to_be_none_in_any_environment(tmp_path):
    np.savez(tmp_path / "evaluations.npz", timesteps=np.arange(3), results=np.zeros((3, 5)))  # as EvalCallback does
    for roadmap in (LOGICALS["lane-change"].roadmap, None):
        with pytest.raises(InputError, match=r"evaluations\.npz contains no network of this package"):
            load_ads(str(tmp_path / "evaluations.npz"), roadmap)


def test_a_rule_of_a_later_version_is_named(tmp_path):
    weights, bias = random_layers((N_FEATURES, N_ACTIONS))[0]
    np.savez(tmp_path / "policy.npz", weights_0=weights, bias_0=bias, decision="median")
    with pytest.raises(InputError, match="decides by 'median', but this version knows mean and most probable"):
        read_network(tmp_path / "policy.npz")
