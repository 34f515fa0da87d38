"""Statistics of the windows of a series, and their nearest clusters, compiled.

The windows of a series are computed side by side, so that the processor can treat several of them at once. In each
window, all sums run in the order of time.
"""

import math

import numpy as np
from numpy.typing import NDArray

from behavexplor.behavior.clusters import Clusters
from behavexplor.jit import kernel, kernel_inner

Floats = NDArray[np.float64]

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
    columns = np.empty((N_STATISTICS, len(filled)))
    for j in range(len(x)):
        _fill(x[j], window, still, columns)
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
    columns = np.empty((N_STATISTICS, len(labels)))
    products = np.zeros((2, len(clusters.centers), len(labels)))  # of even and odd features
    for j in range(len(x)):
        _fill(x[j], window, still, columns)
        first = j * N_STATISTICS
        for k in range(N_STATISTICS):
            _scale(columns[k], clusters.mean[first + k], clusters.scale[first + k])
        for k in range(len(clusters.centers)):
            center = clusters.centers[k, first : first + N_STATISTICS]
            _add_products(columns, 0, center, products[0, k])
            _add_products(columns, 1, center, products[1, k])
    _find_least(products, clusters.squares, labels)


@kernel_inner
def _fill(x: Floats, window: int, still: float, columns: Floats) -> None:
    """Fill in the statistics of one attribute, shape (statistics, windows). Loops are simple, so they are fast."""
    count = columns.shape[1]
    columns[:] = 0.0
    columns[LEAST], columns[GREATEST] = math.inf, -math.inf
    for k in range(window):
        _add(x[k : k + count], columns[MEAN])
        _extend(x[k : k + count], columns[LEAST], columns[GREATEST])
    _divide(columns[MEAN], window)
    for k in range(window):
        _add_squares(x[k : k + count], columns[MEAN], columns[VARIANCE])
    for k in range(1, window):
        _add_steps(x[k - 1 : k - 1 + count], x[k : k + count], columns[ABS_CHANGE], columns[COMPLEXITY])
    for k in range(2, window):
        _add_triples(x[k : k + count], x[k - 1 : k - 1 + count], x[k - 2 : k - 2 + count], columns[NON_LINEARITY])
    _divide(columns[VARIANCE], window)
    if window > 1:
        _subtract(x[window - 1 : window - 1 + count], x[:count], columns[CHANGE])
        _divide(columns[CHANGE], window - 1)
        _divide(columns[ABS_CHANGE], window - 1)
    if window > 2:
        _divide(columns[NON_LINEARITY], window - 2)
    _find_complexity(columns[VARIANCE], still, columns[COMPLEXITY])


@kernel_inner
def _add(values: Floats, sums: Floats) -> None:
    for i in range(len(sums)):
        sums[i] += values[i]


@kernel_inner
def _subtract(values: Floats, others: Floats, differences: Floats) -> None:
    for i in range(len(differences)):
        differences[i] = values[i] - others[i]


@kernel_inner
def _divide(values: Floats, by: float) -> None:
    for i in range(len(values)):
        values[i] /= by


@kernel_inner
def _extend(values: Floats, least: Floats, greatest: Floats) -> None:
    for i in range(len(least)):
        least[i] = min(least[i], values[i])
        greatest[i] = max(greatest[i], values[i])


@kernel_inner
def _add_squares(values: Floats, mean: Floats, sums: Floats) -> None:
    for i in range(len(sums)):
        sums[i] += (values[i] - mean[i]) * (values[i] - mean[i])


@kernel_inner
def _add_steps(before: Floats, after: Floats, moved: Floats, energy: Floats) -> None:
    for i in range(len(moved)):
        moved[i] += abs(after[i] - before[i])
        energy[i] += (after[i] - before[i]) * (after[i] - before[i])


@kernel_inner
def _add_triples(third: Floats, second: Floats, first: Floats, sums: Floats) -> None:
    for i in range(len(sums)):
        sums[i] += third[i] * second[i] * first[i]


@kernel_inner
def _find_complexity(variance: Floats, still: float, energy: Floats) -> None:
    """Replace the energy of each window by its complexity."""
    for i in range(len(energy)):
        deviation = math.sqrt(variance[i])
        energy[i] = math.sqrt(energy[i]) / deviation if deviation > still else 0.0


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
def _find_least(products: Floats, squares: Floats, labels: NDArray[np.uint8]) -> None:
    for i in range(len(labels)):
        best, least = 0, math.inf
        for k in range(len(squares)):
            distance = squares[k] - 2 * (products[0, k, i] + products[1, k, i])
            if distance < least:
                best, least = k, distance
        labels[i] = best
