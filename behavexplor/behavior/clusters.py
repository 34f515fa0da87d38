"""Abstract states: clusters of merged states, found by K-means, and distances between sequences of them."""

from functools import cache
from typing import Any, Final, NamedTuple
from warnings import catch_warnings, simplefilter

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from behavexplor.data.array_types import Floats
from behavexplor.jit import kernel_in_place

Labels = NDArray[np.uint8]  # an abstract trace: one abstract state (cluster) per window

MAX_CLUSTERS: Final = 256


class AbstractTraces:
    """Abstract traces one after the other in one array, to compute the distances to all in one pass."""

    def __init__(self) -> None:
        self._labels = np.empty(1024, dtype=np.uint8)
        self._starts = np.zeros(16, dtype=np.int64)  # of each abstract trace, and the end of the last one
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def append(self, labels: Labels) -> None:
        """Add an abstract trace, shape (length,)."""
        end = int(self._starts[self._count]) + len(labels)
        self._labels = _grown(self._labels, end)
        self._starts = _grown(self._starts, self._count + 2)
        self._count += 1
        self._starts[self._count] = end
        self[self._count - 1] = labels

    def __setitem__(self, index: int, labels: Labels) -> None:
        """Replace the labels of an abstract trace. Its length cannot change."""
        self._labels[self._place(index)] = labels

    def __getitem__(self, index: int) -> Labels:
        return self._labels[self._place(index)]

    def _place(self, index: int) -> slice:
        if not 0 <= index < self._count:
            raise IndexError(index)
        return slice(self._starts[index], self._starts[index + 1])

    def distances(self, labels: Labels) -> Floats:
        """Compute the distance of an abstract trace from each of these, `dis` of the paper's equation 9.

        (Hamming distance over the common part + difference of the lengths) / the longer length, in [0, 1]. That of two
        empty traces is 0. There is one distance for each of these.
        """
        distances = np.empty(self._count)
        find_distances(self._labels, self._starts[: self._count + 1], labels, distances)
        return distances


def _grown(array: NDArray[Any], size: int) -> NDArray[Any]:
    """Return an array that has at least the given size. It at least doubles, so that an addition costs little."""
    if size <= len(array):
        return array
    bigger = np.empty(max(size, 2 * len(array)), dtype=array.dtype)
    bigger[: len(array)] = array
    return bigger


@kernel_in_place
def find_distances(
    labels: NDArray[np.uint8], starts: NDArray[np.int64], query: NDArray[np.uint8], distances: Floats
) -> None:
    """Find the distance of a query from each abstract trace, see `AbstractTraces.distances`.

    The labels of all n abstract traces stand one after the other; `starts`, shape (n + 1,), are the places of their
    first labels, and the end of the last one. The distances, shape (n,), are changed in place.
    """
    for i in range(len(distances)):
        first = starts[i]
        count = np.int32(0)  # the processor adds up more of them at once than of longer numbers
        length = starts[i + 1] - first
        for k in range(min(length, len(query))):
            count += np.int32(labels[first + k] != query[k])
        distances[i] = (count + abs(length - len(query))) / max(length, len(query), 1)


class Clusters(NamedTuple):
    """Centers of clusters in scaled features. Scaling subtracts the mean of each feature, then divides by its scale."""

    centers: Floats  # the centers, shape (K, features)
    squares: Floats  # the squared length of each center, shape (K,)
    mean: Floats  # the mean of each feature, shape (features,)
    scale: Floats  # the scale of each feature, shape (features,)

    @property
    def unscaled_centers(self) -> Floats:
        """The centers in features that are not scaled."""
        return self.centers * self.scale + self.mean


def clusters_of(centers: Floats, mean: Floats, scale: Floats) -> Clusters:
    """Return the clusters of some centers; see `Clusters`."""
    return Clusters(centers, (centers**2).sum(1), mean, scale)


def k_means(rows: Floats, clusters: int, starts: list[Floats | str], random_state: int) -> Floats:
    """Find the best centers by K-means from several starts, shape (clusters, features).

    A single thread computes them, so that their last bits do not depend on the machine's number of threads. If there
    are fewer distinct rows than clusters, some centers are equal, and the first of them gets the rows. Rows, shape (n,
    features), may be changed in their last bits. A start is centers, or the name of scikit-learn's way to choose them.
    """
    from sklearn import config_context  # noqa: PLC0415 - slow to import, needed only once a campaign runs
    from sklearn.cluster import KMeans  # noqa: PLC0415
    from sklearn.exceptions import ConvergenceWarning  # noqa: PLC0415

    checked_once = config_context(assume_finite=bool(np.isfinite(rows).all()))
    with _thread_pools().limit(limits=1), checked_once, catch_warnings():
        simplefilter("ignore", ConvergenceWarning)  # too few distinct rows
        fits = [
            KMeans(clusters, init=start, n_init=1, random_state=random_state, copy_x=False).fit(rows)
            for start in starts
        ]
    return np.asarray(min(fits, key=lambda fit: fit.inertia_).cluster_centers_)


@cache
def _thread_pools() -> ThreadpoolController:
    """Return the thread pools of the libraries that are loaded by now, among them those that K-means uses."""
    return ThreadpoolController()
