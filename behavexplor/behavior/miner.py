"""BehaviorMiner: behaviors as sequences of abstract states, which are found by clustering, and their distances.

Source: paper section 3.2.1. There, the cost of refitting the clusters grows with every behavior. Here, a refit starts
from the centers of the last one, uses a bounded sample of merged states, and happens at growing intervals.
"""

import math
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from typing import Annotated, Any, Final, Literal
from warnings import catch_warnings, simplefilter

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from behavexplor.behavior.features import (
    N_FEATURES,
    NEGLIGIBLE,
    Clusters,
    HeadingFrame,
    Labels,
    Tail,
    merged_states,
    nearest_clusters,
    state_matrix,
)
from behavexplor.data.array_types import Bytes, Floats, Ints, Singles
from behavexplor.data.trace import Trace
from behavexplor.data.validation import between, validated
from behavexplor.errors import InputError
from behavexplor.jit import kernel_in_place

MAX_CLUSTERS: Final = 256  # labels are single bytes
Scaling = Literal["zscore", "none"]


class AbstractTraces:
    """Abstract traces one after the other in one array, to compute the distances to all in one pass."""

    def __init__(self) -> None:
        self._labels = np.empty(1024, dtype=np.uint8)
        self._starts = np.zeros(16, dtype=np.int64)  # of each abstract trace, and the end of the last one
        self._count = 0

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
        self._labels[self._starts[index] : self._starts[index + 1]] = labels

    def distances(self, labels: Labels) -> Floats:
        """Compute the distance of an abstract trace, shape (length,), from each of n added ones, shape (n,).

        (Hamming distance over the common part + difference of the lengths) / longer length, in [0, 1]: `dis` of the
        paper's equation 9. It is 0 for two empty traces.
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
def find_distances(labels: Bytes, starts: Ints, query: Bytes, distances: Floats) -> None:
    """Find the distance of a query from each abstract trace, see `AbstractTraces.distances`.

    `labels` are those of all n abstract traces, one after the other. `starts`, shape (n + 1,), has the place where each
    begins, and the end of the last. `query` has the shape (length,). `distances`, shape (n,), is changed in place.
    """
    for i in range(len(distances)):
        known = labels[starts[i] : starts[i + 1]]  # its indices need no sign, so that the loop can be vectorized
        count = np.int32(0)  # 32 bits: the processor adds up more of them at once than of longer numbers
        for k in range(min(len(known), len(query))):
            count += np.int32(known[k] != query[k])
        distances[i] = (count + abs(len(known) - len(query))) / max(len(known), len(query), 1)


def clusters_of(centers: Floats, mean: Floats, scale: Floats) -> Clusters:
    """Return the clusters with these centers, shape (clusters, features), and their squared lengths."""
    return Clusters(centers, (centers**2).sum(1), mean, scale)


def k_means(rows: Floats, clusters: int, starts: list[Floats | str], random_state: int) -> Floats:
    """Find the best centers by K-means from several starts, shape (clusters, features).

    A single thread computes them, so that their last bits do not depend on the machine's number of threads. If there
    are fewer distinct rows than clusters, some centers are equal, and the first of them gets the rows.

    `rows`, shape (n, features), may change in their last bits. Each of `starts` is the initial centers, or the name of
    scikit-learn's way to choose them, with the seed `random_state`.
    """
    from sklearn import config_context  # noqa: PLC0415 - slow to import, needed only once a campaign runs
    from sklearn.cluster import KMeans  # noqa: PLC0415
    from sklearn.exceptions import ConvergenceWarning  # noqa: PLC0415

    # checked here once, so that scikit-learn need not
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


@validated
class MinerOptions:
    """Options for abstracting behaviors. The defaults are the paper's values, where it states them."""

    window: Annotated[int, between(1)] = 10  # the paper's w, number of states of 0.1 s in a merged state
    tail: Tail = "padded"  # windows at the end of a trace: "padded" with its last state (paper), or "cut"
    heading_frame: HeadingFrame = "route"  # frame of the headings, the ego's "route" or the "world"
    clusters: Annotated[int, between(1, MAX_CLUSTERS)] = 10  # the paper's K, number of abstract states
    # scaling of features before clustering. "zscore" scales every feature to deviation 1, unless it hardly varies at
    # all. With "none", a few features with large values dominate.
    scaling: Scaling = "zscore"
    # relative growth of the number of behaviors after which the clusters are refitted. With 0, they are refitted after
    # every novel behavior (paper). The default keeps the cost of an execution constant. Its novelty decisions agree
    # with the paper's rule more often than that rule agrees with itself under another seed.
    refit_growth: Annotated[float, between(0)] = 0.25
    # greatest number of merged states to which clusters are fitted, a uniform sample of all
    sample_size: Annotated[int, between(1, 1_000_000)] = 20_000
    random_state: Annotated[int, between(0, 2**32 - 1)] = 0  # seed of the clustering and of the sample

    def __post_init__(self) -> None:
        if self.sample_size < self.clusters:
            raise InputError(f"sample_size: must be at least clusters, got {self.sample_size}")


@dataclass(frozen=True)
class Behavior:
    """The ego's behavior in one trace."""

    states: Singles  # the ego's states on an even grid of time, the paper's X-bar, shape (N', 8)
    window: int  # the paper's w, number of states in a window
    tail: Tail  # windows at the end of the trace, see `behavexplor.behavior.features.merged_states`

    @cached_property
    def merged(self) -> Floats:
        """The statistics of each window, the paper's H, shape (windows, 64)."""
        return merged_states(self.states, self.window, self.tail)


