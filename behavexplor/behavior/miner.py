"""BehaviorMiner: traces become sequences of abstract states, which can be compared.

Source: paper section III-B1. A refit of the clusters would cost more with every behavior; here it starts from the
centers of the last one, looks at a bounded sample of merged states, and comes at growing intervals.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal
from warnings import catch_warnings, simplefilter

import numpy as np
from numpy.typing import NDArray

from behavexplor.behavior.distance import MAX_CLUSTERS, AbstractTraces, Labels
from behavexplor.behavior.features import N_FEATURES, NEGLIGIBLE, HeadingFrame, Tail, merged_states, state_matrix
from behavexplor.data.trace import Trace
from behavexplor.fuzz.options import check_range

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class MinerOptions:
    """How behaviors are abstracted; the defaults are the paper's where it says.

    Attributes:
        window: the paper's w, states of 0.1 s merged into one.
        tail: "padded": windows at the end of a trace repeat its last state (paper); "cut": there are none.
        heading_frame: headings relative to the ego's "route", or to the "world".
        clusters: the paper's K, number of abstract states.
        scaling: "zscore": every feature is scaled to deviation 1 before clustering, unless it hardly varies at
            all; "none": a few features with large values decide alone.
        refit_growth: the clusters are fitted anew once there are this share more behaviors; 0: whenever asked
            (paper). The default keeps the cost of an execution constant, and its novelty decisions agree with
            the paper's rule more often than those of two random states of that rule agree with each other.
        sample_size: most merged states that clusters are fitted to; a uniform sample of all is kept.
        random_state: of the clustering.

    Raises:
        InputError: naming the option that is out of range.
    """

    window: int = 10
    tail: Tail = "padded"
    heading_frame: HeadingFrame = "route"
    clusters: int = 10
    scaling: Literal["zscore", "none"] = "zscore"
    refit_growth: float = 0.25
    sample_size: int = 20_000
    random_state: int = 0

    def __post_init__(self) -> None:
        check_range("window", self.window, 1)
        check_range("clusters", self.clusters, 1, MAX_CLUSTERS)
        check_range("refit_growth", self.refit_growth, 0)
        check_range("sample_size", self.sample_size, self.clusters)


@dataclass(frozen=True)
class Behavior:
    """What the ego did in one trace.

    Attributes:
        states: the paper's X-bar, shape (N', 8).
        merged: the paper's H, shape (windows, 64).
    """

    states: NDArray[np.float32]
    merged: Floats


@lru_cache(maxsize=2)  # a search method and the novelty archive look at the same trace one after the other
def _describe(trace: Trace, heading_frame: HeadingFrame, window: int, tail: Tail) -> Behavior:
    states = state_matrix(trace, heading_frame)
    return Behavior(states, merged_states(states, window, tail))


class BehaviorMiner:
    """Known behaviors, their clusters, and distances to them.

    Before the first `fit` all states are alike, and behaviors differ by their lengths only.
    """

    def __init__(self, options: MinerOptions) -> None:
        self.options = options
        self._states: list[NDArray[np.float32]] = []
        self._traces = AbstractTraces()
        self._sample = _Sample(options.sample_size, np.random.default_rng(options.random_state))
        self._clusters = _Clusters(np.zeros((1, N_FEATURES)), np.zeros(N_FEATURES), np.ones(N_FEATURES))
        self._fitted_at = 0

    def __len__(self) -> int:
        return len(self._states)

    def describe(self, trace: Trace) -> Behavior:
        """The behavior in a trace."""
        return _describe(trace, self.options.heading_frame, self.options.window, self.options.tail)

    def abstract(self, merged: Floats) -> Labels:
        """The abstract trace, the paper's H-hat: the nearest cluster of each merged state.

        Args:
            merged: shape (windows, 64).

        Returns:
            Shape (windows,).
        """
        return self._clusters.nearest(merged)

    def distances(self, labels: Labels) -> Floats:
        """The distance of an abstract trace to every known behavior, in the order they were added; shape (n,)."""
        return self._traces.distances(labels)

    def add(self, behavior: Behavior) -> int:
        """Make a behavior known; returns its index."""
        self._states.append(behavior.states)
        self._sample.extend(behavior.merged)
        self._traces.append(self.abstract(behavior.merged))
        return len(self._states) - 1

    @property
    def due(self) -> bool:
        """Whether enough behaviors were added since the last fit for another one."""
        return len(self) >= (1 + self.options.refit_growth) * self._fitted_at

    def fit(self) -> None:
        """Fit the clusters to the known behaviors, and map all of these anew."""
        self._fitted_at = len(self)
        rows = self._sample.rows.astype(np.float64)
        if not len(rows):
            return
        count = min(self.options.clusters, len(rows))
        mean, scale = np.zeros(N_FEATURES), np.ones(N_FEATURES)
        if self.options.scaling == "zscore":
            mean, scale = rows.mean(0), np.maximum(rows.std(0), NEGLIGIBLE)
        starts: list[Floats | str] = []
        if len(self._clusters.centers) == count:
            starts.append((self._clusters.unscaled_centers - mean) / scale)
        if not starts or not self._sample.full:
            starts.append("k-means++")
        centers = _k_means((rows - mean) / scale, count, starts, self.options.random_state)
        self._clusters = _Clusters(centers, mean, scale)
        for i, states in enumerate(self._states):
            self._traces[i] = self.abstract(merged_states(states, self.options.window, self.options.tail))


@dataclass(frozen=True)
class _Clusters:
    """Centers of clusters, shape (K, 64), in features of which `mean` was taken off before division by `scale`."""

    centers: Floats
    mean: Floats
    scale: Floats

    @property
    def unscaled_centers(self) -> Floats:
        return self.centers * self.scale + self.mean

    def nearest(self, merged: Floats) -> Labels:
        """Indices of the nearest centers, shape (windows,). Sums in a fixed order: no thread decides a tie."""
        products = np.einsum("nf,kf->nk", (merged - self.mean) / self.scale, self.centers)
        return np.asarray(((self.centers**2).sum(1) - 2 * products).argmin(1), dtype=np.uint8)


class _Sample:
    """A uniform sample of all rows ever seen, in bounded memory (reservoir sampling)."""

    def __init__(self, size: int, rng: np.random.Generator) -> None:
        self._rows = np.empty((size, N_FEATURES), dtype=np.float32)
        self._seen = 0
        self._rng = rng

    @property
    def full(self) -> bool:
        return self._seen >= len(self._rows)

    @property
    def rows(self) -> NDArray[np.float32]:
        return self._rows[: self._seen]

    def extend(self, rows: Floats) -> None:
        numbers = np.arange(self._seen, self._seen + len(rows))
        slots = numbers.copy()
        late = numbers >= len(self._rows)
        slots[late] = self._rng.integers(0, numbers[late] + 1)
        kept = slots < len(self._rows)
        self._rows[slots[kept]] = rows[kept]
        self._seen += len(rows)


def _k_means(rows: Floats, clusters: int, starts: list[Floats | str], random_state: int) -> Floats:
    """The best centers that K-means finds from several starts, shape (clusters, features).

    One thread computes them, so that their last bits do not depend on how many the machine has. Where fewer rows
    differ than there are clusters, some centers are equal and the first of them gets the rows.
    """
    from sklearn.cluster import KMeans  # noqa: PLC0415 - slow to import, needed only once a campaign runs
    from sklearn.exceptions import ConvergenceWarning  # noqa: PLC0415
    from threadpoolctl import threadpool_limits  # noqa: PLC0415

    with threadpool_limits(limits=1), catch_warnings():
        simplefilter("ignore", ConvergenceWarning)  # too few distinct rows
        fits = [
            KMeans(clusters, init=start, n_init=1, random_state=random_state, copy_x=False).fit(rows)
            for start in starts
        ]
    return np.asarray(min(fits, key=lambda fit: fit.inertia_).cluster_centers_)
