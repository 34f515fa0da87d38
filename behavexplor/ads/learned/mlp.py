"""A compiled network of dense layers with tanh between them."""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from behavexplor.data.array_types import Floats, Ints
from behavexplor.jit import kernel_inner

_CACHE_LINE: Final = 64  # bytes


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
        weights=_aligned(np.concatenate([weights.T.ravel() for weights, _ in layers], dtype=np.float64)),
        biases=np.concatenate([bias for _, bias in layers], dtype=np.float64),
        widths=np.array(widths, dtype=np.int64),
    )


def _aligned(values: Floats) -> Floats:
    """Return a copy that begins where a cache line begins."""
    # Vectors that lie in two cache lines take longer to read: up to a tenth of the evaluation of a network.
    room = np.empty(len(values) + _CACHE_LINE // values.itemsize)
    skipped = -room.ctypes.data % _CACHE_LINE // values.itemsize
    copy = room[skipped : skipped + len(values)]
    copy[:] = values
    return copy


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

    Each weight is used for all rows before the next ones are read from memory, and eight inputs are added at a time.
    """
    whole = inputs - inputs % 8
    for i in range(0, whole, 8):
        block = weights[i * width : (i + 8) * width].reshape((8, width))
        for row in rows:
            _add_eight(block, values[row, i : i + 8], sums[row, :width])
    for i in range(whole, inputs):
        rest = weights[i * width : (i + 1) * width]
        for row in rows:
            into, value = sums[row, :width], values[row, i]
            for j in range(len(into)):
                into[j] += rest[j] * value


@kernel_inner
def _add_eight(block: Floats, x: Floats, into: Floats) -> None:
    """Add the products of eight inputs `x` and their weights, shape (8, outputs), to a row's sums."""
    a, b, c, d, e, f, g, h = block[0], block[1], block[2], block[3], block[4], block[5], block[6], block[7]
    p, q, r, s, t, u, v, w = x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7]
    for j in range(len(into)):  # one input after the other: the last bits do not depend on how many are added at a time
        first = into[j] + a[j] * p + b[j] * q + c[j] * r + d[j] * s
        into[j] = first + e[j] * t + f[j] * u + g[j] * v + h[j] * w