@lru_cache(maxsize=2)  # a search method and the novelty archive describe the same trace one after the other
def _describe(trace: Trace, heading_frame: HeadingFrame, window: int, tail: Tail) -> Behavior:
    return Behavior(state_matrix(trace, heading_frame), window, tail)


class BehaviorMiner:
    """The known behaviors with the clusters of their states, to compute the distance of new behaviors.

    Before the first `fit`, there is a single cluster, so behaviors differ by their lengths only.
    """

    def __init__(self, options: MinerOptions) -> None:
        self.options = options
        self._states: list[Singles] = []  # of each behavior
        self._traces = AbstractTraces()
        self._sample = _Sample(options.sample_size, np.random.default_rng(options.random_state))
        self._clusters = clusters_of(np.zeros((1, N_FEATURES)), np.zeros(N_FEATURES), np.ones(N_FEATURES))
        self._fitted_at = 0  # number of behaviors at the latest fit
        self._labeled: tuple[Behavior, Labels] | None = None  # the latest behavior with its abstract trace

    def __len__(self) -> int:
        return len(self._states)

    def describe(self, trace: Trace) -> Behavior:
        """Compute the ego's behavior in a trace."""
        return _describe(trace, self.options.heading_frame, self.options.window, self.options.tail)

    def abstract(self, behavior: Behavior) -> Labels:
        """Compute an abstract trace, the paper's H-hat: the nearest cluster of each merged state, shape (windows,)."""
        if self._labeled is None or self._labeled[0] is not behavior:  # `add` asks again for what was just compared
            self._labeled = behavior, self._labels(behavior.states)
        return self._labeled[1]

    def distances(self, labels: Labels) -> Floats:
        """Compute the distance of an abstract trace from every known behavior, in order of addition; shape (n,)."""
        return self._traces.distances(labels)

    def add(self, behavior: Behavior) -> int:
        """Add a behavior to the known ones, and return its index."""
        self._states.append(behavior.states)
        self._sample.extend(behavior.merged)
        self._traces.append(self.abstract(behavior))
        return len(self._states) - 1

    @property
    def due(self) -> bool:
        """True if enough behaviors were added since the last fit to refit the clusters."""
        return len(self) >= (1 + self.options.refit_growth) * self._fitted_at

    def fit(self) -> None:
        """Fit the clusters to the known behaviors, and recompute the abstract traces of all of them."""
        self._fitted_at = len(self)
        sample = self._sample.rows
        if not len(sample):
            return
        rows, mean, scale = _scaled(sample, self.options.scaling)
        count = min(self.options.clusters, len(rows))
        starts: list[Floats | str] = []
        if len(self._clusters.centers) == count:  # from the last centers
            starts.append((self._clusters.unscaled_centers - mean) / scale)
        if not starts or not self._sample.full:  # and afresh as long as the sample grows
            starts.append("k-means++")
        self._clusters = clusters_of(k_means(rows, count, starts, self.options.random_state), mean, scale)
        self._labeled = None
        for i, states in enumerate(self._states):
            self._traces[i] = self._labels(states)

    def _labels(self, states: Singles) -> Labels:
        return nearest_clusters(states, self.options.window, self.options.tail, self._clusters)


def _scaled(sample: Singles, scaling: Scaling) -> tuple[Floats, Floats, Floats]:
    """Return scaled rows, and the mean and the scale of each feature, see `behavexplor.behavior.features.Clusters`."""
    if scaling == "none":
        return sample.astype(np.float64), np.zeros(N_FEATURES), np.ones(N_FEATURES)
    rows = np.empty(sample.shape)
    mean = np.zeros(N_FEATURES)
    scale = np.zeros(N_FEATURES)
    standardize(sample, NEGLIGIBLE, mean, scale, rows)
    return rows, mean, scale


class _Sample:
    """A uniform sample of all rows added so far, in bounded memory (reservoir sampling)."""

    def __init__(self, size: int, rng: np.random.Generator) -> None:
        self._rows = np.empty((size, N_FEATURES), dtype=np.float32)
        self._seen = 0
        self._rng = rng

    @property
    def full(self) -> bool:
        return self._seen >= len(self._rows)

    @property
    def rows(self) -> Singles:
        return self._rows[: self._seen]

    def extend(self, rows: Floats) -> None:
        """Add rows. Once the sample is full, row number n replaces a random one with probability size / (n + 1)."""
        numbers = np.arange(self._seen, self._seen + len(rows))
        slots = numbers.copy()
        late = numbers >= len(self._rows)
        slots[late] = self._rng.integers(0, numbers[late] + 1)
        kept = slots < len(self._rows)
        self._rows[slots[kept]] = rows[kept]
        self._seen += len(rows)


@kernel_in_place
def standardize(sample: Singles, least: Floats, mean: Floats, scale: Floats, rows: Floats) -> None:
    """Fill in the mean and the deviation of each feature, and the rows with mean 0 and deviation 1.

    The sums run in the order of the rows, as in numpy, but in three passes over the rows instead of ten. `sample` has
    the shape (n, features), n > 0. `least`, shape (features,), replaces smaller deviations. Changed in place: `mean`
    and `scale`, shape (features,), which must be zeros, and `rows`, shape (n, features).
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
