"""A compiled network of dense layers with tanh between them."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from behavexplor.jit import kernel_inner

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


@kernel_inner
def evaluate(network: DenseNetwork, rooms: Floats, rows: Ints) -> int:
    """Compute the outputs of a network for some rows, and return the index of the outputs in `rooms`.

    The sums run over the inputs in their order, so that no row's last bits depend on the batch or on a library.

    Args:
        network: network to evaluate.
        rooms: the inputs in `rooms[0]`, and room for those of other layers, shape (2, B, greatest width); changed in
            place.
        rows: rows for which the outputs are computed, shape (n,).
    """
    weight, bias, now = 0, 0, 0
    for layer in range(len(network.widths) - 1):
        before, width = network.widths[layer], network.widths[layer + 1]
        for row in rows:
            if layer > 0:
                _squash(rooms[now, row], before)
            for j in range(width):
                rooms[1 - now, row, j] = network.biases[bias + j]
        _add_up(network.weights[weight : weight + before * width], rooms[now], before, rooms[1 - now], width, rows)
        weight, bias, now = weight + before * width, bias + width, 1 - now
    return now


@kernel_inner
def _squash(values: Floats, count: int) -> None:
    for i in range(count):
        values[i] = math.tanh(values[i])


@kernel_inner
def _add_up(weights: Floats, values: Floats, inputs: int, sums: Floats, width: int, rows: Ints) -> None:
    """Add the products of the inputs `values` and the weights to the sums of each row's outputs.

    Each weight is used for all rows before the next ones are read from memory, and four inputs are added at a time.
    """
    whole = inputs - inputs % 4
    for i in range(0, whole, 4):
        start = i * width
        a, b = weights[start : start + width], weights[start + width : start + 2 * width]
        c, d = weights[start + 2 * width : start + 3 * width], weights[start + 3 * width : start + 4 * width]
        for row in rows:
            into = sums[row][:width]
            u, v, w, x = values[row, i], values[row, i + 1], values[row, i + 2], values[row, i + 3]
            for j in range(len(into)):
                into[j] = into[j] + a[j] * u + b[j] * v + c[j] * w + d[j] * x
    for i in range(whole, inputs):
        rest = weights[i * width : (i + 1) * width]
        for row in rows:
            into, value = sums[row][:width], values[row, i]
            for j in range(len(into)):
                into[j] += rest[j] * value
