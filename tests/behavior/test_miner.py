from types import SimpleNamespace

import numpy as np
import pytest
from sklearn.cluster import KMeans
from threadpoolctl import threadpool_info, threadpool_limits

from behavexplor.behavior import miner as miner_module
from behavexplor.behavior.features import N_FEATURES, NEGLIGIBLE
from behavexplor.behavior.miner import BehaviorMiner, MinerOptions, _Sample, k_means
from behavexplor.envs.functional import IntersectionStraightEnv
from behavexplor.errors import InputError
from tests.fakes import make_trace, simulate

LOGICAL = IntersectionStraightEnv.logical

TRACES = [simulate(LOGICAL.sample(np.random.default_rng(seed))) for seed in range(12)]


def drive(*speeds, seconds=3.0):
    """A straight drive, some seconds at each speed."""
    speed = np.repeat(speeds, int(seconds * 20))
    x = np.cumsum(speed) / 20
    return make_trace(np.stack([x, 0 * x, 0 * x], axis=1))


def miner_of(traces, **options):
    miner = BehaviorMiner(MinerOptions(**options))
    for trace in traces:
        miner.add(miner.describe(trace))
    miner.fit()
    return miner


def labels_of(miner, trace):
    return miner.abstract(miner.describe(trace))


def test_states_that_differ_fall_into_different_clusters():
    trace = drive(0.0, 10.0, 0.0)
    miner = miner_of([trace], clusters=2, window=1)
    labels = labels_of(miner, trace)
    assert labels[10] == labels[-10]
    assert labels[10] != labels[len(labels) // 2]


def test_labels_are_the_nearest_centers():
    miner = miner_of(TRACES[:5])
    rows = miner.describe(TRACES[0]).merged
    clusters = miner._clusters
    scaled = (rows - clusters.mean) / clusters.scale
    gaps = np.linalg.norm(scaled[:, None] - clusters.centers, axis=2)
    assert labels_of(miner, TRACES[0]).tolist() == gaps.argmin(1).tolist()
    assert set(np.concatenate([labels_of(miner, trace) for trace in TRACES[:5]])) == set(range(10))


def test_scaling():
    rows = np.concatenate([BehaviorMiner(MinerOptions()).describe(trace).merged for trace in TRACES[:5]])
    scaled = miner_of(TRACES[:5])._clusters
    assert scaled.mean == pytest.approx(rows.mean(0), rel=1e-4, abs=1e-4)
    assert scaled.scale == pytest.approx(np.maximum(rows.std(0), NEGLIGIBLE), rel=1e-3, abs=1e-5)
    unscaled = miner_of(TRACES[:5], scaling="none")._clusters
    assert (unscaled.scale == 1).all()
    assert (unscaled.mean == 0).all()


def test_scaling_changes_what_is_seen():
    """Without it the cubes of the speed decide alone; with it a swerve counts, too."""
    scaled, unscaled = (miner_of(TRACES, scaling=scaling, clusters=3) for scaling in ("zscore", "none"))
    assert any(labels_of(scaled, trace).tolist() != labels_of(unscaled, trace).tolist() for trace in TRACES)


def test_distances_are_those_of_the_abstract_traces():
    miner = miner_of(TRACES)
    for i in (0, 5):
        assert miner.distances(labels_of(miner, TRACES[i]))[i] == 0
    a, b = labels_of(miner, TRACES[2]), labels_of(miner, TRACES[3])
    common = min(len(a), len(b))
    expected = ((a[:common] != b[:common]).sum() + abs(len(a) - len(b))) / max(len(a), len(b))
    assert miner.distances(a)[3] == pytest.approx(expected)


def test_a_fit_maps_all_behaviors_anew():
    miner = miner_of(TRACES[:2])
    for trace in TRACES[2:]:
        miner.add(miner.describe(trace))
    miner.fit()
    for i, trace in enumerate(TRACES):
        assert miner.distances(labels_of(miner, trace))[i] == 0  # that of equal abstract traces only


def test_a_better_fit_than_from_scratch_or_as_good():
    """The warm start is no excuse for worse clusters."""
    grown = BehaviorMiner(MinerOptions())
    for trace in TRACES:
        grown.add(grown.describe(trace))
        grown.fit()
    fresh = miner_of(TRACES)

    def inertia(miner):
        rows = np.concatenate([miner.describe(trace).merged for trace in TRACES])
        scaled = (rows - miner._clusters.mean) / miner._clusters.scale
        labels = np.concatenate([labels_of(miner, trace) for trace in TRACES])
        return np.square(scaled - miner._clusters.centers[labels]).sum()

    assert inertia(grown) <= inertia(fresh) * (1 + 1e-6)


@pytest.mark.parametrize(
    ("growth", "fits"), [(0.0, [1, 2, 3, 4, 5, 6, 7, 8]), (0.5, [1, 2, 3, 5, 8]), (1.0, [1, 2, 4, 8])]
)
def test_refits_come_at_growing_intervals(growth, fits):
    miner = BehaviorMiner(MinerOptions(refit_growth=growth))
    seen = []
    for trace in TRACES[:8]:
        miner.add(miner.describe(trace))
        if miner.due:
            seen.append(len(miner))
            miner.fit()
    assert seen == fits


def test_fits_do_not_depend_on_the_number_of_threads(monkeypatch):
    threads = set()

    class Watched(KMeans):
        def fit(self, rows):
            threads.update(pool["num_threads"] for pool in threadpool_info())
            return super().fit(rows)

    monkeypatch.setattr("sklearn.cluster.KMeans", Watched)
    miner_module._thread_pools.cache_clear()  # other tests have loaded further libraries, which K-means does not use
    with threadpool_limits(2):
        miner_of(TRACES[:3])
    assert threads == {1}


def test_a_refit_starts_from_the_centers_of_the_last(monkeypatch):
    """Scaled anew, as features are."""
    miner = miner_of(TRACES[:2])
    last = miner._clusters.centers * miner._clusters.scale + miner._clusters.mean
    starts = []
    monkeypatch.setattr(
        "behavexplor.behavior.miner.k_means", lambda rows, k, tried, seed: starts.extend(tried) or rows[:k]
    )
    miner.add(miner.describe(TRACES[2]))
    miner.fit()
    assert starts[0] * miner._clusters.scale + miner._clusters.mean == pytest.approx(last)
    assert starts[1:] == ["k-means++"]


def test_a_full_sample_is_stable_enough_for_the_warm_start_alone(monkeypatch):
    miner = miner_of(TRACES[:2], sample_size=50)
    starts = []
    monkeypatch.setattr(
        "behavexplor.behavior.miner.k_means", lambda rows, k, tried, seed: starts.extend(tried) or rows[:k]
    )
    miner.fit()
    assert len(starts) == 1
    assert starts[0].shape == (10, N_FEATURES)


def test_the_sample_is_bounded_and_uniform():
    miner = BehaviorMiner(MinerOptions(sample_size=500))
    counts = np.zeros(12)
    for i in range(12):
        behavior = miner.describe(TRACES[i])
        marked = np.full((400, N_FEATURES), float(i))
        miner.add(SimpleNamespace(states=behavior.states, merged=marked))
    rows = miner._sample.rows
    assert rows.shape == (500, N_FEATURES)
    counts = np.bincount(rows[:, 0].astype(int), minlength=12)
    assert counts.min() > 20  # 500 / 12 = 41.7 expected of each, deviation 6
    assert counts.max() < 70


def test_a_large_corpus_is_fitted_to_the_sample():
    miner = miner_of(TRACES, sample_size=100)
    assert len(miner._clusters.centers) == 10
    assert miner.distances(labels_of(miner, TRACES[4]))[4] == 0


@pytest.mark.parametrize("scaling", ["zscore", "none"])
@pytest.mark.parametrize("noise", [0.0, 1e-9, 1e-7])
@pytest.mark.parametrize("distinct", [1, 2, 3])
def test_fewer_distinct_rows_than_clusters(distinct, noise, scaling):
    """Without a warning, and more clusters come with more behaviors."""
    x = np.cumsum(np.repeat(np.linspace(0, 9, distinct), 60)) / 20
    y = np.random.default_rng(0).normal(0, 1, len(x)) * noise
    trace = make_trace(np.stack([x, y, 0 * x], axis=1))
    miner = miner_of([trace, trace], window=1, scaling=scaling)
    assert miner.distances(labels_of(miner, trace)).tolist() == [0, 0]
    miner.add(miner.describe(TRACES[0]))
    miner.fit()
    assert len(set(labels_of(miner, TRACES[0]))) > 4


def test_fewer_rows_than_clusters():
    trace = make_trace(np.cumsum(np.ones((8, 3)), axis=0))
    miner = miner_of([trace])
    assert len(miner._clusters.centers) == 4
    assert miner.distances(labels_of(miner, trace)).tolist() == [0]


@pytest.mark.parametrize("tail", ["padded", "cut"])
@pytest.mark.parametrize("frames", [1, 2, 5])
def test_short_traces(frames, tail):
    short = make_trace(np.zeros((frames, 3)))
    miner = miner_of([short, TRACES[0], short], tail=tail)
    distances = miner.distances(labels_of(miner, short))
    assert distances[[0, 2]].tolist() == [0, 0]
    assert distances[1] > 0.9


def test_nothing_known():
    miner = BehaviorMiner(MinerOptions())
    miner.fit()
    assert len(miner) == 0
    assert len(miner.distances(labels_of(miner, TRACES[0]))) == 0


def test_before_the_first_fit_only_lengths_count():
    miner = BehaviorMiner(MinerOptions())
    miner.add(miner.describe(drive(1.0, seconds=4)))
    assert miner.distances(labels_of(miner, drive(9.0, seconds=4))).tolist() == [0]
    assert miner.distances(labels_of(miner, drive(9.0, seconds=2)))[0] == pytest.approx(0.5, abs=0.03)


def test_jitter_is_no_behavior():
    """On a straight road nothing happens sideways; scaling must not blow up the last digits."""
    noisy = np.zeros((100, 3))
    noisy[:, 0] = np.cumsum(np.repeat([2.0, 8.0], 50)) / 20
    exact = noisy.copy()
    noisy[:, 1:] = np.random.default_rng(0).normal(0, 1e-7, (100, 2))
    miner = miner_of([make_trace(noisy)], clusters=2)
    assert miner.distances(labels_of(miner, make_trace(exact))).tolist() == [0]


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("window", 0),
        ("clusters", 0),
        ("clusters", 257),
        ("refit_growth", -0.1),
        ("sample_size", 9),
        ("sample_size", 0),
        ("sample_size", 1_000_001),
        ("sample_size", 2**63),
        ("random_state", -1),
        ("random_state", 2**32),
    ],
)
def test_options_out_of_range(option, value):
    with pytest.raises(InputError, match=option):
        MinerOptions(**{option: value})


