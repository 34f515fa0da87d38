"""Algorithm 1 step by step, with verdicts made by hand."""

from dataclasses import replace
from math import tanh

import numpy as np
import pytest

from behavexplor.campaign.config import read_config
from behavexplor.data.validation import checked
from behavexplor.envs.functional import IntersectionStraightEnv
from behavexplor.errors import InputError
from behavexplor.fuzz.behavexplor import AssessmentOptions, BehAVExplor, BehAVExplorOptions
from behavexplor.fuzz.search import SearchExhausted
from behavexplor.judge.specs import Verdict
from tests.fakes import make_trace, simulate

LOGICAL = IntersectionStraightEnv.logical

OTHER = simulate(LOGICAL.sample(np.random.default_rng(123)))


def verdict(degree, *, failed=False):
    return Verdict({"collision": degree}, ("collision",) if failed else ())


def drive(speed, seconds=20.0):
    x = np.arange(int(seconds * 20)) / 20 * speed
    return make_trace(np.stack([x, 0 * x, 0 * x], axis=1))


def started(trace=OTHER, degree=10.0, **options):
    """A search whose only testcase is candidate 0."""
    search = BehAVExplor(LOGICAL, 0, BehAVExplorOptions(initial_corpus=1, **options))
    search.tell(search.ask(), trace, verdict(degree))
    return search


def tell_next(search, trace, outcome):
    candidate = search.ask()
    return candidate, search.tell(candidate, trace, outcome)


def test_the_initial_corpus_is_sampled_and_has_energy_1():
    search = BehAVExplor(LOGICAL, 0, BehAVExplorOptions())
    for i in range(4):
        candidate, learned = tell_next(search, OTHER, verdict(5.0))
        assert (candidate.number, candidate.origin, candidate.parent) == (i, "initial", None)
        assert learned == {"kept": True}
    assert search._corpus.energies.tolist() == [1.0] * 4
    assert search.ask().parent in range(4)


def test_failures_are_no_testcases_and_one_benign_start_is_enough():
    search = BehAVExplor(LOGICAL, 0, BehAVExplorOptions())
    for _ in range(7):
        candidate, learned = tell_next(search, OTHER, verdict(0.0, failed=True))
        assert candidate.origin == "initial"
        assert learned == {"kept": False}
    tell_next(search, OTHER, verdict(5.0))
    assert search.status()["corpus"] == 1
    assert search.ask().parent == 7


def test_an_ads_that_fails_everywhere_ends_the_search():
    search = BehAVExplor(LOGICAL, 0, BehAVExplorOptions())
    shortest = make_trace(np.zeros((1, 3)))
    for _ in range(1000):
        tell_next(search, shortest, verdict(0.0, failed=True))
    with pytest.raises(SearchExhausted, match="All 1000 initial scenarios failed"):
        search.ask()


def test_a_mutant_nearer_to_a_violation_is_kept_and_rewarded():
    search = started(degree=10.0)
    candidate, learned = tell_next(search, OTHER, verdict(9.5))
    change = tanh((10 - 9.5) / (1 - 0 + 1e-5))  # the same trace: dis = 0
    assert learned["distance"] == learned["novelty"] == 0
    assert learned["kept"]
    assert not learned["novel"]
    assert learned["energy"] == pytest.approx(1 + 0.5 * change)
    assert learned["parent_energy"] == pytest.approx(1 + 0.5 * (-0.1 * 1 / 1) + 0.5 * change - 0.05)
    assert candidate.parent == 0
    energies = learned["energy"], learned["parent_energy"]
    assert search.status() == {
        "corpus": 2,
        "mean_energy": pytest.approx(sum(energies) / 2),
        "max_energy": max(energies),
        "novel_kept": 0,
    }


def test_a_mutant_neither_new_nor_nearer_is_forgotten():
    search = started(degree=10.0)
    for n_passed in (1, 2):
        before = search._corpus.energy(0)
        _, learned = tell_next(search, OTHER, verdict(10.2))
        assert not learned["kept"]
        assert "energy" not in learned
        change = tanh((10 - 10.2) / (1 + 1e-5))
        failure = -0.1 * n_passed / n_passed
        assert learned["parent_energy"] == pytest.approx(before + 0.5 * failure + 0.5 * change - 0.05)
    assert search.status()["corpus"] == 1


