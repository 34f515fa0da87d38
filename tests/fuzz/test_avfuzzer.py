"""AVFuzzer step by step, with fitness made by hand."""

from dataclasses import replace
from itertools import groupby

import numpy as np
import pytest

from behavexplor.data.geometry import box_corners, box_distance
from behavexplor.errors import InputError
from behavexplor.fuzz.avfuzzer import AVFuzzer, AVFuzzerOptions, fitness
from behavexplor.judge.specs import Verdict
from tests.fakes import LOGICAL, make_trace
from tests.strategies import random_trace

PASSED, COLLIDED = Verdict({"collision": 1.0}, ()), Verdict({"collision": 0.0}, ("collision",))


def risk(value):
    """A trace of that fitness: an NPC 9 m ahead, box to box, comes nearer at 100 * value m/s (for a moment)."""
    ego = np.array([[0.0, 0, 0], [0.0, 0, 0]])
    npc = np.array([[13.7 + 5 * value, 0, 0], [13.7, 0, 0]])
    return make_trace(ego, [npc])


def test_the_trace_for_these_tests_has_the_fitness_it_should():
    assert fitness(risk(0.5), collided=False) == pytest.approx(0.5)


def start(**options):
    return AVFuzzer(LOGICAL, 0, AVFuzzerOptions(**{"mutation_probability": 1.0, **options}))


def run(search, count, value_of=lambda number: 0.1):
    candidates = []
    for _ in range(count):
        candidates.append(search.ask())
        search.tell(candidates[-1], risk(value_of(candidates[-1].number)), PASSED)
    return candidates


def origins(candidates):
    return [candidate.origin for candidate in candidates]


def changed(candidate, parent):
    return [i for i, (a, b) in enumerate(zip(candidate.npcs, parent.npcs, strict=True)) if a != b]


def test_generations_are_bred_of_the_one_before():
    candidates = run(start(), 12)
    assert origins(candidates) == ["initial"] * 4 + ["global"] * 8
    assert {candidate.parent for candidate in candidates[4:8]} <= set(range(4))
    assert {candidate.parent for candidate in candidates[8:]} <= set(range(4, 8))


def test_roulette_prefers_the_fitter():
    parents = [
        c.parent
        for seed in range(40)
        for c in run(
            AVFuzzer(LOGICAL, seed, AVFuzzerOptions(mutation_probability=1.0, crossover_probability=0.01)),
            8,
            lambda number: 0.9 if number == 2 else 0.1,
        )[4:]
    ]
    assert parents.count(2) / len(parents) == pytest.approx(0.9 / 1.2, abs=0.15)


def test_a_mutation_changes_one_speed_or_the_route_of_one_npc():
    kinds = set()
    for candidate in (candidates := run(start(crossover_probability=0.01), 60))[4:]:
        if candidate.origin != "global":
            continue
        parent = candidates[candidate.parent].scenario
        npcs = changed(candidate.scenario, parent)
        if len(npcs) != 1:  # a repair, or crossover after all
            continue
        new, old = candidate.scenario.npcs[npcs[0]], parent.npcs[npcs[0]]
        speeds = sum(abs(a.speed - b.speed) > 1e-6 for a, b in zip(new.waypoints, old.waypoints, strict=True))
        assert (speeds == 1) != (new.route != old.route)
        kinds.add(new.route != old.route)
    assert kinds == {True, False}


def test_crossover_swaps_one_npc_between_two():
    search = AVFuzzer(LOGICAL, 0, AVFuzzerOptions(crossover_probability=1.0, mutation_probability=0.01))
    initial = run(search, 4)
    npcs = {npc: candidate.number for candidate in initial for npc in candidate.scenario.npcs}
    seen = 0
    for candidate in run(search, 6):
        if candidate.parent is None or candidate.parent >= 4 or candidate.origin != "global":
            continue
        npc = changed(candidate.scenario, initial[candidate.parent].scenario)
        if len(npc) == 1:
            places = [i for c in initial for i, other in enumerate(c.scenario.npcs) if close(other, candidate, npc[0])]
            assert places in ([npc[0]], [])
            seen += bool(places)
    assert seen
    assert npcs


def close(npc, candidate, index):
    other = candidate.scenario.npcs[index]
    return npc.route == other.route and abs(npc.waypoints[3].speed - other.waypoints[3].speed) < 1e-9


def test_individuals_that_nothing_changed_are_not_executed_again():
    """A generation of four then takes fewer executions than four."""
    search = AVFuzzer(LOGICAL, 0, AVFuzzerOptions(patience=50))
    run(search, 60)
    assert search._epoch.generations > 20


def test_a_better_best_after_two_generations_starts_the_local_fuzzer():
    search = start()
    run(search, 8)
    assert search._local is None
    candidates = run(search, 4, lambda number: 0.5 if number == 9 else 0.1)
    assert search._local is not None
    assert search.status() == {"best_fitness": pytest.approx(0.5), "restarts": 0, "local": 1}
    local = run(search, 20, lambda number: 0.9 if number == 30 else 0.2)
    assert origins(local) == ["local"] * 20
    assert {candidate.parent for candidate in local[:4]} == {candidates[1].number}
    assert search._local is None
    assert max(one.fitness for one in search._epoch.population) == pytest.approx(0.9)
    assert run(search, 1)[0].origin == "global"


