"""What a policy decides follows from the probabilities of its actions."""

import numpy as np
import pytest
from scipy.stats import chisquare

from behavexplor.ads.learned.deciding import (
    ACCELERATION_TABLE,
    ACCELERATIONS,
    DRAWN,
    HOME,
    KEEP,
    LEFT,
    MEAN,
    MOST_PROBABLE,
    N_ACTIONS,
    Decisions,
    as_decisions,
    choose,
)
from tests.kernel_calls import called_alone

BRAKE, COAST, GO = 0, 3, 4

choose = called_alone(choose)


def decide(preferences, how, shares=None):
    """The decision for each row."""
    shares = np.zeros(len(preferences)) if shares is None else shares
    chosen = [choose(row, ACCELERATION_TABLE, how, share) for row, share in zip(preferences, shares, strict=True)]
    accelerations, lanes = zip(*chosen, strict=True)
    return Decisions(np.array(accelerations), np.array(lanes))


def draw_decisions(preferences, shares):
    return decide(preferences, DRAWN, shares)


def preferences(probabilities):
    """Outputs of a network that gives some (lane choice, acceleration) pairs a probability, and the others none."""
    values = np.full(N_ACTIONS, -np.inf)
    for (lane, acceleration), probability in probabilities.items():
        values[lane * len(ACCELERATIONS) + acceleration] = np.log(probability)
    return values[None] + 3.0  # a constant changes no probability


SPLIT = {(KEEP, BRAKE): 0.4, (KEEP, COAST): 0.05, (HOME, COAST): 0.25, (HOME, GO): 0.3}


def test_the_mean_acceleration_and_the_most_probable_lane_choice():
    found = decide(preferences(SPLIT), MEAN)
    assert found.accelerations[0] == pytest.approx(0.4 * -6.0 + 0.3 * 2.0)
    assert found.lanes[0] == HOME


def test_the_most_probable_action():
    found = decide(preferences(SPLIT), MOST_PROBABLE)
    assert (found.accelerations[0], found.lanes[0]) == (-6.0, KEEP)


def test_a_certain_policy_does_the_same_by_all_rules():
    certain = preferences({(LEFT, GO): 1.0})
    for found in (decide(certain, MEAN), decide(certain, MOST_PROBABLE), draw_decisions(certain, np.array([0.99]))):
        assert (found.accelerations[0], found.lanes[0]) == (2.0, LEFT)


@pytest.mark.parametrize("rule", [MEAN, MOST_PROBABLE])
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
    assert found.accelerations.mean() == pytest.approx(decide(preferences(SPLIT), MEAN).accelerations[0], abs=0.1)


def test_great_preferences_do_not_overflow():
    found = decide(np.full((2, N_ACTIONS), 1e4), MEAN)
    np.testing.assert_allclose(found.accelerations, np.mean(ACCELERATIONS))


def test_an_index_is_an_acceleration_and_a_lane_choice():
    found = as_decisions(np.arange(N_ACTIONS))
    assert len(set(zip(found.accelerations.tolist(), found.lanes.tolist(), strict=True))) == N_ACTIONS