def test_failed_mutants_raise_the_parents_energy_and_are_not_kept():
    search = started(degree=10.0)
    tell_next(search, OTHER, verdict(10.0))
    before = search._corpus.energy(0)
    _, learned = tell_next(search, OTHER, verdict(8.0, failed=True))
    change = tanh(2 / (1 + 1e-5))
    assert learned["parent_energy"] == pytest.approx(before + 0.5 * (1 / (1 + 1)) + 0.5 * change - 0.05)
    assert not learned["kept"]
    assert search.status()["corpus"] == 1
    assert search._n_failed == 1


def test_a_novel_mutant_is_kept_though_it_is_farther_from_a_violation():
    search = started(drive(5.0), degree=1.0)
    _, learned = tell_next(search, drive(5.0, seconds=60), verdict(4.0))
    assert learned["novelty"] == learned["distance"] == pytest.approx(2 / 3, abs=0.01)
    assert learned["novel"]
    assert learned["kept"]
    change = tanh((1 - 4) / (1 - learned["distance"] + 1e-5))
    assert learned["energy"] == pytest.approx(1 + 0.5 * change)
    assert search.status()["novel_kept"] == 1
    _, again = tell_next(search, drive(5.0, seconds=60), verdict(4.0))
    assert again["novelty"] == 0


def test_a_novel_failure_does_not_become_known():
    search = started(drive(5.0))
    for _ in range(2):
        _, learned = tell_next(search, drive(5.0, seconds=60), verdict(0.0, failed=True))
        assert learned["novel"]
        assert not learned["kept"]
    assert search.status()["novel_kept"] == 0


def test_a_novel_testcase_refits_the_clusters():
    """A steady drive gives one cluster only: until a novel testcase shows that there is more."""
    search = started(drive(5.0), degree=1.0)
    x = np.cumsum(5 + 5 * np.sin(np.arange(1200) / 40)) / 20
    winding = make_trace(np.stack([x, 0 * x, 0 * x], axis=1))
    behavior, fast, slow = search._miner.describe(winding), 30, 95
    labels = search._miner.abstract(behavior)
    assert labels[fast] == labels[slow]
    assert tell_next(search, winding, verdict(4.0))[1]["novel"]
    labels = search._miner.abstract(behavior)
    assert labels[fast] != labels[slow]


@pytest.mark.parametrize(("known", "novelty"), [("kept", 0.0), ("novel", 1 / 3)])
def test_what_counts_as_known(known, novelty):
    """A testcase kept only for its degree behaves a third otherwise; is that known afterwards?"""
    search = started(drive(5.0, seconds=20), degree=10.0, known=known)
    _, learned = tell_next(search, drive(5.0, seconds=30), verdict(9.0))
    assert learned["kept"]
    assert not learned["novel"]
    _, learned = tell_next(search, drive(5.0, seconds=30), verdict(20.0))
    assert learned["novelty"] == pytest.approx(novelty, abs=0.01)


@pytest.mark.parametrize(("energy", "kind"), [(0.51, "waypoints"), (0.5, "routes"), (-3.0, "routes")])
def test_the_energy_decides_how_boldly_is_mutated(energy, kind):
    search = started(initial_energy=energy)
    for _ in range(10):
        candidate = search.ask()
        assert candidate.origin == kind
        parent = search._corpus[candidate.parent].scenario
        same_routes = [npc.route for npc in candidate.scenario.npcs] == [npc.route for npc in parent.npcs]
        assert same_routes or kind == "routes"


def test_unbounded_as_printed():
    search = started(drive(0.0, seconds=20), degree=10.0, bounded=False)
    _, learned = tell_next(search, make_trace(np.zeros((1, 3))), verdict(9.0))
    assert learned["distance"] == 1.0
    assert learned["energy"] == pytest.approx(1 + 0.5 * 1.0 / 1e-5)


