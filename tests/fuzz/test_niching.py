"""Niching: what becomes a parent, and what children are made of."""

from dataclasses import replace

import numpy as np
import pytest

from behavexplor.fuzz.niching import CHILD, Niching, NichingOptions
from behavexplor.fuzz.search import UNIFORM
from behavexplor.judge.closest_approach import Nearness
from behavexplor.judge.specs import Verdict
from tests.fakes import LOGICAL, make_trace

TIME = np.arange(0.0, 3.0, 0.05)
PASSED, FAILED = Verdict({"collision": 1.0}, ()), Verdict({"collision": 0.0}, ("collision",))


def approach(seconds, side=False):
    """A trace whose least time to collision is about so many seconds, with a vehicle ahead or to the right."""
    gap = 10.0 * seconds + 0.68 * 4.9 + 2.2
    ego = np.stack([0 * TIME, 0 * TIME, 0 * TIME], 1)
    npc = np.stack([0 * TIME, gap + 10.0 * (TIME[-1] - TIME), 0 * TIME - np.pi / 2], 1)
    if not side:
        npc = np.stack([gap + 10.0 * (TIME[-1] - TIME), 0 * TIME, 0 * TIME + np.pi], 1)
    return replace(make_trace(ego, [npc]), end="timeout")


def search(**options):
    return Niching(LOGICAL, 0, NichingOptions(**{"initial": 1, "population": 1, **options}))


def tell(method, trace, verdict=PASSED):
    candidate = method.ask()
    method.tell(candidate, trace, verdict)
    return candidate


def child(method):
    """The next candidate that is not uniform."""
    return next(candidate for candidate in iter(method.ask, None) if candidate.origin == CHILD)


def test_the_nearest_miss_becomes_the_parent():
    method = search()
    tell(method, approach(3.0))
    near = tell(method, approach(1.0))
    tell(method, approach(2.0))
    assert child(method).parent == near.number


def test_what_was_seen_often_makes_room_for_what_is_new():
    method = search(penalty=2.0)
    for _ in range(10):
        tell(method, approach(1.0))
    rare = tell(method, approach(3.0, side=True))
    assert child(method).parent == rare.number


def test_without_a_penalty_it_does_not():
    method = search(penalty=0.0)
    first = tell(method, approach(1.0))
    tell(method, approach(3.0, side=True))
    assert child(method).parent == first.number


def uniform_share(uniform, failing):
    """The share of uniform candidates if this share of them is asked for, and every `failing`th of them fails."""
    method, drawn, origins = search(initial=20, uniform=uniform), 0, []
    for _ in range(420):
        candidate = method.ask()
        drawn += candidate.origin == UNIFORM
        fails = candidate.origin == CHILD or (failing and drawn % failing == 0)
        method.tell(candidate, approach(1.0), FAILED if fails else PASSED)
        origins.append(candidate.origin)
    return origins[20:].count(UNIFORM) / 400


def test_the_share_of_uniform_scenarios_is_that_of_their_failures_or_more():
    assert uniform_share(0.0, failing=0) == 0.0
    assert uniform_share(0.0, failing=2) == pytest.approx(0.5, abs=0.12)
    assert uniform_share(0.2, failing=0) == pytest.approx(0.2, abs=0.08)
    assert uniform_share(0.2, failing=2) == pytest.approx(0.5, abs=0.12)


def test_a_child_is_its_parent_with_noise_on_all_genes_or_a_few():
    method = search()
    encoding, parent = method._asker.encoding, tell(method, approach(1.0))
    known = encoding.encode(parent.scenario)
    changes = np.array([np.abs(encoding.encode(child(method).scenario) - known) for _ in range(200)])
    assert (changes > 0).any(axis=1).all()
    assert ((changes > 0).mean(axis=1) < 0.5).mean() == pytest.approx(0.5, abs=0.15)
    assert 0.01 < np.median(changes[changes > 0]) < 0.1


@pytest.mark.parametrize("place", [0.0, 0.5, 1.0])
def test_noise_is_of_any_size_between_a_hundredth_and_a_third_of_a_range(place):
    """And what would leave the range is reflected at its end."""
    method, rng = search(), np.random.default_rng(0)
    parent = np.full(method._asker.encoding.size, place)
    changes = np.abs(np.array([method._child(parent, rng) for _ in range(800)]) - place)
    assert changes.max() <= 1.0
    shares = (changes > 0).mean(axis=1)
    assert (shares == 1).mean() == pytest.approx(0.5, abs=0.05)
    assert shares[shares < 1].mean() == pytest.approx(0.2, abs=0.01)
    sizes = np.log(np.median(changes[shares == 1], axis=1) / 0.6745)  # of deviations, uniform in their magnitude
    assert np.exp(sizes.mean()) == pytest.approx(np.sqrt(0.01 * 0.3), rel=0.15)
    assert sizes.std() == pytest.approx(np.log(0.3 / 0.01) / np.sqrt(12), rel=0.1)


@pytest.mark.parametrize(("times", "is_rare"), [(2, False), (3, True)])
def test_the_penalty_grows_with_the_logarithm_of_how_often_a_niche_was_seen(times, is_rare):
    """The difference in the time left is made up for when a situation was seen e times as often."""
    near, far = approach(1.0), approach(2.0, side=True)
    method = search(penalty=Nearness.of(far, PASSED).time_left - Nearness.of(near, PASSED).time_left)
    first, *_ = [tell(method, near) for _ in range(times)]
    rare = tell(method, far)
    assert child(method).parent == (rare if is_rare else first).number


def test_a_failure_is_better_than_any_near_miss():
    method = search()
    tell(method, approach(0.05))
    failed = tell(method, approach(3.0, side=True), FAILED)
    assert child(method).parent == failed.number
