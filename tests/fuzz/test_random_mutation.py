"""Random: coins decide, and nothing else does."""

from dataclasses import replace

import numpy as np
import pytest

from behavexplor.errors import InputError
from behavexplor.fuzz.random_mutation import RandomMutation, RandomMutationOptions
from behavexplor.fuzz.search import SearchExhausted
from behavexplor.judge.specs import Verdict
from tests.fakes import LOGICAL, make_trace

SHORT = make_trace(np.zeros((1, 3)))


def verdict(*, failed=False, degree=1.0):
    return Verdict({"collision": degree}, ("collision",) if failed else ())


def run(count, outcome=lambda _: verdict(), seed=0, **options):
    search = RandomMutation(LOGICAL, seed, RandomMutationOptions(**options))
    candidates, kept = [], []
    for _ in range(count):
        candidates.append(search.ask())
        kept.append(search.tell(candidates[-1], SHORT, outcome(candidates[-1]))["kept"])
    return search, candidates, kept


def test_it_begins_with_uniform_scenarios():
    _, candidates, kept = run(10)
    assert [candidate.origin for candidate in candidates[:4]] == ["initial"] * 4
    assert "initial" not in {candidate.origin for candidate in candidates[4:]}
    assert kept[:4] == [True] * 4


def test_it_goes_on_sampling_until_one_passes():
    _, candidates, kept = run(9, lambda candidate: verdict(failed=candidate.number < 6))
    assert [candidate.origin for candidate in candidates[:7]] == ["initial"] * 7
    assert kept[:7] == [False] * 6 + [True]
    assert candidates[7].parent == 6


def test_an_ads_that_fails_everywhere_ends_it():
    search, *_ = run(1000, lambda _: verdict(failed=True))
    with pytest.raises(SearchExhausted, match="All 1000 initial scenarios failed"):
        search.ask()


def test_both_kinds_of_mutation_are_as_likely():
    _, candidates, _ = run(304)
    routes = sum(candidate.origin == "routes" for candidate in candidates)
    assert abs(routes - 150) < 4 * np.sqrt(75)


def test_degrees_do_not_matter():
    one, other = (run(60, lambda _, degree=degree: verdict(degree=degree))[1] for degree in (1.0, 99.0))
    assert one == other


@pytest.mark.parametrize(("probability", "least", "most"), [(0.0, 0, 0), (0.5, 70, 130), (1.0, 200, 200)])
def test_a_mutant_that_passed_is_kept_by_chance(probability, least, most):
    search, candidates, kept = run(204, keep_probability=probability)
    assert least <= sum(kept[4:]) <= most
    assert search.status() == {"corpus": 4 + sum(kept[4:])}
    parents = {candidate.parent for candidate in candidates[4:]}
    assert all(kept[parent] for parent in parents)
    assert (parents <= {0, 1, 2, 3}) is (probability == 0)


def test_failures_are_never_kept():
    _, _, kept = run(100, lambda candidate: verdict(failed=candidate.number >= 4), keep_probability=1.0)
    assert not any(kept[4:])


def test_npcs_and_waypoints_are_mutated_as_said():
    _, candidates, _ = run(60, npc_keep_probability=0.0, sigma_position=1e-3, sigma_speed=1e-6, keep_probability=0.0)
    for candidate in candidates[4:]:
        parent = candidates[candidate.parent].scenario
        assert all(a != b for a, b in zip(candidate.scenario.npcs, parent.npcs, strict=True))
        if candidate.origin == "waypoints":
            pairs = zip(candidate.scenario.npcs, parent.npcs, strict=True)
            gaps = [abs(a.waypoints[2].position - b.waypoints[2].position) for a, b in pairs]
            assert max(gaps) < 0.05


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("initial_corpus", 0),
        ("keep_probability", 1.5),
        ("npc_keep_probability", 1.0),
        ("sigma_position", 0.0),
        ("sigma_speed", 0.0),
    ],
)
def test_options_out_of_range(option, value):
    with pytest.raises(InputError, match=option):
        replace(RandomMutationOptions(), **{option: value})
