"""Standardization of features, compiled: in three passes over the rows instead of ten."""

import math

import numpy as np
from numpy.typing import NDArray

from behavexplor.data.array_types import Floats
from behavexplor.jit import kernel_in_place


@kernel_in_place
def standardize(sample: NDArray[np.float32], least: Floats, mean: Floats, scale: Floats, rows: Floats) -> None:
    """Fill in the mean and the deviation of each feature, and the rows with mean 0 and deviation 1.

    The sums run in the order of the rows, as in numpy.

    Args:
        sample: the features, shape (n, features), n > 0.
        least: least scale of each feature, in place of a smaller deviation, shape (features,).
        mean: zeros, shape (features,); changed in place.
        scale: zeros, shape (features,); changed in place.
        rows: the standardized features, shape (n, features); changed in place.
    """
    count, width = sample.shape
    for i in range(count):
        for j in range(width):
            mean[j] += sample[i, j]
    for j in range(width):
        mean[j] /= count
    for i in range(count):
        for j in range(width):
            deviation = sample[i, j] - mean[j]
            scale[j] += deviation * deviation
    for j in range(width):
        scale[j] = max(math.sqrt(scale[j] / count), least[j])
    for i in range(count):
        for j in range(width):
            rows[i, j] = (sample[i, j] - mean[j]) / scale[j]
