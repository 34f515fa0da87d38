import numpy as np
import pytest

from behavexplor.behavior.miner import MinerOptions
from behavexplor.behavior.novelty import NoveltyArchive
from behavexplor.envs.functional import IntersectionStraightEnv
from tests.fakes import make_trace, simulate

LOGICAL = IntersectionStraightEnv.logical

TRACES = [simulate(LOGICAL.sample(np.random.default_rng(seed))) for seed in range(30)]


def test_the_first_behavior_is_new_and_the_same_again_is_not():
    archive = NoveltyArchive()
    assert archive.observe(TRACES[0]) == 1.0
    assert archive.observe(TRACES[0]) == 0.0
    assert len(archive) == 1


def test_only_what_is_novel_joins():
    archive = NoveltyArchive()
    for trace in TRACES:
        size = len(archive)
        novelty = archive.observe(trace)
        assert 0 <= novelty <= 1
        assert len(archive) - size == (novelty > 0.4)
    assert 1 < len(archive) < len(TRACES)


@pytest.mark.parametrize(("length", "joins"), [(60, False), (50, True), (100, False), (99, False)])
def test_a_behavior_joins_if_it_is_farther_than_four_tenths_from_all(length, joins):
    """With one cluster, by the lengths alone: 60 of 100 states are just so far, and 50 are farther."""
    archive = NoveltyArchive(MinerOptions(clusters=1))
    first, second = (make_trace(np.zeros((n + 1, 3)), time=np.arange(n + 1) / 10) for n in (100, length))
    assert archive.observe(first) == 1.0
    assert archive.observe(second) == (100 - length) / 100
    assert len(archive) == 1 + joins


def test_the_same_traces_have_the_same_novelty():
    first, second = ([archive.observe(trace) for trace in TRACES] for archive in (NoveltyArchive(), NoveltyArchive()))
    assert first == second


def test_its_miner_can_be_set():
    coarse = NoveltyArchive(MinerOptions(clusters=1))
    for _ in range(2):
        for trace in TRACES:
            coarse.observe(trace)
    assert len(coarse) < 5  # with one cluster, behaviors differ by their lengths only


def test_the_shortest_trace_has_a_novelty():
    archive = NoveltyArchive()
    shortest = make_trace(np.zeros((1, 3)))
    assert archive.observe(shortest) == 1.0
    assert archive.observe(shortest) == 0.0
    assert archive.observe(TRACES[0]) == 1.0
