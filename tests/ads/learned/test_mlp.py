"""The compiled network is the one that numpy would compute."""

from itertools import pairwise

import numpy as np
import pytest

from behavexplor.ads.learned.mlp import as_network, decide_batch


def layers_of(widths, rng):
    return [(rng.normal(size=(after, before)), rng.normal(size=after)) for before, after in pairwise(widths)]


def outputs(layers, rows):
    for weights, bias in layers[:-1]:
        rows = np.tanh(rows @ weights.T + bias)
    weights, bias = layers[-1]
    return rows @ weights.T + bias


@pytest.mark.parametrize("widths", [(5, 3), (5, 8, 3), (7, 4, 16, 9), (3, 2, 2, 2, 6), (4, 1, 5)])
def test_the_decision_is_the_greatest_output(widths):
    rng = np.random.default_rng(sum(widths))
    layers, rows = layers_of(widths, rng), rng.normal(size=(200, widths[0]))
    expected = outputs(layers, rows)
    decisions = decide_batch(as_network(layers), rows)
    np.testing.assert_array_equal(decisions, expected.argmax(axis=1))
    assert len(np.unique(decisions)) > 1


def test_of_equal_outputs_it_is_the_first():
    layers = [(np.zeros((4, 2)), np.array([0.0, 1.0, 1.0, 0.5]))]
    assert decide_batch(as_network(layers), np.ones((3, 2))).tolist() == [1, 1, 1]


def test_rows_are_not_mixed_up_and_not_changed():
    rng = np.random.default_rng(2)
    network, rows = as_network(layers_of((6, 10, 7), rng)), rng.normal(size=(50, 6))
    kept = rows.copy()
    together = decide_batch(network, rows)
    np.testing.assert_array_equal(rows, kept)
    np.testing.assert_array_equal(decide_batch(network, rows[::-1]), together[::-1])
    assert [decide_batch(network, rows[i : i + 1])[0] for i in range(50)] == together.tolist()
    assert decide_batch(network, rows[:0]).shape == (0,)