def test_weights():
    search = started(failure_weight=2.0, degree_weight=3.0, selection_weight=4.0)
    _, learned = tell_next(search, OTHER, verdict(9.9))
    change = tanh(0.1 / (1 + 1e-5))
    assert learned["energy"] == pytest.approx(1 + 3 * change)
    assert learned["parent_energy"] == pytest.approx(1 + 2 * -0.1 + 3 * change - 4 * 0.05)


def test_novel_mutants_may_count_as_successes():
    for success, change in (("failed", -0.1), ("failed-or-novel", 1.0)):
        search = started(drive(5.0), degree=10.0, success=success)
        _, learned = tell_next(search, drive(5.0, seconds=60), verdict(10.0))
        assert learned["novel"]
        assert learned["parent_energy"] == pytest.approx(1 + 0.5 * change - 0.05)


def test_which_distance_divides_the_change_of_degree():
    """The mutant behaves as a known testcase does, yet other than its parent."""
    for degree_distance, distance in (("parent", 2 / 3), ("known", 0.0)):
        search = started(drive(5.0, seconds=60), degree=10.0, degree_distance=degree_distance)
        tell_next(search, drive(5.0, seconds=20), verdict(20.0))
        for number, energy in enumerate((1.0, 0.0)):
            search._corpus.set_energy(number, energy)
        candidate, learned = tell_next(search, drive(5.0, seconds=20), verdict(9.9))
        assert candidate.parent == 0
        assert learned["energy"] == pytest.approx(1 + 0.5 * tanh(0.1 / (1 - distance + 1e-5)), abs=1e-3)


def test_points_may_be_kept():
    search = started(point_keep_probability=0.5, waypoint_keep_probability=0.0)
    parent = search._corpus[0].scenario
    stay = [
        a == b
        for _ in range(20)
        for npc, old in zip(search.ask().scenario.npcs, parent.npcs, strict=True)
        for a, b in zip(npc.waypoints[:-1], old.waypoints[:-1], strict=True)
    ]
    assert 0.3 < np.mean(stay) < 0.55  # some of those that moved pushed others on


def test_novelty_threshold():
    for threshold, novel in ((0.3, True), (0.4, False)):
        search = started(drive(5.0, seconds=20), novelty_threshold=threshold)
        _, learned = tell_next(search, drive(5.0, seconds=30), verdict(9.0))
        assert learned["novel"] is novel
    search = started(drive(5.0, seconds=20), novelty_threshold=learned["novelty"])  # the threshold itself
    assert not tell_next(search, drive(5.0, seconds=30), verdict(9.0))[1]["novel"]


@pytest.mark.parametrize("option", ["waypoint_keep_probability", "route_keep_probability"])
def test_keep_probabilities(option):
    energy = 1.0 if option.startswith("waypoint") else 0.0
    search = started(initial_energy=energy, **{option: 0.0})
    parent = search._corpus[0].scenario
    for _ in range(5):
        assert all(a != b for a, b in zip(search.ask().scenario.npcs, parent.npcs, strict=True))


def test_sigmas():
    search = started(sigma_position=1e-3, sigma_speed=1e-6)
    parent = search._corpus[0].scenario
    gaps = [
        (abs(a.position - b.position), abs(a.speed - b.speed))
        for npc, old in zip(search.ask().scenario.npcs, parent.npcs, strict=True)
        for a, b in zip(npc.waypoints, old.waypoints, strict=True)
    ]
    assert 0 < max(gap[0] for gap in gaps) < 0.02
    assert 0 < max(gap[1] for gap in gaps) < 2e-5


def test_early_mutants_of_many_in_flight_are_initial():
    search = BehAVExplor(LOGICAL, 0, BehAVExplorOptions())
    in_flight = [search.ask() for _ in range(10)]
    for candidate in in_flight:
        search.tell(candidate, OTHER, verdict(5.0))
    assert {candidate.origin for candidate in in_flight} == {"initial"}
    assert search.status()["corpus"] == 10


def test_two_mutants_of_one_parent_in_flight():
    search = started()
    first, second = search.ask(), search.ask()
    one = search.tell(first, OTHER, verdict(9.0))
    two = search.tell(second, OTHER, verdict(9.0))
    assert two["parent_energy"] > one["parent_energy"] > 1
    assert search._corpus[0].n_passed == 2


