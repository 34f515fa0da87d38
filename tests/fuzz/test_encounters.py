"""Encounters: what is asked for when, what niches keep, and which niche is worked on."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from behavexplor.data.scripted import NPC, ScriptedScenario, Waypoint
from behavexplor.errors import InputError
from behavexplor.fuzz.aiming import AimingOptions, Drive
from behavexplor.fuzz.encounters import (
    AIMED,
    EMPTY_ROAD,
    REDRAWN,
    TUNED,
    Elite,
    Encounters,
    EncountersOptions,
    NearMiss,
    Niche,
    tuned,
)
from behavexplor.fuzz.search import UNIFORM, Candidate, SearchExhausted
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


@pytest.mark.parametrize(
    ("tries", "failures", "degree", "weight"),
    [(0, 0, 0.0, 1.0), (3, 0, 0.0, 1 / 4), (0, 2, 0.0, 1 / 2), (0, 0, 3.0, 1 / 2), (1, 4, 6.0, 1 / 12)],
)
def test_the_weight_of_a_niche_is_that_of_the_page(tries, failures, degree, weight):
    """docs/encounters.md: 1 / ((1 + tries + failures / 2) (1 + d / 3))."""
    miss = NearMiss("R1", "any", degree, 0)
    niche = Niche("R1", [Elite(None, None, miss)], tries, failures)
    assert niche.weight(EncountersOptions().failure_cost) == pytest.approx(weight)


def with_niches(**counts):
    """A search with so many niches of each spec, all alike."""
    search = Encounters(LOGICAL, 0, EncountersOptions())
    for spec, count in counts.items():
        for i in range(count):
            search._niches[f"{spec}/{i}"] = Niche(spec, [Elite(None, None, NearMiss(spec, "any", 1.0, 0))])
    return search


def test_a_spec_is_drawn_by_the_square_root_of_its_number_of_niches():
    search, rng = with_niches(R1=9, R2=1), np.random.default_rng(0)
    drawn = [search._pick_niche(rng).spec for _ in range(2000)]
    assert drawn.count("R2") / 2000 == pytest.approx(1 / 4, abs=0.04)


def near_one():
    """A search, and its parent with the third vehicle as the one that nearly met the ego."""
    search = Encounters(LOGICAL, 0, EncountersOptions(aiming=AimingOptions(draws=1)))
    scenario = LOGICAL.sample(np.random.default_rng(4))
    drive = Drive.of(simulate(scenario))
    return search, Elite(Candidate(0, scenario, UNIFORM, None), drive, NearMiss("R1", "any", 1.0, 2))


def test_half_of_the_mutants_get_an_aimed_vehicle_and_one_in_ten_a_new_one():
    search, elite = near_one()
    rng = np.random.default_rng(0)
    origins = Counter(search._mutate(rng, elite)[1] for _ in range(1000))
    assert [origins[name] / 1000 for name in (AIMED, REDRAWN, TUNED)] == pytest.approx([0.5, 0.1, 0.4], abs=0.05)


def test_mostly_the_vehicle_of_the_near_miss_is_tuned_and_it_stays_in_all_other_mutants():
    search, elite = near_one()
    npcs, rng, tuned_ones = elite.candidate.scenario.npcs, np.random.default_rng(0), []
    for _ in range(1500):
        mutant, origin = search._mutate(rng, elite)
        if origin == TUNED:
            tuned_ones += [i for i, npc in enumerate(mutant) if npc != npcs[i]]
        else:
            assert npcs[2] in mutant
    shares = np.bincount(tuned_ones, minlength=5) / len(tuned_ones)
    assert shares == pytest.approx([0.04, 0.04, 0.84, 0.04, 0.04], abs=0.04)  # 0.8, and a fifth of the rest each


def test_the_nearest_of_the_elites_becomes_the_parent_most_often():
    search = Encounters(LOGICAL, 0, EncountersOptions(initial=4, elites=3, uniform_share=0.0, aimed_share=0.0))
    numbers = []
    for degree in (9.0, 3.0, 1.0, 2.0):  # the first one, the empty road, is soon forgotten
        numbers.append(search.ask())
        told(search, degree, candidate=numbers[-1])
    parents = Counter(search.ask().parent for _ in range(600))
    shares = [1 - np.exp(-1), np.exp(-1) - np.exp(-2), np.exp(-2)]
    assert [parents[number] / 600 for number in (2, 3, 1)] == pytest.approx(shares, abs=0.06)


def test_each_mutant_is_a_try_of_its_niche_and_no_uniform_scenario_is():
    search = Encounters(LOGICAL, 0, EncountersOptions(initial=1, aimed_share=0.0, uniform_share=0.3))
    told(search, 5.0)
    origins = [search.ask().origin for _ in range(30)]
    (niche,) = search.niches.values()
    assert 0 < origins.count(UNIFORM) == 30 - niche.tries < 30


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
        if LOGICAL.first_to_fit([other], []) is not None:
            LOGICAL.check(ScriptedScenario(LOGICAL.name, (other,)))


def test_a_tuned_vehicle_changes_its_speeds_as_a_whole_or_some_waypoints_by_little_or_by_much():
    rng, kinds = np.random.default_rng(0), LOGICAL.vehicle_types
    low, high = LOGICAL.position_ranges(LOGICAL.roadmap.npc_routes[0]).T
    speed = np.array([*[np.mean(LOGICAL.speed_range)] * (len(low) - 1), 0.0])
    places = zip(((low + high) / 2).tolist(), speed.tolist(), strict=True)
    npc = NPC(kinds[0], LOGICAL.roadmap.npc_routes[0].name, tuple(Waypoint(*place) for place in places))
    others = [tuned(npc, LOGICAL, rng) for _ in range(8000)]
    points = np.array([[(one.position, one.speed) for one in other.waypoints] for other in others])
    moved, factor = (points[:, :, 0] - (low + high) / 2) / (high - low), points[:, :-1, 1] / speed[:-1]
    is_whole = (np.ptp(factor, axis=1) < 1e-9) & (moved == 0).all(axis=1) & (factor[:, 0] != 1)
    some_moved, some_changed = moved[~is_whole], factor[~is_whole]
    assert is_whole.mean() == pytest.approx(0.3, abs=0.02)
    assert [(some_moved != 0).mean(), (some_changed != 1).mean()] == pytest.approx([0.5, 0.5], abs=0.02)
    assert np.mean([other.type != npc.type for other in others]) == pytest.approx(0.1 * (1 - 1 / len(kinds)), abs=0.01)
    scale = 10 ** rng.uniform(-2, -0.5, 100_000)
    usual = np.median(np.abs(rng.normal(0, scale)))
    middle = speed[0] * np.exp(rng.normal(0, 2 * scale)) + rng.normal(0, 3 * scale)
    middle = np.clip(middle, *LOGICAL.speed_range)
    assert np.median(np.abs(np.log(factor[is_whole, 0]))) == pytest.approx(usual, rel=0.08)
    assert np.median(np.abs(some_moved[some_moved != 0])) == pytest.approx(usual, rel=0.08)
    sizes = np.abs(np.log(some_changed[some_changed != 1]))
    assert np.median(sizes) == pytest.approx(np.median(np.abs(np.log(middle / speed[0]))), rel=0.08)


@pytest.mark.parametrize("option", [{"uniform_share": 1.5}, {"elites": 0}, {"aiming": {"reach": 0}}, {"near": -1}])
def test_options_out_of_range_are_refused(option):
    with pytest.raises(InputError, match=next(iter(option)) if "aiming" not in option else "reach"):
        EncountersOptions(**option)
