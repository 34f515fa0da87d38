"""Encounters: what is asked for when, what niches keep, and which niche is worked on."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from behavexplor.data.scripted import ScriptedScenario
from behavexplor.errors import InputError
from behavexplor.fuzz.encounters import AIMED, EMPTY_ROAD, REDRAWN, TUNED, Encounters, EncountersOptions, Niche, tuned
from behavexplor.fuzz.search import UNIFORM, SearchExhausted
from behavexplor.judge.specs import Verdict, judge
from tests.fakes import LOGICAL, make_trace, simulate


def campaign(executions, logical=LOGICAL, seed=0, **options):
    search = Encounters(logical, seed, EncountersOptions(**options))
    candidates = []
    for _ in range(executions):
        candidates.append(search.ask())
        trace = simulate(candidates[-1].scenario, logical)
        search.tell(candidates[-1], trace, judge(trace))
    return search, candidates


def test_the_empty_road_comes_first_then_aimed_vehicles_then_mutants():
    _, candidates = campaign(400, initial=20)
    assert candidates[0].scenario == ScriptedScenario(LOGICAL.name, ())
    assert [candidate.origin for candidate in candidates].count(EMPTY_ROAD) == 1
    assert {candidate.origin for candidate in candidates[1:20]} == {AIMED, UNIFORM}
    assert all(candidate.parent is None for candidate in candidates[:20])
    later = Counter(candidate.origin for candidate in candidates[20:])
    assert later[AIMED] > later[TUNED] > later[REDRAWN] > 10
    assert 15 < later[UNIFORM] < 70
    assert all((candidate.parent is None) == (candidate.origin == UNIFORM) for candidate in candidates[20:])


def test_all_scenarios_after_the_first_have_all_vehicles():
    _, candidates = campaign(120, initial=10)
    assert {len(candidate.scenario.npcs) for candidate in candidates[1:]} == {LOGICAL.n_npcs}


@pytest.mark.parametrize("origin", [TUNED, REDRAWN])
def test_a_mutant_keeps_the_other_vehicles_of_its_parent(origin):
    _, candidates = campaign(300, initial=20)
    for mutant in (candidate for candidate in candidates if candidate.origin == origin):
        parent = candidates[mutant.parent].scenario.npcs
        assert sum(npc in parent for npc in mutant.scenario.npcs) >= min(len(parent), LOGICAL.n_npcs) - 1


def told(search, degree, *, candidate=None, failed=False):
    """Tell a scenario in which a vehicle came alongside, or touched, with the given gap."""
    candidate = candidate or search.ask()
    time = np.arange(0.0, 10.0, 0.05)
    ego = np.stack([8 * time, 0 * time, 0 * time], axis=1)
    beside = ego + (0.0, 2.06 + degree, 0.0)
    trace = replace(make_trace(ego, [beside], destination=ego[-1, :2]), end="collision" if failed else "arrived")
    return search.tell(candidate, trace, Verdict(judge(trace).degrees, ("collision",) if failed else ()))


def test_a_niche_keeps_the_nearest_misses_and_counts_its_failures():
    search = Encounters(LOGICAL, 0, EncountersOptions(elites=2))
    improved = [told(search, degree)["improved"] for degree in (5.0, 3.0, 4.0, 6.0)]
    assert improved == [1, 1, 0, 0]
    ((name, niche),) = search._niches.items()
    assert name == "R1/going-straight/on-the-right/car-sized/moving"
    assert [elite.miss.degree for elite in niche.elites] == pytest.approx([3.01, 4.01])
    assert told(search, -0.1, failed=True)["improved"] == 1
    assert search.status() == {"niches": 1, "failed niches": 1}
    assert [elite.miss.degree for elite in niche.elites] == pytest.approx([0.0, 3.01])


def test_near_and_little_tried_niches_are_worked_on():
    def weight(degree, tries=0.0, failures=0):
        search = Encounters(LOGICAL, 0, EncountersOptions())
        told(search, degree)
        (niche,) = search._niches.values()
        niche.tries, niche.failures = tries, failures
        return niche.weight(0.5)

    assert weight(1.0) > weight(2.0)
    assert weight(1.0) > weight(1.0, tries=1.0) == weight(1.0, failures=2)
    drawn = {"near": weight(0.1), "far": weight(9.0)}
    search = Encounters(LOGICAL, 0, EncountersOptions())
    told(search, 0.1)
    (near,) = search._niches.values()
    search._niches["far"] = far = Niche("R1", near.elites, tries=drawn["near"] / drawn["far"])
    rng = np.random.default_rng(0)
    share = np.mean([search._pick_niche(rng) is near for _ in range(2000)])
    assert share == pytest.approx(near.weight(0.5) / (near.weight(0.5) + far.weight(0.5)), abs=0.04)


def test_an_improvement_makes_up_for_half_of_the_tries():
    search = Encounters(LOGICAL, 0, EncountersOptions())
    told(search, 5.0)
    (niche,) = search._niches.values()
    niche.tries = 8.0
    told(search, 6.0)
    assert niche.tries == 8.0
    told(search, 4.0)
    assert niche.tries == 4.0


def test_candidates_do_not_wait_for_the_empty_road():
    """Many candidates may be in flight before the first result arrives."""
    search = Encounters(LOGICAL, 0, EncountersOptions())
    assert [search.ask().origin for _ in range(9)] == [EMPTY_ROAD] + [UNIFORM] * 8


def test_a_place_without_npcs_has_one_scenario():
    search = Encounters(replace(LOGICAL, n_npcs=0), 0, EncountersOptions())
    assert search.ask().scenario.npcs == ()
    with pytest.raises(SearchExhausted, match="the search space is exhausted"):
        search.ask()


@pytest.mark.parametrize("seed", range(5))
def test_tuned_vehicles_are_valid_and_keep_their_route(seed):
    rng = np.random.default_rng(seed)
    npc = LOGICAL.sample_npc(rng)
    for _ in range(50):
        other = tuned(npc, LOGICAL, rng)
        assert other.route == npc.route
        positions = [waypoint.position for waypoint in other.waypoints]
        assert positions == sorted(positions)
        if LOGICAL.spawn_conflict(other, []) is None:
            LOGICAL.check(ScriptedScenario(LOGICAL.name, (other,)))


@pytest.mark.parametrize("option", [{"uniform_share": 1.5}, {"elites": 0}, {"aiming": {"reach": 0}}, {"near": -1}])
def test_options_out_of_range_are_refused(option):
    with pytest.raises(InputError, match=next(iter(option)) if "aiming" not in option else "reach"):
        EncountersOptions(**option)
