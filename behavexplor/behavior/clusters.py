"""Clusters of merged states, found by K-means."""

from functools import cache
from typing import NamedTuple
from warnings import catch_warnings, simplefilter

import numpy as np
from threadpoolctl import ThreadpoolController

from behavexplor.data.array_types import Floats


class Clusters(NamedTuple):
    """Centers of clusters in scaled features. Scaling subtracts the mean of each feature, then divides by its scale.

    Attributes:
        centers: the centers, shape (K, features).
        squares: the squared length of each center, shape (K,).
        mean: the mean of each feature, shape (features,).
        scale: the scale of each feature, shape (features,).
    """

    centers: Floats
    squares: Floats
    mean: Floats
    scale: Floats

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
    are fewer distinct rows than clusters, some centers are equal, and the first of them gets the rows.

    Args:
        rows: the rows, which may be changed in their last bits, shape (n, features).
        clusters: number of centers.
        starts: for each start, the centers at its beginning, or the name of scikit-learn's way to choose them.
        random_state: seed of the choices.
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
