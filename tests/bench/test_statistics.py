"""Statistics against worked examples, and against what their definitions say counted out."""

import itertools
import math
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from behavexplor.bench.statistics import (
    a12,
    compare,
    compare_together,
    estimate,
    holm,
    least_p,
    mann_whitney,
    size,
    van_elteren,
)
from behavexplor.bench.table import mean, novelty

LEAST = {(3, 3): 0.1, (5, 5): 2 / 252, (2, 7): 2 / 36, (10, 10): 2 / 184756, (1, 9): 1.0}
few = st.lists(st.integers(0, 6), min_size=2, max_size=4)


def test_an_estimate_is_the_mean_with_students_interval():
    found = estimate([1, 2, 3, 4, 5])
    assert (found.n, found.mean) == (5, 3.0)
    half = 2.7764451 * math.sqrt(2.5 / 5)  # t of 4 degrees of freedom, from the printed tables
    assert (found.low, found.high) == pytest.approx((3 - half, 3 + half))


def test_an_interval_is_cut_where_no_value_can_be():
    found = estimate([0.5, -0.9], least=-1.0, most=1.0)
    assert (found.low, found.high) == (-1.0, 1.0)
    assert estimate([1, 9]).low == 0.0
    assert mean([SimpleNamespace(novelty_rate=rate) for rate in (0.9, 1.0)], novelty).high == 100.0
    assert mean([SimpleNamespace(novelty_rate=rate) for rate in (0.9, 1.0)], lambda one: one.novelty_rate).high > 1.0


def test_one_value_has_no_interval_and_equal_ones_an_empty_one():
    assert math.isnan(estimate([4]).low)
    assert math.isnan(estimate([4]).high)
    assert (estimate([4, 4, 4]).low, estimate([4, 4, 4]).high) == (4, 4)


def test_a12_of_a_worked_example_with_a_tie_and_unequal_sizes():
    """3 exceeds 1; 4 exceeds 1 and ties with 4; 5 exceeds 1 and 4: 4.5 of 12 pairs."""
    assert a12([3, 4, 5], [1, 4, 6, 7]) == 4.5 / 12


@given(few, few)
def test_a12_counts_pairs(first, second):
    pairs = list(itertools.product(first, second))
    assert a12(first, second) == pytest.approx(sum(1.0 if x > y else 0.5 * (x == y) for x, y in pairs) / len(pairs))
    assert a12(first, second) + a12(second, first) == pytest.approx(1)


@pytest.mark.parametrize(
    ("effect", "word"),
    [(0.5, "negligible"), (0.55, "negligible"), (0.56, "small"), (0.36, "medium"), (0.71, "large"), (0.0, "large")],
)
def test_sizes_are_those_of_vargha_and_delaney(effect, word):
    assert size(effect) == word


@pytest.mark.parametrize(
    ("first", "second", "p"),
    [
        ([1, 2, 3], [4, 5, 6], 2 / 20),
        ([1, 2, 3, 4, 5], [6, 7, 8, 9, 10], 2 / 252),
        ([1, 2, 3, 4, 7], [5, 6, 8, 9, 10], 8 / 252),  # U = 2: 4 of 252 arrangements have no greater one
        ([2, 2], [2, 2, 2], 1.0),
        ([1], [2, 2, 3, 4], 1.0),
    ],
)
def test_mann_whitney_of_worked_examples(first, second, p):
    assert mann_whitney(first, second) == pytest.approx(p)
    assert mann_whitney(second, first) == pytest.approx(p)


@given(few, few)
def test_mann_whitney_counts_arrangements_also_with_ties(first, second):
    together = first + second

    def u(chosen):
        rest = [together[i] for i in range(len(together)) if i not in chosen]
        return a12([together[i] for i in chosen], rest) * len(first) * len(second)

    every = [u(chosen) for chosen in itertools.combinations(range(len(together)), len(first))]
    seen = u(tuple(range(len(first))))
    below, above = (sum(values) / len(every) for values in zip(*((x <= seen, x >= seen) for x in every), strict=True))
    assert mann_whitney(first, second) == pytest.approx(min(1.0, 2 * min(below, above)))