def test_without_behavior_guidance_only_the_degree_counts():
    """The same behaviors, other or not: nobody looks."""
    search = started(drive(5.0), degree=10.0, novelty="none")
    _, learned = tell_next(search, drive(5.0, seconds=60), verdict(11.0))
    assert (learned["novelty"], learned["distance"], learned["novel"], learned["kept"]) == (0.0, 0.0, False, False)
    _, learned = tell_next(search, drive(5.0, seconds=60), verdict(9.0))
    assert learned["kept"]
    assert learned["energy"] == pytest.approx(1 + 0.5 * tanh(1 / (1 + 1e-5)))
    assert len(search._miner) == 0


def test_random_novelty_has_nothing_to_do_with_behavior():
    search = started(drive(5.0), degree=10.0, novelty="random", novelty_threshold=0.75)
    learned = [tell_next(search, drive(5.0), verdict(20.0))[1] for _ in range(200)]
    for name in ("novelty", "distance"):
        values = [entry[name] for entry in learned]
        assert np.mean(values) == pytest.approx(0.5, abs=0.1)
        assert len(set(values)) == 200
    assert sum(entry["novel"] for entry in learned) == pytest.approx(50, abs=25)
    assert all(entry["kept"] == entry["novel"] for entry in learned)
    assert len(search._miner) == 0


def test_random_novelty_depends_on_the_seed_and_the_number_alone():
    def figures(order):
        search = started(drive(5.0), novelty="random")
        in_flight = [search.ask() for _ in range(3)]
        return [search.tell(in_flight[i], drive(speed), verdict(20.0))["novelty"] for i, speed in order]

    assert figures([(0, 1.0), (1, 2.0)]) == figures([(0, 7.0), (1, 8.0)])


def test_uniform_selection_takes_no_notice_of_energy():
    search = BehAVExplor(LOGICAL, 0, BehAVExplorOptions(selection="uniform"))
    for _ in range(4):
        tell_next(search, OTHER, verdict(5.0))
    for number, energy in enumerate((100.0, 1.0, 0.0, -5.0)):
        search._corpus.set_energy(number, energy)
    parents = [search.ask().parent for _ in range(200)]
    assert [parents.count(number) for number in range(4)] == pytest.approx([50] * 4, abs=25)


def test_random_mutation_takes_no_notice_of_energy():
    for energy in (0.1, 5.0):
        search = started(initial_energy=energy, mutation="random")
        kinds = [search.ask().origin for _ in range(100)]
        assert kinds.count("routes") == pytest.approx(50, abs=20)


def test_the_share_of_waypoint_mutations_among_random_ones():
    search = started(mutation="random", waypoint_share=0.9)
    kinds = [search.ask().origin for _ in range(300)]
    assert kinds.count("routes") == pytest.approx(30, abs=15)


def test_without_energy_selection_differs_from_the_other_ablations_in_one_factor_each():
    """From w/o Energy in the mixture of mutations, from BehAVExplor in the selection, for the same mixture."""
    only_selection, neither = (read_config(f"without-energy{name}")["options"] for name in ("-selection", ""))
    assert only_selection == {**neither, "waypoint_share": 0.94}
    assert BehAVExplorOptions().selection != neither["selection"]


@pytest.mark.parametrize("failed", [False, True])
def test_a_route_mutation_may_cost_a_flat_amount_in_place_of_the_terms(failed):
    """And counts neither as failed nor as passed, so that dE_F of later mutants does not know it."""
    search = started(initial_energy=0.4, route_cost=0.1)
    _, learned = tell_next(search, OTHER, verdict(4.0, failed=failed))
    parent = search._corpus[0]
    assert learned["parent_energy"] == pytest.approx(0.4 - 0.1)
    assert (parent.n_failed, parent.n_passed) == (0, 0)


def test_a_waypoint_mutation_has_the_three_terms_whatever_a_route_mutation_costs():
    with_cost, without = (
        tell_next(started(initial_energy=1.0, route_cost=cost), OTHER, verdict(9.0))[1]["parent_energy"]
        for cost in (0.1, None)
    )
    assert with_cost == without == pytest.approx(1 - 0.05 + 0.5 * tanh(1 / (1 + 1e-5)) - 0.05)


