"""Statistics of the windows of a series, compiled."""

import math

import numpy as np
from numpy.typing import NDArray

from behavexplor.jit import kernel, kernel_inner

Floats = NDArray[np.float64]


@kernel
def fill_statistics(x: Floats, window: int, still: float, filled: Floats) -> None:
    """Fill in the statistics of each attribute in each window; see `behavexplor.behavior.features.merged_states`.

    Args:
        x: states, shape (n, attributes).
        window: number of states in a window.
        still: least deviation in a window that is a movement.
        filled: the statistics of the first attribute, then of the second, and so on, shape
            (n - window + 1, attributes * statistics); changed in place.
    """
    count = filled.shape[1] // x.shape[1]
    for i in range(len(filled)):
        for j in range(x.shape[1]):
            filled[i, j * count : (j + 1) * count] = _statistics(x[i : i + window, j], still)


@kernel_inner
def _statistics(x: Floats, still: float) -> tuple[float, float, float, float, float, float, float, float]:
    """Compute the statistics of one window. All sums run in the order of time."""
    n = len(x)
    total, least, greatest = 0.0, x[0], x[0]
    for value in x:
        total += value
        least, greatest = min(least, value), max(greatest, value)
    mean, squares = total / n, 0.0
    for value in x:
        squares += (value - mean) * (value - mean)
    variance = squares / n
    moved, energy, triples = 0.0, 0.0, 0.0
    for k in range(1, n):
        step = x[k] - x[k - 1]
        moved += abs(step)
        energy += step * step
    for k in range(2, n):
        triples += x[k] * x[k - 1] * x[k - 2]
    deviation = math.sqrt(variance)
    complexity = math.sqrt(energy) / deviation if deviation > still else 0.0
    change, mean_abs_change = ((x[-1] - x[0]) / (n - 1), moved / (n - 1)) if n > 1 else (0.0, 0.0)
    non_linearity = triples / (n - 2) if n > 2 else 0.0
    return mean, variance, least, greatest, change, mean_abs_change, non_linearity, complexity