@pytest.mark.parametrize(
    ("option", "values"),
    [
        ("window", (1, 1000)),
        ("clusters", (1, 256)),
        ("refit_growth", (0.0, 9.0)),
        ("sample_size", (10, 1_000_000)),
        ("random_state", (0, 2**32 - 1)),
        ("tail", ("padded", "cut")),
        ("heading_frame", ("route", "world")),
        ("scaling", ("zscore", "none")),
    ],
)
def test_options_at_the_ends_of_their_ranges(option, values):
    assert [getattr(MinerOptions(**{option: value}), option) for value in values] == list(values)
    assert MinerOptions(sample_size=1, clusters=1).sample_size == 1


def test_defaults_are_the_papers_where_it_states_them():
    paper = {"window": 10, "tail": "padded", "clusters": 10}
    own = {"heading_frame": "route", "scaling": "zscore", "refit_growth": 0.25, "sample_size": 20_000}
    assert MinerOptions() == MinerOptions(**paper, **own, random_state=0)


@pytest.mark.parametrize(("size", "rows"), [(1, 2), (1, 3), (2, 5)])
def test_every_row_is_in_the_sample_with_the_same_probability(size, rows):
    """Rows may come one by one or all at once. The shares of 1500 samples lie within five deviations."""
    marked = np.arange(rows)[:, None] * np.ones(N_FEATURES)
    for step in (1, rows):
        kept = np.zeros(rows)
        for seed in range(1500):
            sample = _Sample(size, np.random.default_rng(seed))
            for begin in range(0, rows, step):
                assert sample.full == (begin >= size)
                sample.extend(marked[begin : begin + step])
            assert len({*sample.rows[:, 0]}) == size == len(sample.rows)
            kept[sample.rows[:, 0].astype(int)] += 1
        share = size / rows
        assert np.abs(kept / 1500 - share).max() < 5 * np.sqrt(share * (1 - share) / 1500)


