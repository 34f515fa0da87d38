"""SAMOTA step by step, with objectives made by hand."""

from dataclasses import replace

import numpy as np
import pytest

from behavexplor.errors import InputError
from behavexplor.fuzz.samota import SAMOTA, SAMOTAOptions
from behavexplor.judge.specs import Verdict
from tests.fakes import LOGICAL, make_trace

TRACE = make_trace(np.zeros((1, 3)))
QUICK = {"generations": 10, "local_generations": 10}


def verdict(candidate, search, violated=()):
    """Degrees that a few genes decide: speeds of the first NPC."""
    speeds = search._asker.encoding.encode(candidate.scenario)[search._asker.encoding.speed_genes]
    return Verdict({"a": 5 * abs(speeds[0] - 0.8), "b": 5 * abs(speeds[1] - 0.2)}, violated)


def run(count, seed=0, outcome=verdict, **options):
    search = SAMOTA(LOGICAL, seed, SAMOTAOptions(**{**QUICK, **options}))
    candidates = []
    for _ in range(count):
        candidates.append(search.ask())
        search.tell(candidates[-1], TRACE, outcome(candidates[-1], search))
    return search, candidates


def origins(candidates):
    return [candidate.origin for candidate in candidates]


def test_it_begins_with_scenarios_far_apart_then_searches_globally_and_locally_in_turn():
    """For two objectives: two promising and two uncertain scenarios, then one or more of each objective's best."""
    _, candidates = run(40)
    kinds = origins(candidates)
    assert kinds[:6] == ["initial"] * 6
    assert kinds[6:11] == ["promising"] * 2 + ["uncertain"] * 2 + ["local"]
    switches = [kind for i, kind in enumerate(kinds) if kind != kinds[i - 1] and kind in ("promising", "local")]
    assert switches == ["promising", "local"] * (len(switches) // 2) + ["promising"] * (len(switches) % 2)


def test_initial_scenarios_are_farther_apart_than_uniform_ones():
    def nearest(samples):
        gaps = []
        for seed in range(10):
            search, candidates = run(6, seed, adaptive_samples=samples)
            encoding = search._asker.encoding
            points = encoding.features(np.array([encoding.encode(candidate.scenario) for candidate in candidates]))
            apart = np.linalg.norm(points[:, None] - points[None], axis=2)
            gaps.append(apart[np.triu_indices(6, 1)].min())
        return np.mean(gaps)

    assert nearest(30) > nearest(1)


def test_what_the_surrogates_recommend_is_better_than_what_it_began_with():
    """The mean speed of all NPCs decides one objective, their mean start the other."""

    def broad(candidate, search):
        blocks = search._asker.encoding.encode(candidate.scenario).reshape(5, -1)
        return Verdict(
            {"a": 5 * blocks[:, search._asker.encoding.speed_genes].mean(), "b": 5 * blocks[:, 2].mean()}, ()
        )

    for seed in range(3):
        search, candidates = run(50, seed, broad, generations=100)
        values = np.array([list(broad(candidate, search).degrees.values()) for candidate in candidates])
        told = np.isin(origins(candidates), ["promising", "local"])
        assert (values[told][-10:].min(0) < values[:6].min(0) - 0.3).all()


def test_covered_objectives_are_left_alone():
    search, candidates = run(9, outcome=lambda c, s: verdict(c, s, ("a",) if c.number == 2 else ()))
    assert search._uncovered.tolist() == [1]
    assert origins(candidates)[6:9] == ["promising", "uncertain", "local"]


def test_when_all_is_covered_all_is_searched_again():
    search, _ = run(7, outcome=lambda c, s: verdict(c, s, ("a",) if c.number < 6 else ("b",)))
    assert search._uncovered.tolist() == [0, 1]
    assert search.status() == {"searches": 1, "uncovered": 2}


def test_local_search_stays_within_the_best_executions():
    search, candidates = run(80, local_share=0.2)
    for candidate in candidates[60:]:
        if candidate.origin != "local":
            continue
        vector = search._asker.encoding.encode(candidate.scenario)
        earlier = np.array(search._vectors[: candidate.number])
        inside = (vector >= earlier.min(0) - 1e-6) & (vector <= earlier.max(0) + 1e-6)
        assert inside.mean() > 0.95  # but for categories, and what was repaired


def test_clusters_are_searched_one_by_one():
    """Two far clumps among the best give two local scenarios for one objective."""
    search = SAMOTA(LOGICAL, 0, SAMOTAOptions(**QUICK, local_share=1.0))
    rng, size = np.random.default_rng(0), search._asker.encoding.size
    clumps = np.concatenate([np.full((10, size), 0.2), np.full((10, size), 0.8)]) + rng.normal(0, 1e-3, (20, size))
    found = search._local(clumps, rng.random((20, 1)), rng)
    assert sorted(round(float(vector.mean()), 1) for vector, _ in found) == [0.2, 0.8]


def test_a_large_database_is_learned_from_in_part():
    search = SAMOTA(LOGICAL, 0, SAMOTAOptions(database_limit=20))
    values = np.random.default_rng(0).random((100, 3))
    rows = search._training_rows(values, np.random.default_rng(1))
    assert len(set(rows)) == 20
    assert set(np.argsort(values.min(1))[:10]) <= set(rows)
    assert search._training_rows(values[:20], np.random.default_rng(1)).tolist() == list(range(20))


def test_children_are_made_of_their_parents():
    search = SAMOTA(LOGICAL, 0, SAMOTAOptions(mutation_probability=0.001, crossover_probability=0.5))
    size = search._asker.encoding.size
    parents = np.stack([np.full(size, 0.2), np.full(size, 0.8)])
    children = search._children(parents, 200, np.random.default_rng(0))
    assert np.isin(children.round(9), [0.2, 0.8]).mean() > 0.99
    blocks = children.reshape(200, 5, -1)
    assert (np.ptp(blocks, axis=2) == 0).mean() > 0.95  # whole NPCs
    mixed = np.ptp(blocks.mean(2), axis=1) > 0.5
    assert 0.3 < mixed.mean() < 0.6


def test_noise():
    search = SAMOTA(LOGICAL, 0, SAMOTAOptions(mutation_probability=0.2, mutation_sigma=0.1))
    parent = np.full((1, search._asker.encoding.size), 0.5)
    children = search._children(parent, 500, np.random.default_rng(0))
    moved = children != 0.5
    assert moved.mean() == pytest.approx(0.2, abs=0.01)
    assert (children[moved] - 0.5).std() == pytest.approx(0.1, abs=0.005)
    assert ((children >= 0) & (children <= 1)).all()


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("population", 1),
        ("cluster_size", 1),
        ("local_population", 1),
        ("adaptive_samples", 0),
        ("generations", 0),
        ("local_generations", 0),
        ("database_limit", 5),
        ("local_limit", 5),
        ("local_share", 0.0),
        ("crossover_probability", 1.1),
        ("mutation_probability", 0.0),
        ("mutation_sigma", 2.0),
    ],
)
def test_options_out_of_range(option, value):
    with pytest.raises(InputError, match=option):
        replace(SAMOTAOptions(), **{option: value})
