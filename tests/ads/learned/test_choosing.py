"""What a policy decides follows from the probabilities of its actions."""

import numpy as np
import pytest
from scipy.stats import chisquare

from behavexplor.ads.learned.choosing import as_decisions, decide, draw_decisions
from behavexplor.ads.learned.tracker import ACCELERATIONS, HOME, KEEP, LEFT, N_ACTIONS

BRAKE, COAST, GO = 0, 3, 4


def preferences(probabilities):
    """Outputs of a network that gives some (lane choice, acceleration) pairs a probability, and the others none."""
    values = np.full(N_ACTIONS, -np.inf)
    for (lane, acceleration), probability in probabilities.items():
        values[lane * len(ACCELERATIONS) + acceleration] = np.log(probability)
    return values[None] + 3.0  # a constant changes no probability


SPLIT = {(KEEP, BRAKE): 0.4, (KEEP, COAST): 0.05, (HOME, COAST): 0.25, (HOME, GO): 0.3}


def test_the_mean_acceleration_and_the_most_probable_lane_choice():
    found = decide(preferences(SPLIT), "mean")
    assert found.accelerations[0] == pytest.approx(0.4 * -6.0 + 0.3 * 2.0)
    assert found.lanes[0] == HOME


def test_the_most_probable_action():
    found = decide(preferences(SPLIT), "most probable")
    assert (found.accelerations[0], found.lanes[0]) == (-6.0, KEEP)


def test_a_certain_policy_does_the_same_by_all_rules():
    certain = preferences({(LEFT, GO): 1.0})
    for found in (decide(certain, "mean"), decide(certain, "most probable"), draw_decisions(certain, np.array([0.99]))):
        assert (found.accelerations[0], found.lanes[0]) == (2.0, LEFT)


@pytest.mark.parametrize("rule", ["mean", "most probable"])
def test_of_equal_choices_the_first_one(rule):
    assert decide(np.zeros((1, N_ACTIONS)), rule).lanes[0] == KEEP


def test_actions_are_drawn_with_their_probabilities():
    n = 20_000
    found = draw_decisions(np.repeat(preferences(SPLIT), n, axis=0), np.random.default_rng(0).random(n))
    drawn = [
        np.count_nonzero((found.lanes == lane) & (found.accelerations == ACCELERATIONS[acceleration]))
        for lane, acceleration in SPLIT
    ]
    assert sum(drawn) == n
    assert chisquare(drawn, n * np.array(list(SPLIT.values()))).pvalue > 0.01
    assert found.accelerations.mean() == pytest.approx(decide(preferences(SPLIT), "mean").accelerations[0], abs=0.1)


def test_great_preferences_do_not_overflow():
    found = decide(np.full((2, N_ACTIONS), 1e4), "mean")
    np.testing.assert_allclose(found.accelerations, np.mean(ACCELERATIONS))


def test_an_index_is_an_acceleration_and_a_lane_choice():
    found = as_decisions(np.arange(N_ACTIONS))
    assert len(set(zip(found.accelerations.tolist(), found.lanes.tolist(), strict=True))) == N_ACTIONS
