"""NSGA-II: that pymoo is told and asked rightly, here with one candidate in flight and with many."""

import sys
from collections import deque
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest

from behavexplor.errors import InputError
from behavexplor.fuzz.nsga2 import NSGA2, NSGA2Options
from behavexplor.judge.specs import Verdict
from tests.fakes import LOGICAL, make_trace

pytestmark = pytest.mark.skipif(find_spec("pymoo") is None, reason="needs the extra search")

TRACE = make_trace(np.zeros((1, 3)))


def verdict(candidate):
    """Three degrees that conflict in one speed, and one that all would like."""
    speed, other = candidate.scenario.npcs[0].waypoints[0].speed, candidate.scenario.npcs[1].waypoints[0].speed
    return Verdict({"a": speed + other, "b": 12 - speed + other, "c": 1.0 + other}, ())


def run(count, in_flight=1, seed=0, **options):
    search = NSGA2(LOGICAL, seed, NSGA2Options(**{"population": 10, **options}))
    waiting, candidates = deque(), []
    while len(candidates) < count:
        while len(waiting) < in_flight:
            waiting.append(search.ask())
        candidates.append(waiting.popleft())
        search.tell(candidates[-1], TRACE, verdict(candidates[-1]))
    return search, candidates


def test_a_generation_is_as_large_as_the_population():
    search, candidates = run(40)
    assert [candidate.origin for candidate in candidates] == ["initial"] * 10 + ["offspring"] * 30
    assert search.status() == {"generations": 4}


@pytest.mark.parametrize("in_flight", [1, 8, 25])
def test_it_goes_down(in_flight):
    """The degree that no other opposes falls, whatever is in flight; the front stays wide."""
    search, candidates = run(300, in_flight)
    other = [candidate.scenario.npcs[1].waypoints[0].speed for candidate in candidates]
    assert np.mean(other[-50:]) < 0.4 * np.mean(other[:25])
    speeds = [individual.F for individual in search._algorithm.pop]
    assert np.ptp(np.array(speeds)[:, 0]) > 0.2


def test_survivors_are_points_of_what_was_run():
    search, candidates = run(60)
    known = {search._asker.encoding.encode(candidate.scenario).tobytes() for candidate in candidates}
    assert {individual.X.tobytes() for individual in search._algorithm.pop} <= known


@pytest.mark.parametrize("option", ["crossover_eta", "mutation_eta"])
def test_a_large_distribution_index_keeps_genes_near_those_of_parents(option):
    def spread(eta):
        only = 1.0 if option == "crossover_eta" else 0.0
        search, _ = run(10, **{"crossover_probability": only, "mutation_eta": 1e4, option: eta})
        parents = search._algorithm.pop.get("X")
        search.ask()
        children = search._queue[0][0].vectors
        return np.abs(children[:, None] - parents[None]).min(1).max(1).mean()

    assert spread(1e4) < 0.2 * spread(1.0)


def test_without_crossover_children_differ_by_mutation_only():
    search, _ = run(10, crossover_probability=0.0)
    parents = search._algorithm.pop.get("X")
    search.ask()
    children = search._queue[0][0].vectors
    assert (children[:, None] != parents[None]).sum(2).min(1).max() < 12  # of 85 genes


def test_a_missing_pymoo_is_one_sentence(monkeypatch):
    monkeypatch.setitem(sys.modules, "pymoo.core.termination", None)
    with pytest.raises(InputError, match=r"'nsga2' needs pymoo: install the extra 'search'"):
        NSGA2(LOGICAL, 0, NSGA2Options())


@pytest.mark.parametrize(
    ("option", "value"),
    [("population", 3), ("crossover_probability", 1.1), ("crossover_eta", -1.0), ("mutation_eta", -1.0)],
)
def test_options_out_of_range(option, value):
    with pytest.raises(InputError, match=option):
        replace(NSGA2Options(), **{option: value})
