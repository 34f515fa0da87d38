"""Energies against the paper's equations 14-18, worked out by hand."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from behavexplor.fuzz.behavexplor import GAMMA, SELECTION_CHANGE, degree_change, failure_change, selection_probabilities


@pytest.mark.parametrize(
    ("failed", "n_failed", "n_passed", "change"),
    [
        (True, 1, 0, 1.0),
        (True, 1, 3, 1 / 4),
        (True, 3, 1, 3 / 4),
        (False, 0, 1, -0.1),
        (False, 1, 3, -3 * 0.1 / 4),
        (False, 9, 1, -1 * 0.1 / 10),
    ],
)
def test_failure_frequency(failed, n_failed, n_passed, change):
    assert failure_change(failed, n_failed, n_passed) == pytest.approx(change)


@pytest.mark.parametrize(
    ("parent_degree", "degree", "distance", "printed"),
    [
        (10.0, 8.0, 0.0, 2 / (1 + 1e-5)),
        (8.0, 10.0, 0.0, -2 / (1 + 1e-5)),
        (10.0, 9.5, 0.5, 0.5 / (0.5 + 1e-5)),
        (10.0, 9.9, 1.0, 0.1 / 1e-5),
        (3.0, 3.0, 1.0, 0.0),
    ],
)
def test_change_of_the_violation_degree(parent_degree, degree, distance, printed):
    assert degree_change(parent_degree, degree, distance, bounded=False, gamma=GAMMA) == pytest.approx(printed)
    bounded = degree_change(parent_degree, degree, distance, bounded=True, gamma=GAMMA)
    assert bounded == pytest.approx((math.exp(2 * printed) - 1) / (math.exp(2 * printed) + 1) if printed < 300 else 1)


def test_a_mutant_that_behaves_otherwise_counts_for_more():
    near, far = (degree_change(5.0, 4.8, distance, bounded=True, gamma=GAMMA) for distance in (0.1, 0.8))
    assert 0 < near < far < 1


def test_decay_with_selection():
    assert SELECTION_CHANGE == -0.05


@pytest.mark.parametrize(
    ("energies", "probabilities"),
    [
        ([1, 1, 1, 1], [1 / 4] * 4),
        ([1, 3], [1 / 4, 3 / 4]),
        ([2, -5, 2], [1 / 2, 0, 1 / 2]),
        ([0, 0], [1 / 2, 1 / 2]),
        ([-1, -2, -3], [1 / 3] * 3),
        ([7], [1]),
    ],
)
def test_selection_probabilities(energies, probabilities):
    assert selection_probabilities(np.array(energies, dtype=float)).tolist() == pytest.approx(probabilities)


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=50))
def test_selection_probabilities_sum_to_one(energies):
    probabilities = selection_probabilities(np.array(energies))
    assert probabilities.sum() == pytest.approx(1)
    assert (probabilities >= 0).all()
