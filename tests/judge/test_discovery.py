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


@pytest.mark.parametrize(
    ("seen", "executions", "unseen", "variance"),
    [
        # f1 = 3, f2 = 1, A = 0.99: A 3 2 / (2 2), and the terms of Chao 1987
        ((2, 1, 1, 1), 100, 1.485, 1.485 + 0.9801 * 3 * 25 / 16 + 0.9801 * 9 * 1 * 4 / 64),
        # f1 = 2, f2 = 2, A = 0.9
        ((2, 2, 1, 1, 5), 10, 0.3, 0.3 + 0.81 * 2 * 9 / 36 + 0.81 * 4 * 2 * 1 / 324),
        # f1 = 3, f2 = 0, A = 0.95: without classes seen twice, less A^2 f1^4 / (4 S)
        ((4, 1, 1, 1), 20, 2.85, 2.85 + 0.9025 * 3 * 25 / 4 - 0.9025 * 81 / (4 * 6.85)),
    ],
)
def test_the_interval_of_unseen_classes_is_that_of_chao(seen, executions, unseen, variance):
    """The logarithm of the estimate is about normally distributed."""
    classes = [str(number) for number, count in enumerate(seen) for _ in range(count)]
    spread = math.exp(1.96 * math.sqrt(math.log(1 + variance / unseen**2)))
    found = Discovery.of(classes, executions)
    assert (found.found, found.once) == (len(seen), seen.count(1))
    assert found.unseen == pytest.approx(unseen)
    assert (found.unseen_low, found.unseen_high) == pytest.approx((unseen / spread, unseen * spread))


def test_one_class_seen_once_may_hide_others():
    """f1 = 1, f2 = 0: no estimate, but a variance of A^2 / 4 - A^2 / (4 S); with f2 = 1, of A^2 / 16."""
    assert Discovery.of(["a", "b", "b", "b"], 10).unseen_high == pytest.approx(1.96 * 0.9 * math.sqrt(1 / 4 - 1 / 8))
    assert Discovery.of(["a", "b", "b"], 10).unseen_high == pytest.approx(1.96 * 0.9 / 4)
    assert Discovery.of(["a"], 1) == Discovery(1, 1, 1.0, 0.0, 0.0, 0.0, 1)


def test_limits_are_exact_quantiles():
    """Of a Poisson mean by its definition: as few are seen with a probability of 0.5 %; and of coin tosses."""
    for once in (0, 1, 4):
        found = Discovery(1000, 9, 0.0, 0.0, 0.0, 0.0, once)
        mean = found.new_chance_limit * 1000
        assert sum(math.exp(-mean) * mean**k / math.factorial(k) for k in range(once + 1)) == pytest.approx(0.005)
        # at most k heads before the tail number once + 1
        below = [sum(math.comb(j + once, j) * 0.5 ** (j + once + 1) for j in range(k + 1)) for k in range(40)]
        assert found.next_limit == next(k for k in range(40) if below[k] >= 0.95)


def test_nothing_found_or_everything_often_leaves_nothing():
    assert Discovery.of([], 50) == Discovery(50, 0, 0.0, 0.0, 0.0, 0.0)
    assert Discovery.of(["a"] * 9 + ["b"] * 4, 50) == Discovery(50, 2, 0.0, 0.0, 0.0, 0.0, 0)
    assert math.isnan(Discovery.of([], 0).new_chance)
    assert "with a probability of at most 100.0%" in Discovery.of([], 0).outlook("uniform")


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
