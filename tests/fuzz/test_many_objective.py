"""Selection among individuals with several objectives."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from behavexplor.fuzz.samota import crowding_distances, preference_ranks, survivors
from tests.strategies import seeds

VALUES = np.array([[0.1, 0.9], [0.9, 0.1], [0.2, 0.5], [0.5, 0.2], [0.6, 0.6], [0.95, 0.95]])


def test_the_best_of_each_objective_come_first_then_fronts():
    assert preference_ranks(VALUES).tolist() == [0, 0, 1, 1, 2, 3]


def test_survivors_are_the_first_fronts():
    assert set(survivors(VALUES, 2)) == {0, 1}
    assert set(survivors(VALUES, 4)) == {0, 1, 2, 3}


def test_within_a_front_whoever_stands_alone_survives():
    front = np.array([[0.0, 1.0], [1.0, 0.0], [0.4, 0.6], [0.45, 0.55], [0.5, 0.5], [0.9, 0.1]])
    assert set(survivors(front, 3)) == {0, 1, 2} or set(survivors(front, 3)) == {0, 1, 5}
    inner = front[2:]
    assert np.isinf(crowding_distances(inner)[[0, 3]]).all()
    assert crowding_distances(inner)[2] > crowding_distances(inner)[1]


def test_crowding_is_the_gap_between_neighbors():
    assert crowding_distances(np.array([[0.0], [1.0], [4.0]])).tolist() == [np.inf, 1.0, np.inf]
    assert crowding_distances(np.zeros((3, 2)))[1] in (0.0, np.inf)


def test_equal_individuals_are_ranked_too():
    assert preference_ranks(np.ones((3, 2))).tolist() == [0, 1, 1]


@given(seeds, st.integers(1, 12), st.integers(1, 4))
def test_no_one_is_ranked_before_who_dominates_it(seed, n, k):
    values = np.random.default_rng(seed).integers(0, 4, (n, k)) / 4
    ranks = preference_ranks(values)
    assert set(range(ranks.max() + 1)) <= set(ranks) | {0}
    for i in range(n):
        for j in range(n):
            if ranks[j] > 0 and (values[i] <= values[j]).all() and (values[i] < values[j]).any():
                assert ranks[i] < ranks[j]
    assert sorted(survivors(values, n)) == list(range(n))


@pytest.mark.parametrize("count", [1, 3])
def test_one_objective_is_sorting(count):
    values = np.array([[3.0], [1.0], [2.0], [5.0]])
    assert survivors(values, count).tolist() == [1, 2, 0][:count]
