"""Estimates of what is left to find, against their formulas by hand and against draws from known populations."""

import math
from collections import Counter

import numpy as np
import pytest

from behavexplor.judge.discovery import Discovery


def test_the_formulas_by_hand():
    """Ten executions, six failures: a class thrice, one twice... and one once."""
    found = Discovery.of(["a", "a", "a", "b", "b", "c"], 10)
    assert (found.executions, found.found) == (10, 3)
    assert found.new_chance == 0.1
    assert found.unseen == 0.0  # with one class seen once, f1 (f1 - 1) is 0
    several = Discovery.of(["a", "a", "b", "c", "d"], 100)
    assert several.new_chance == 0.03
    assert several.unseen == pytest.approx(0.99 * 3 * 2 / (2 * 2))
    assert several.unseen_low < several.unseen < several.unseen_high


def test_nothing_found_or_everything_often_leaves_nothing():
    assert Discovery.of([], 50) == Discovery(50, 0, 0.0, 0.0, 0.0, 0.0)
    assert Discovery.of(["a"] * 9 + ["b"] * 4, 50) == Discovery(50, 2, 0.0, 0.0, 0.0, 0.0, 0)
    assert math.isnan(Discovery.of([], 0).new_chance)


@pytest.mark.parametrize("seed", range(3))
def test_uniform_draws_from_a_known_population(seed):
    """Good-Turing is unbiased, and Chao1 a lower bound on average, whose interval has the truth most of the time."""
    rng = np.random.default_rng(seed)
    share = 0.3 * np.full(40, 1 / 40)  # 40 classes, equally frequent; seven in ten executions pass
    chances, truths, unseen, left, covered = [], [], [], [], []
    for _ in range(200):
        draws = rng.choice(41, size=150, p=[*share, 0.7])
        kinds = [str(kind) for kind in draws if kind < 40]
        found = Discovery.of(kinds, 150)
        missing = 40 - len(Counter(kinds))
        chances.append(found.new_chance)
        truths.append(missing * share[0])
        unseen.append(found.unseen)
        left.append(missing)
        covered.append(found.unseen_low <= missing <= found.unseen_high)
    assert np.mean(chances) == pytest.approx(np.mean(truths), rel=0.1)
    assert np.mean(unseen) == pytest.approx(np.mean(left), rel=0.2)
    assert np.mean(covered) > 0.85


def test_nothing_seen_once_is_no_certainty():
    found = Discovery.of(["a", "a"], 60)
    assert found.new_chance_limit == pytest.approx(-math.log(0.005) / 60)
    assert found.new_chance_limit > 3 / 60  # the rule of three
    assert found.next_limit == 4  # 1 - 2^-5 is the first above 95 %
    assert "at most 8.8%" in found.outlook("uniform")
    assert "at most 4 new classes" in found.outlook("uniform")
    assert Discovery.of(["a"] * 2, 2).new_chance_limit == 1.0


@pytest.mark.parametrize("method", ["behavexplor", "encounters", "nsga2"])
def test_nothing_is_estimated_of_a_guided_search(method):
    assert not any(char.isdigit() for char in Discovery.of(["a", "b"], 100).outlook(method))


@pytest.mark.parametrize("decay", [0.5, 0.8, 0.9, 0.95, 1.0])
@pytest.mark.parametrize("executions", [60, 150, 600])
def test_the_limits_hold_for_populations_of_every_kind(decay, executions):
    """Few frequent and many rare classes, or all alike: what a second campaign adds, and the true chance."""
    rng = np.random.default_rng(executions)
    shares = decay ** np.arange(30)
    shares *= 0.3 / shares.sum()
    held = {"next": 0, "chance": 0}
    for _ in range(400):
        first, second = rng.choice(31, size=(2, executions), p=[*shares, 0.7])
        seen, later = ({int(kind) for kind in draws if kind < 30} for draws in (first, second))
        found = Discovery.of([str(kind) for kind in first if kind < 30], executions)
        held["next"] += len(later - seen) <= found.next_limit
        held["chance"] += sum(shares[kind] for kind in range(30) if kind not in seen) <= found.new_chance_limit
    assert min(held.values()) >= 0.93 * 400