def test_a_better_best_in_the_second_generation_is_too_early_for_the_local_fuzzer():
    search = start()
    run(search, 8, lambda number: 0.5 if number == 5 else 0.1)
    assert search._local is None
    eager = start(local_after=1)
    run(eager, 8, lambda number: 0.5 if number == 5 else 0.1)
    assert eager._local is not None


def test_the_best_of_the_local_fuzzer_replaces_the_worst():
    search, values = start(), {9: 0.5, 10: 0.1}
    run(search, 12, lambda number: values.get(number, 0.3))
    assert [one.fitness for one in search._epoch.population] == pytest.approx([0.3, 0.5, 0.1, 0.3])
    best = run(search, 20, lambda number: 0.9 if number == 30 else 0.2)[30 - 12]
    assert [one.fitness for one in search._epoch.population] == pytest.approx([0.3, 0.5, 0.9, 0.3])
    assert [one.number for one in search._epoch.population] == [8, 9, best.number, 11]


@pytest.mark.parametrize(("factor", "local"), [(0.0, 0), (2.5, 20)])
def test_the_local_fuzzer_mutates_by_a_factor_more(factor, local):
    """Of its 20 individuals, a share of 0.4 times the factor; the others are not executed again."""
    search = start(crossover_probability=0.01, mutation_probability=0.4, local_factor=factor, patience=1000)
    kinds = origins(run(search, 120, lambda number: 0.1 + number / 1000))
    runs = [len(list(group)) for kind, group in groupby(kinds[:-20]) if kind == "local"]
    assert (runs == []) is (local == 0)
    assert all(length == local for length in runs[:-1])


@pytest.mark.parametrize(("patience", "generations"), [(5, 6), (2, 3)])
def test_a_best_that_does_not_improve_ends_in_a_restart(patience, generations):
    """The first generation's best is an improvement; the next ones' are none."""
    search = start(patience=patience, restart_samples=50)
    candidates = run(search, 4 * generations + 5)
    assert origins(candidates)[4 : 4 * generations] == ["global"] * (4 * generations - 4)
    assert origins(candidates)[4 * generations : -1] == ["restart"] * 4
    assert candidates[-1].origin == "global"
    assert search.status()["restarts"] == 1


def test_a_restart_is_far_from_all_earlier_ones():
    search = start(patience=1, restart_samples=200)
    before = run(search, 8)
    features = search._asker.encoding
    known = features.features(np.array([features.encode(candidate.scenario) for candidate in before]))
    restarted = run(search, 4)
    gaps = [
        np.linalg.norm(features.features(features.encode(candidate.scenario)[None]) - known, axis=1).min()
        for candidate in restarted
    ]
    random = features.features(search._asker.uniform(np.random.default_rng(3), 200))
    typical = np.median(np.linalg.norm(random[:, None] - known[None], axis=2).min(1))
    assert min(gaps) > typical


def test_what_returns_after_a_restart_does_not_count():
    search = start(patience=1, restart_samples=10)
    in_flight = [search.ask() for _ in range(30)]
    for candidate in in_flight:
        search.tell(candidate, risk(0.1), PASSED)
    assert search.status()["restarts"] >= 1
    assert search._epoch.generations == 0


@pytest.mark.parametrize("seed", range(20))
def test_fitness_is_the_largest_over_all_frames_and_npcs(seed):
    trace = random_trace(seed, frames=60)
    expected = 0.0
    ego = box_corners(trace.position[:, 0], trace.heading[:, 0], trace.size[0])
    for npc in range(1, 4):
        gap = box_distance(ego, box_corners(trace.position[:, npc], trace.heading[:, npc], trace.size[npc]))
        speed = np.linalg.norm(trace.velocity[:, npc] - trace.velocity[:, 0], axis=1)
        expected = max(expected, (speed / (gap + 1) ** 2).max())
    assert fitness(trace, collided=False) == pytest.approx(expected, rel=1e-9)


def test_a_collision_is_worth_100_and_its_speed():
    ego = np.array([[0.0, 0, 0], [0.5, 0, 0], [1.0, 0, 0]])
    beside, behind = np.tile([3.0, 1.0, 0.0], (3, 1)), np.array([[-30.0, 0, 0], [-28.0, 0, 0], [-26.0, 0, 0]])
    assert fitness(make_trace(ego, [behind, beside]), collided=True) == pytest.approx(110.0)


def test_without_npcs_there_is_no_risk():
    assert fitness(make_trace(np.zeros((3, 3))), collided=False) == 0


def test_the_verdict_says_what_a_collision_is():
    search = start()
    assert search.tell(search.ask(), risk(0.5), COLLIDED)["fitness"] > 100


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("population", 1),
        ("crossover_probability", 0.0),
        ("mutation_probability", 1.5),
        ("patience", 0),
        ("restart_samples", 3),
        ("local_after", -1),
        ("local_generations", 0),
        ("local_factor", -1.0),
    ],
)
def test_options_out_of_range(option, value):
    with pytest.raises(InputError, match=option):
        replace(AVFuzzerOptions(), **{option: value})