def test_a_sample_that_is_not_full_has_all_rows_in_order():
    sample = _Sample(4, np.random.default_rng(0))
    marked = np.arange(4.0)[:, None] * np.ones(N_FEATURES)
    for count in range(5):
        assert sample.rows.tolist() == marked[:count].tolist()
        assert sample.full == (count == 4)
        sample.extend(marked[count : count + 1])


def test_the_best_of_several_starts_is_kept():
    """Four points in two pairs: a start between the pairs ends in a worse place than one at them."""
    rows = np.array([[0.0, 0.0], [0.0, 1.0], [9.0, 0.0], [9.0, 1.0]])
    good, bad = np.array([[0.0, 0.5], [9.0, 0.5]]), np.array([[4.5, 0.0], [4.5, 1.0]])
    for starts in ([good], [bad, good], [good, bad]):
        assert k_means(rows.copy(), 2, starts, 0) == pytest.approx(good)
    assert k_means(rows.copy(), 2, [bad], 0) == pytest.approx(bad)
    first, again = (k_means(np.random.default_rng(1).normal(size=(99, 3)), 9, ["k-means++"], 5) for _ in range(2))
    assert first.tolist() == again.tolist()


def test_an_abstract_trace_is_that_of_the_behavior_asked_for():
    miner = miner_of(TRACES[:4])
    first, second = (miner.describe(trace) for trace in TRACES[:2])
    expected = [miner.abstract(one).tolist() for one in (first, second)]
    assert [miner.abstract(one).tolist() for one in (first, first, second, second)] == [
        expected[0],
        expected[0],
        expected[1],
        expected[1],
    ]
    assert expected[0] != expected[1]
    assert miner.add(first) == 4
    assert miner.distances(np.array(expected[0], dtype=np.uint8))[4] == 0


def test_as_many_states_as_clusters_are_enough_for_a_sample():
    assert MinerOptions(sample_size=10, clusters=10).sample_size == 10
    with pytest.raises(InputError, match="sample_size: must be at least clusters, got 9"):
        MinerOptions(sample_size=9, clusters=10)
