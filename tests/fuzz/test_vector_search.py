"""What the searches of vectors share: numbers, draws, and no scenario twice."""

from dataclasses import replace

import numpy as np
import pytest

from behavexplor.envs.functional import IntersectionStraightEnv
from behavexplor.errors import InputError
from behavexplor.fuzz.search import draws
from behavexplor.fuzz.vector_search import Asker

LOGICAL = IntersectionStraightEnv.logical


def point(seed=0):
    return np.random.default_rng(seed).random(Asker(LOGICAL, 0).encoding.size)


def test_candidates_are_numbered_and_know_their_parents():
    asker = Asker(LOGICAL, 0)
    candidates = [asker.candidate(point(i), asker.draws(), "made", i - 1 if i else None) for i in range(3)]
    assert [candidate.number for candidate in candidates] == [0, 1, 2]
    assert [candidate.parent for candidate in candidates] == [None, 0, 1]
    assert {candidate.origin for candidate in candidates} == {"made"}


def test_draws_are_those_of_the_next_candidate():
    asker = Asker(LOGICAL, 7)
    for number in range(3):
        assert asker.draws().random() == draws(7, number).random()
        asker.candidate(point(number), asker.draws(), "made")


def test_no_scenario_is_asked_for_twice():
    """A copy gets one new NPC; what else it had stays."""
    asker = Asker(LOGICAL, 0)
    first = asker.candidate(point(), asker.draws(), "made").scenario
    second = asker.candidate(point(), asker.draws(), "made").scenario
    assert sum(a != b for a, b in zip(first.npcs, second.npcs, strict=True)) == 1
    LOGICAL.check(second)


def test_told_is_the_point_of_what_was_run():
    """Also where it was repaired, and where it was changed because it was a copy."""
    asker = Asker(LOGICAL, 0)
    crowded = np.full(asker.encoding.size, 0.4)
    for _ in range(2):
        candidate = asker.candidate(crowded, asker.draws(), "made")
        vector = asker.told(candidate)
        assert not np.allclose(vector, crowded)
        assert vector == pytest.approx(asker.encoding.encode(candidate.scenario))
    with pytest.raises(KeyError):
        asker.told(candidate)


def test_an_exhausted_space_is_said(monkeypatch):
    asker = Asker(LOGICAL, 0)
    only = asker.encoding.decode(point())
    monkeypatch.setattr(asker.encoding, "decode", lambda vector: only)
    asker.candidate(point(), asker.draws(), "made")
    with pytest.raises(InputError, match="No new scenario in 1000 attempts: the search space is exhausted"):
        asker.candidate(point(), asker.draws(), "made")


def test_without_npcs_there_is_nothing_to_search():
    with pytest.raises(InputError, match="has no NPCs"):
        Asker(replace(LOGICAL, n_npcs=0), 0)


def test_the_farthest_points_are_far_from_all_that_was_asked_for():
    asker = Asker(LOGICAL, 0)
    rng = np.random.default_rng(1)
    assert len(asker.farthest(rng, 5, 2)) == 2
    known = [asker.told(asker.candidate(point(i), rng, "made")) for i in range(20)]
    samples = asker.uniform(np.random.default_rng(2), 50)
    features = asker.encoding.features
    gaps = np.linalg.norm(features(samples)[:, None] - features(np.array(known))[None], axis=2).min(1)
    chosen = asker.farthest(np.random.default_rng(2), 50, 3)
    assert np.array_equal(chosen, samples[np.argsort(-gaps)[:3]])