def test_energies_may_have_a_lower_limit():
    search = started(initial_energy=0.05, route_cost=0.1, least_energy=0.0)
    assert tell_next(search, OTHER, verdict(10.0))[1]["parent_energy"] == 0.0
    assert tell_next(started(initial_energy=0.05, route_cost=0.1), OTHER, verdict(10.0))[1]["parent_energy"] < 0


def test_the_guard_of_the_denominator():
    """A mutant as far from its parent as possible: a change of 1e-6 is divided by the guard alone."""
    for gamma, change in ((1e-5, tanh(0.1)), (1e-10, 1.0)):
        search = started(drive(0.0, seconds=20), degree=10.0, gamma=gamma, novelty="random")
        search._novelty = lambda *_: (0.0, 1.0)
        _, learned = tell_next(search, drive(0.0), verdict(10.0 - 1e-6))
        assert learned["parent_energy"] == pytest.approx(1 - 0.05 + 0.5 * change - 0.05)


def test_the_preset_released_is_as_the_released_program():
    """Its energies are bounded by tanh and stay at 0 or above, and a route mutation has a flat cost."""
    options = checked(BehAVExplorOptions, read_config("released")["options"], "options")
    assert (options.bounded, options.gamma) == (True, 1e-10)
    assert (options.route_cost, options.least_energy) == (0.1, 0.0)
    assert (options.assessment.box_shrink, options.assessment.destination_from) == (0.2, "box")


def test_mutants_may_start_with_their_gain_and_novelty():
    search = started(drive(5.0), degree=10.0, mutant_energy="degree-and-novelty", degree_weight=0.0)
    _, learned = tell_next(search, drive(5.0, seconds=60), verdict(9.4))
    assert learned["energy"] == pytest.approx(1 + 0.6 / 2 + learned["novelty"] / 2)


def test_the_assessment_guides_in_place_of_the_verdict():
    """It ends 5 m from its destination: a failure to the requirements, not to a search with a threshold of 10 m."""
    missed = Verdict({"collision": 1.0}, ("destination",))
    trace = drive(5.0)
    trace = replace(trace, destination=trace.position[-1, 0] + [5.0, 0.0])
    for threshold, kept in ((None, False), (10.0, True)):
        search = BehAVExplor(
            LOGICAL, 0, BehAVExplorOptions(assessment=AssessmentOptions(destination_threshold=threshold))
        )
        assert search.tell(search.ask(), trace, missed)["kept"] is kept


def test_a_run_that_retreats_is_described_until_then():
    x = np.concatenate([np.arange(200) * 0.4, 80 - np.arange(100) * 0.4])
    trace = replace(make_trace(np.stack([x, 0 * x, 0 * x], axis=1)), destination=np.array([100.0, 0.0]))
    start = replace(drive(8.0, seconds=10), destination=np.array([100.0, 0.0]))
    search = started(start, assessment=AssessmentOptions(retreat=0.06))
    _, learned = tell_next(search, trace, verdict(1.0))
    assert learned["distance"] < 0.1
    assert not learned["kept"]


def test_the_energy_of_a_testcase_far_from_violation_grows():
    """A known weakness: dE_V rewards almost any mutant of a testcase whose degree is great; see docs/methods.md."""
    search = started(degree=1000.0)
    for _ in range(20):
        tell_next(search, OTHER, verdict(20.0))
    far = search._corpus[0]
    assert far.n_passed > 3
    assert search._corpus.energy(0) == pytest.approx(1 + far.n_passed * (0.5 - 0.05 - 0.05))


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("initial_corpus", 0),
        ("novelty_threshold", 1.1),
        ("waypoint_keep_probability", 1.0),
        ("route_keep_probability", -0.1),
        ("point_keep_probability", 1.0),
        ("sigma_position", 0.0),
        ("sigma_speed", -1.0),
        ("waypoint_share", 1.1),
        ("gamma", 0.0),
    ],
)
def test_options_out_of_range(option, value):
    with pytest.raises(InputError, match=option):
        replace(BehAVExplorOptions(), **{option: value})
