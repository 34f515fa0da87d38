"""Numbers of labels that differ between one abstract trace and many, compiled."""

import numpy as np
from numpy.typing import NDArray

from behavexplor.jit import kernel_in_place


@kernel_in_place
def count_differing(
    labels: NDArray[np.uint8], starts: NDArray[np.int64], query: NDArray[np.uint8], differing: NDArray[np.int64]
) -> None:
    """Count the labels in which a query differs from each abstract trace, over their common part.

    Args:
        labels: labels of all abstract traces, one after the other.
        starts: place of the first label of each abstract trace, and of the end of the last one, shape (n + 1,).
        query: labels of the query, shape (length,).
        differing: the numbers, shape (n,); changed in place.
    """
    for i in range(len(differing)):
        first = starts[i]
        count = np.int32(0)  # the processor adds up more of them at once than of longer numbers
        for k in range(min(starts[i + 1] - first, len(query))):
            count += np.int32(labels[first + k] != query[k])
        differing[i] = count
