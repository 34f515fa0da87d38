"""A compiled network of dense layers with tanh between them."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from behavexplor.jit import kernel_in_place

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class DenseNetwork(NamedTuple):
    """The numbers of all layers in flat arrays, for any number of layers.

    Attributes:
        weights: weights of all layers, shape (weights,). In a layer, the weights from the first input to each output
            come first, then those from the second input.
        biases: biases of all layers, shape (outputs of all layers,).
        widths: number of inputs, and number of outputs of each layer, shape (layers + 1,).
    """

    weights: Floats
    biases: Floats
    widths: Ints


def as_network(layers: Sequence[tuple[Floats, Floats]]) -> DenseNetwork:
    """Make a network from the weights, shape (outputs, inputs), and biases, shape (outputs,), of each layer."""
    widths = [layers[0][0].shape[1], *(len(bias) for _, bias in layers)]
    return DenseNetwork(
        weights=np.concatenate([weights.T.ravel() for weights, _ in layers], dtype=np.float64),
        biases=np.concatenate([bias for _, bias in layers], dtype=np.float64),
        widths=np.array(widths, dtype=np.int64),
    )


def evaluate_batch(network: DenseNetwork, seen: Floats) -> Floats:
    """Compute the outputs of a network for each row of inputs, shape (B, outputs).

    The sums run over the inputs in their order, so that no row's last bits depend on the batch or on a library.

    Args:
        network: network to evaluate.
        seen: inputs, shape (B, inputs).
    """
    outputs = np.zeros((len(seen), network.widths[-1]))
    _evaluate_all(network, seen, np.empty((2, int(network.widths.max()))), outputs)
    return outputs


@kernel_in_place
def _evaluate_all(network: DenseNetwork, seen: Floats, room: Floats, outputs: Floats) -> None:
    for i in range(len(seen)):
        row = _fill_outputs(network, seen[i], room)
        for j in range(outputs.shape[1]):
            outputs[i, j] = room[row, j]


@kernel_in_place
def _fill_outputs(network: DenseNetwork, seen: Floats, room: Floats) -> int:
    """Compute the outputs, and return the row of `room` that has them."""
    row = 0
    for i in range(len(seen)):
        room[0, i] = seen[i]
    weight, bias = 0, 0
    for layer in range(len(network.widths) - 1):
        before, width = network.widths[layer], network.widths[layer + 1]
        if layer > 0:
            _squash(room[row], before)
        _add_up(network, weight, bias, room[row], before, room[1 - row], width)
        weight, bias, row = weight + before * width, bias + width, 1 - row
    return row


@kernel_in_place
def _squash(values: Floats, count: int) -> None:
    for i in range(count):
        values[i] = math.tanh(values[i])


@kernel_in_place
def _add_up(
    network: DenseNetwork, weight: int, bias: int, values: Floats, before: int, sums: Floats, width: int
) -> None:
    """Compute the sums of a layer whose numbers begin at `weight` and `bias`; the inner loop runs over its outputs."""
    sums, biases = sums[:width], network.biases[bias : bias + width]
    for j in range(len(sums)):
        sums[j] = biases[j]
    for i in range(before):
        value, weights = values[i], network.weights[weight + i * width : weight + (i + 1) * width]
        for j in range(len(sums)):
            sums[j] += weights[j] * value
