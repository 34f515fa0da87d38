"""Statistics of the windows of a series, and their nearest clusters, compiled.

The windows of a series are computed side by side, so that the processor can treat several of them at once. In each
window, all sums run in the order of time.
"""

import math

import numpy as np
from numpy.typing import NDArray

from behavexplor.behavior.clusters import Clusters
from behavexplor.data.array_types import Floats
from behavexplor.jit import kernel, kernel_inner

MEAN, VARIANCE, LEAST, GREATEST, CHANGE, ABS_CHANGE, NON_LINEARITY, COMPLEXITY = range(8)
N_STATISTICS = 8  # of an attribute


@kernel
def fill_statistics(x: Floats, window: int, still: float, filled: Floats) -> None:
    """Fill in the statistics of each attribute in each window; see `behavexplor.behavior.features.merged_states`.

    Args:
        x: states, shape (attributes, n).
        window: number of states in a window.
        still: least deviation in a window that is a movement.
        filled: the statistics of the first attribute, then of the second, and so on, shape
            (n - window + 1, attributes * statistics); changed in place.
    """
    columns, terms = np.empty((N_STATISTICS, len(filled))), np.empty(x.shape[1])
    for j in range(len(x)):
        _fill(x[j], window, still, terms, columns)
        for i in range(len(filled)):
            for k in range(N_STATISTICS):
                filled[i, j * N_STATISTICS + k] = columns[k, i]


@kernel
def fill_labels(x: Floats, window: int, still: float, clusters: Clusters, labels: NDArray[np.uint8]) -> None:
    """Fill in the cluster whose center is nearest to the statistics of each window, the first of several.

    Args:
        x: states, shape (attributes, n).
        window: number of states in a window.
        still: least deviation in a window that is a movement.
        clusters: clusters of such statistics.
        labels: index of the nearest center for each window, shape (n - window + 1,); changed in place.
    """
    columns, terms = np.empty((N_STATISTICS, len(labels))), np.empty(x.shape[1])
    products = np.zeros((2, len(clusters.centers), len(labels)))  # of even and odd features
    for j in range(len(x)):
        _fill(x[j], window, still, terms, columns)
        first = j * N_STATISTICS
        for k in range(N_STATISTICS):
            _scale(columns[k], clusters.mean[first + k], clusters.scale[first + k])
        for k in range(len(clusters.centers)):
            center = clusters.centers[k, first : first + N_STATISTICS]
            _add_products(columns, 0, center, products[0, k])
            _add_products(columns, 1, center, products[1, k])
    _find_nearest(products, clusters.squares, labels)


@kernel_inner
def _fill(x: Floats, window: int, still: float, terms: Floats, columns: Floats) -> None:
    """Fill in the statistics of one attribute, shape (statistics, windows). Loops are simple, so they are fast.

    Args:
        x: states of the attribute, shape (n,).
        window: number of states in a window.
        still: least deviation in a window that is a movement.
        terms: room for intermediate results, shape (n,).
        columns: the statistics; changed in place.
    """
    count = columns.shape[1]
    columns[:] = 0.0
    _add_up(x, window, columns[MEAN])
    _divide(columns[MEAN], window)
    _add_squares(x, window, columns[MEAN], columns[VARIANCE])
    _divide(columns[VARIANCE], window)
    _find_least(x, 1.0, window, terms, columns[LEAST])
    _find_least(x, -1.0, window, terms, columns[GREATEST])
    if window > 1:
        before, after, changes = x[:-1], x[1:], terms[:-1]
        _subtract(x[window - 1 :], x[:count], columns[CHANGE])
        _divide(columns[CHANGE], window - 1)
        _find_distances(before, after, changes)
        _add_up(changes, window - 1, columns[ABS_CHANGE])
        _divide(columns[ABS_CHANGE], window - 1)
        _multiply(changes, changes, changes)
        _add_up(changes, window - 1, columns[COMPLEXITY])
    if window > 2:
        products = terms[:-2]
        _multiply(x[2:], x[1:-1], products)
        _multiply(products, x[:-2], products)
        _add_up(products, window - 2, columns[NON_LINEARITY])
        _divide(columns[NON_LINEARITY], window - 2)
    _find_complexity(columns[VARIANCE], still, columns[COMPLEXITY])


