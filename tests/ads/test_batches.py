"""What every driver of this package does with a batch: shapes, memory, rounding, and rows without an ego."""

import numpy as np
import pytest

from behavexplor.ads.loading import load_ads
from behavexplor.ads.scene_io import RESOLUTION, as_memory, as_scenes
from behavexplor.errors import InputError
from tests.ads.learned.scenes import LOGICALS, ego, on_route

ROADMAP = LOGICALS["lane-follow"].roadmap
NAMES = ("rule:hardened", "rule:apollo-easy", "learned:lane-follow", "idm")
EVERY = pytest.mark.parametrize("name", NAMES)


@pytest.fixture(scope="module")
def drivers():
    return {name: load_ads(name, ROADMAP) for name in NAMES}


def scenes(count, seed):
    rng = np.random.default_rng(seed)
    rows = [
        [
            ego("lane-follow", rng.uniform(20, 60), rng.normal(scale=0.3), rng.uniform(0, 11)),
            on_route("lane-follow", "lane-3", rng.uniform(70, 120), rng.uniform(0, 11), rng.normal()),
            on_route("lane-follow", "lane-2", rng.uniform(10, 120), rng.uniform(0, 11)),
        ]
        for _ in range(count)
    ]
    return np.array(rows)


@EVERY
def test_rows_of_zeros_are_skipped_and_change_nothing_for_the_others(drivers, name):
    driver, some = drivers[name], [1, 2, 5]
    sparse = [np.zeros((7, 3, 8)) for _ in range(3)]
    state = alone = None
    for seed, observation in enumerate(sparse):
        observation[some] = scenes(3, seed)
        actions, state = driver.predict(observation, state)
        expected, alone = driver.predict(observation[some], alone)
        np.testing.assert_array_equal(actions[some], expected)
        assert np.isfinite(actions).all()
        if state is not None:
            np.testing.assert_array_equal(state[some], alone)
            assert not np.delete(state, some, axis=0).any()


@EVERY
def test_a_row_of_zeros_leaves_the_memory_as_it_was(drivers, name):
    observation = scenes(4, 1)
    _, state = drivers[name].predict(observation)
    observation[2] = 0.0
    _, later = drivers[name].predict(observation, state)
    if state is not None:
        np.testing.assert_array_equal(later[2], state[2])


@EVERY
def test_last_bits_of_what_is_seen_do_not_matter(drivers, name):
    observation = scenes(40, 2).round(6)
    noisy = observation * (1 + 4e-16) - 1e-14
    noisy[..., 0] = observation[..., 0]
    np.testing.assert_array_equal(drivers[name].predict(noisy)[0], drivers[name].predict(observation)[0])


@EVERY
@pytest.mark.parametrize("shape", [(3, 8), (1, 3, 7), (1, 0, 8)])
def test_a_wrong_observation_is_refused(drivers, name, shape):
    with pytest.raises(InputError, match="observation: expected shape"):
        drivers[name].predict(np.zeros(shape))


@pytest.mark.parametrize("name", NAMES[:3])
def test_a_wrong_state_is_refused(drivers, name):
    with pytest.raises(InputError, match="state: expected shape"):
        drivers[name].predict(scenes(2, 0), np.zeros((2, 5)))
    with pytest.raises(InputError, match=r"episode_start: expected shape \(2,\)"):
        drivers[name].predict(scenes(2, 0), None, np.array([True]))


def test_scenes_are_rounded_and_contiguous():
    observation = np.asfortranarray(np.random.default_rng(0).normal(size=(2, 3, 8)))
    rounded = as_scenes(observation)
    assert rounded.flags.c_contiguous
    assert np.abs(rounded - observation).max() <= RESOLUTION / 2 * (1 + 1e-6)
    np.testing.assert_array_equal(as_scenes(rounded), rounded)


def test_memory_is_new_and_forgotten_where_an_episode_begins():
    assert as_memory(None, None, (2, 3)).tolist() == [[0.0] * 3] * 2
    state = np.ones((2, 3))
    memory = as_memory(state, np.array([False, True]), (2, 3))
    assert memory.tolist() == [[1.0] * 3, [0.0] * 3]
    assert state.min() == 1.0
