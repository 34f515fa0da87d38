"""The compiled network is the one that numpy would compute."""

from itertools import pairwise

import numpy as np
import pytest

from behavexplor.ads.learned.driver import as_network, evaluate
from tests.kernel_calls import called_alone

evaluated = called_alone(evaluate)


def layers_of(widths, rng):
    return [(rng.normal(size=(after, before)), rng.normal(size=after)) for before, after in pairwise(widths)]


def evaluate_batch(network, inputs, rows=None):
    rooms = np.full((2, len(inputs), network.widths.max()), np.nan)
    rooms[0, :, : inputs.shape[1]] = inputs
    last = evaluated(network, rooms, np.arange(len(inputs)) if rows is None else np.array(rows))
    return rooms[last, :, : network.widths[-1]]


def outputs(layers, rows):
    for weights, bias in layers[:-1]:
        rows = np.tanh(rows @ weights.T + bias)
    weights, bias = layers[-1]
    return rows @ weights.T + bias


@pytest.mark.parametrize("widths", [(5, 3), (5, 8, 3), (7, 4, 16, 9), (3, 2, 2, 2, 6), (4, 1, 5), (17, 8, 26, 3)])
def test_the_outputs_are_those_of_numpy(widths):
    rng = np.random.default_rng(sum(widths))
    layers, rows = layers_of(widths, rng), rng.normal(size=(200, widths[0]))
    np.testing.assert_allclose(evaluate_batch(as_network(layers), rows), outputs(layers, rows), rtol=0, atol=1e-12)


def test_rows_are_not_mixed_up_and_not_changed():
    rng = np.random.default_rng(2)
    network, rows = as_network(layers_of((6, 10, 7), rng)), rng.normal(size=(50, 6))
    kept = rows.copy()
    together = evaluate_batch(network, rows)
    np.testing.assert_array_equal(rows, kept)
    np.testing.assert_array_equal(evaluate_batch(network, rows[::-1]), together[::-1])
    for i in range(50):
        np.testing.assert_array_equal(evaluate_batch(network, rows[i : i + 1])[0], together[i])
    assert evaluate_batch(network, rows[:0]).shape == (0, 7)


def test_rows_that_are_not_asked_for_are_not_needed():
    rng = np.random.default_rng(3)
    network, rows = as_network(layers_of((5, 6, 6, 2), rng)), rng.normal(size=(4, 5))
    whole = evaluate_batch(network, rows)
    rows[[0, 3]] = np.nan
    np.testing.assert_array_equal(evaluate_batch(network, rows, [1, 2])[1:3], whole[1:3])


def test_weights_begin_with_a_cache_line():
    """Without that, a shipped driver needs up to a tenth more time."""
    rng = np.random.default_rng(0)
    for width in range(1, 40):
        network = as_network(layers_of((5, width, 3), rng))
        assert network.weights.ctypes.data % 64 == 0


@pytest.mark.parametrize("inputs", [1, 7, 8, 9, 16, 30])
def test_the_last_bits_are_those_of_sums_in_the_order_of_the_inputs(inputs):
    rng = np.random.default_rng(inputs)
    layers, rows = layers_of((inputs, 5), rng), rng.normal(size=(20, inputs))
    weights, expected = layers[0][0], np.tile(layers[0][1], (20, 1))
    for i in range(inputs):
        expected += rows[:, i : i + 1] * weights[:, i]
    np.testing.assert_array_equal(evaluate_batch(as_network(layers), rows), expected)