@kernel_inner
def _add_up(terms: Floats, length: int, sums: Floats) -> None:
    """Add consecutive terms, as many as `length`, to the sum of each window, one after the other."""
    count, whole = len(sums), length - length % 4
    for k in range(0, whole, 4):
        a, b, c, d = terms[k:], terms[k + 1 :], terms[k + 2 :], terms[k + 3 :]
        for i in range(count):
            sums[i] = sums[i] + a[i] + b[i] + c[i] + d[i]
    for k in range(whole, length):
        for i in range(count):
            sums[i] += terms[k + i]


@kernel_inner
def _find_least(x: Floats, sign: float, window: int, room: Floats, least: Floats) -> None:
    """Find the least number in each window, or the greatest one if the sign is -1.

    The least number of a window is the lesser of those of two shorter windows that cover it.
    """
    for i in range(len(x)):
        room[i] = sign * x[i]
    reached = 1  # length of the windows in `room`
    while 2 * reached <= window:
        for i in range(len(x) - 2 * reached + 1):
            room[i] = min(room[i], room[i + reached])
        reached *= 2
    for i in range(len(least)):
        least[i] = sign * min(room[i], room[i + window - reached])


@kernel_inner
def _subtract(values: Floats, others: Floats, differences: Floats) -> None:
    for i in range(len(differences)):
        differences[i] = values[i] - others[i]


@kernel_inner
def _find_distances(values: Floats, others: Floats, distances: Floats) -> None:
    for i in range(len(distances)):
        distances[i] = abs(others[i] - values[i])


@kernel_inner
def _multiply(values: Floats, others: Floats, products: Floats) -> None:
    for i in range(len(products)):
        products[i] = values[i] * others[i]


@kernel_inner
def _divide(values: Floats, by: float) -> None:
    for i in range(len(values)):
        values[i] /= by


@kernel_inner
def _add_squares(x: Floats, length: int, mean: Floats, sums: Floats) -> None:
    """Add the squared deviations from each window's mean to the sum of the window, one after the other."""
    count, whole = len(sums), length - length % 2
    for k in range(0, whole, 2):
        first, second = x[k:], x[k + 1 :]
        for i in range(count):
            a, b = first[i] - mean[i], second[i] - mean[i]
            sums[i] = sums[i] + a * a + b * b
    for k in range(whole, length):
        for i in range(count):
            sums[i] += (x[k + i] - mean[i]) * (x[k + i] - mean[i])


@kernel_inner
def _find_complexity(variance: Floats, still: float, energy: Floats) -> None:
    """Replace the energy of each window by its complexity."""
    for i in range(len(energy)):
        deviation = math.sqrt(variance[i])
        complexity = math.sqrt(energy[i]) / deviation  # also where it is not used, which is faster than to branch
        energy[i] = complexity if deviation > still else 0.0


@kernel_inner
def _scale(values: Floats, mean: float, scale: float) -> None:
    for i in range(len(values)):
        values[i] = (values[i] - mean) / scale


@kernel_inner
def _add_products(columns: Floats, side: int, center: Floats, sums: Floats) -> None:
    """Add the products of one attribute's features and a center's, of the even features or of the odd ones.

    The order of the sums decides between centers that are equally near but for the last bits. It is the order in which
    numpy adds up on most processors.
    """
    a, b, c, d = columns[side], columns[side + 2], columns[side + 4], columns[side + 6]
    u, v, w, x = center[side], center[side + 2], center[side + 4], center[side + 6]
    for i in range(len(sums)):
        sums[i] = sums[i] + d[i] * x + c[i] * w + b[i] * v + a[i] * u


@kernel_inner
def _find_nearest(products: Floats, squares: Floats, labels: NDArray[np.uint8]) -> None:
    for i in range(len(labels)):
        best, least = 0, math.inf
        for k in range(len(squares)):
            distance = squares[k] - 2 * (products[0, k, i] + products[1, k, i])
            if distance < least:
                best, least = k, distance
        labels[i] = best