def test_large_samples_with_ties_are_approximated():
    assert mann_whitney([1, 1, 2, 3] * 5, [1, 2, 2, 3] * 5) > 0.2
    assert mann_whitney([1, 1, 2, 3] * 5, [6, 6, 7, 8] * 5) < 1e-6


@pytest.mark.parametrize(("n", "m"), LEAST)
def test_no_p_is_less_than_that_of_samples_that_do_not_overlap(n, m):
    assert mann_whitney(range(n), range(n, n + m)) == pytest.approx(least_p(n, m)) == pytest.approx(LEAST[n, m])


def test_holm_of_a_worked_example():
    """Sorted: 0.005 x 4, 0.01 x 3, 0.03 x 2, and 0.04 x 1, which is raised to the one before it."""
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.6, 0.9]) == [1.0, 1.0]
    assert holm([]) == []


@given(st.lists(st.floats(0, 1), max_size=8), st.floats(0.001, 0.2))
def test_holm_rejects_what_its_procedure_rejects(ps, level):
    rejected = set()
    for rank, i in enumerate(sorted(range(len(ps)), key=lambda i: ps[i])):
        if (len(ps) - rank) * ps[i] > level:
            break
        rejected.add(i)
    assert {i for i, p in enumerate(holm(ps)) if p <= level} == rejected


def test_a_comparison_says_so_where_methods_cannot_be_told_apart():
    apart, alike = compare([(range(10, 20), range(10)), (range(10), range(10))])
    assert apart.verdict == "more, large"
    assert apart.effect == 1.0
    assert apart.corrected == pytest.approx(2 * apart.p)
    assert alike.verdict == "not distinguishable"
    fewer, _ = compare([(range(8), range(10, 20)), ([1, 2], [1, 2])])
    assert fewer.verdict == "fewer, large"
    assert (fewer.n, fewer.means) == ((8, 10), (3.5, 14.5))


@given(few, few)
def test_van_elterens_test_of_one_stratum_is_mann_whitneys(first, second):
    if len({*first, *second}) > 1:
        expected = stats.mannwhitneyu(first, second, method="asymptotic", use_continuity=False).pvalue
        assert van_elteren([(first, second)]) == pytest.approx(expected)


def test_van_elterens_test_agrees_with_all_arrangements_of_two_strata():
    """The exact p-value counts those of 20 x 35 arrangements whose weighted rank sums lie as far from their mean."""
    strata = [([4, 5, 6], [1, 2, 3]), ([3, 5, 6, 7], [1, 2, 4])]
    weighted = []
    for first, second in strata:
        ranks = range(1, len(first) + len(second) + 1)
        sums = [sum(chosen) for chosen in itertools.combinations(ranks, len(first))]
        weighted.append([(rank_sum - sum(sums) / len(sums)) / (len(ranks) + 1) for rank_sum in sums])
    observed = (15 - 10.5) / 7 + (3 + 5 + 6 + 7 - 16) / 8
    totals = [abs(a + b) for a, b in itertools.product(*weighted)]
    exact = sum(total >= observed - 1e-9 for total in totals) / len(totals)
    assert van_elteren(strata) == pytest.approx(exact, abs=0.006)


def test_many_small_differences_together_are_one_that_shows():
    strata = [([2, 3, 5, 6], [1, 2, 3, 4])] * 6
    assert min(mann_whitney(*stratum) for stratum in strata) > 0.1
    (found,) = compare_together([strata])
    assert found.effect == pytest.approx(a12(*strata[0]))
    assert found.p == found.corrected < 0.01
    assert compare_together([[([1, 1], [1, 1])]])[0].p == 1


def test_opposite_differences_together_are_none():
    assert van_elteren([([1, 2, 3], [4, 5, 6]), ([4, 5, 6], [1, 2, 3])]) == pytest.approx(1)
