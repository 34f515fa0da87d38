"""Intervals and sequences hold as often as they say, computed exactly wherever that is possible."""

import math

import numpy as np
import pytest
import scipy

from behavexplor.errors import InputError
from behavexplor.judge.rates import (
    ALPHA,
    INFERIOR,
    NON_INFERIOR,
    Decision,
    Goal,
    PairedSequence,
    RateSequence,
    clopper_pearson,
)

RATES = [1e-4, 1e-3, 0.01, 0.05, 0.2, 0.5]
SEQUENCES = [RateSequence(), RateSequence.for_rate(0.001), RateSequence.for_rate(0.05)]
LOOKS = 2000


def ever_excluded(sequence, rate, looks=LOOKS):
    """The exact probability that a sequence excludes the true rate at one of its first looks."""
    alive, lost = np.array([1.0]), 0.0  # by the number of failures
    for n in range(1, looks + 1):
        alive = np.append(alive * (1 - rate), 0.0) + np.append(0.0, alive * rate)
        gone = sequence.excludes(rate, np.arange(n + 1), n)
        lost += alive[gone].sum()
        alive[gone] = 0.0
    return lost


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("sequence", SEQUENCES)
def test_a_sequence_ever_misses_the_rate_with_at_most_its_probability(sequence, rate):
    assert ever_excluded(sequence, rate) <= ALPHA


def test_an_ordinary_interval_that_is_looked_at_often_misses_it_far_more_often():
    class Ordinary:
        def excludes(self, rate, failed, n):
            low = np.nan_to_num(scipy.stats.beta.ppf(ALPHA / 2, failed, n - failed + 1), nan=0.0)
            high = np.nan_to_num(scipy.stats.beta.ppf(1 - ALPHA / 2, failed + 1, n - failed), nan=1.0)
            return (rate < low) | (rate > high)

    assert ever_excluded(Ordinary(), 0.2, 120) > 2 * ALPHA


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("n", [1, 20, 500])
def test_an_exact_interval_misses_the_rate_with_at_most_its_probability(rate, n):
    ends = np.array([clopper_pearson(k, n) for k in range(n + 1)])
    missed = (rate < ends[:, 0]) | (rate > ends[:, 1])
    assert scipy.stats.binom.pmf(np.arange(n + 1), n, rate)[missed].sum() <= ALPHA


@pytest.mark.parametrize("sequence", SEQUENCES)
@pytest.mark.parametrize(("failed", "n"), [(0, 1), (0, 5000), (1, 1), (3, 40), (40, 40), (2500, 5000)])
def test_an_interval_is_what_is_not_excluded(sequence, failed, n):
    low, high = sequence.interval(failed, n)
    assert low <= failed / n <= high
    for rate in np.linspace(0.001, 0.999, 500):
        assert sequence.excludes(rate, failed, n) == (rate <= low or rate >= high)


@pytest.mark.parametrize(("failed", "n", "alpha"), [(0, 20, 0.05), (3, 40, 0.05), (3, 40, 0.01), (40, 40, 0.05)])
def test_an_exact_interval_has_beta_quantiles_for_ends(failed, n, alpha):
    low = scipy.stats.beta.ppf(alpha / 2, failed, n - failed + 1) if failed else 0.0
    high = scipy.stats.beta.ppf(1 - alpha / 2, failed + 1, n - failed) if failed < n else 1.0
    assert clopper_pearson(failed, n, alpha) == pytest.approx((low, high))
    assert clopper_pearson(3, 40) == clopper_pearson(3, 40, 0.05) == clopper_pearson(3, 40, ALPHA)


@pytest.mark.parametrize(("a", "b", "alpha"), [(0.5, 10.0, 0.05), (2.0, 3.0, 0.2)])
def test_a_rate_is_excluded_from_the_ratio_of_robbins_on(a, b, alpha):
    """B(k + a, n - k + b) / B(a, b) / (p^k (1 - p)^(n - k)) >= 1 / alpha, with gamma functions by hand."""

    def log_beta(x, y):
        return math.lgamma(x) + math.lgamma(y) - math.lgamma(x + y)

    sequence, decided = RateSequence(a, b, alpha), set()
    for failed, n in ((0, 9), (0, 300), (2, 9), (30, 60), (9, 9)):
        for rate in (0.001, 0.02, 0.3, 0.6, 0.99):
            likelihood = failed * math.log(rate) + (n - failed) * math.log(1 - rate)
            log_ratio = log_beta(failed + a, n - failed + b) - log_beta(a, b) - likelihood
            assert sequence.excludes(rate, failed, n) == (log_ratio >= math.log(1 / alpha))
            decided.add(log_ratio >= math.log(1 / alpha))
        low, high = sequence.interval(failed, n)
        ends = [end for end in (low, high) if 0 < end < 1]
        assert all(sequence.excludes(end, failed, n) for end in ends)
        assert not sequence.excludes(low * (1 + 1e-9) + 1e-11, failed, n)
        assert not sequence.excludes(high * (1 - 1e-9) - 1e-11, failed, n)
    assert decided == {True, False}
    assert RateSequence() == RateSequence(0.5, 10.0, 0.05)
    assert RateSequence.for_rate(0.01) == RateSequence(0.5, pytest.approx(100 / 3), 0.05)
    assert RateSequence.for_rate(0.01, 0.2).alpha == 0.2


def test_without_scenarios_nothing_is_known():
    assert RateSequence().interval(0, 0) == (0.0, 1.0)


@pytest.mark.parametrize(("sequence", "expected"), [(RateSequence.for_rate(1e-4), 43129), (RateSequence(), 74671)])
def test_the_number_of_scenarios_that_show_a_rate_below_one_in_ten_thousand(sequence, expected):
    n = np.arange(1, 100_000)
    assert int(n[sequence.excludes(1e-4, 0, n)][0]) == pytest.approx(expected, abs=2)


def wrong(margin, worse, better, pairs):
    """The exact probability that a paired sequence ever says non-inferior, by the differences of its pairs."""
    chances = {1: worse, -1: better, 0: 1 - worse - better}
    alive, lost = {(0, 0): 1.0}, 0.0  # by the numbers of pairs in which the new driver is worse, and better
    verdicts = {}
    for n in range(1, pairs + 1):
        following = {}
        for (up, down), chance in alive.items():
            for change, share in chances.items():
                place = (up + (change == 1), down + (change == -1))
                following[place] = following.get(place, 0.0) + chance * share
        alive = {}
        for place, chance in following.items():
            key = (n, *place)
            if key not in verdicts:
                verdicts[key] = verdict(margin, *key)
            if verdicts[key] == NON_INFERIOR:
                lost += chance
            else:
                alive[place] = chance
    return lost


def verdict(margin, n, up, down, alpha=ALPHA):
    """The verdict from the counts alone: the capital does not depend on the order of the pairs."""
    for sign, name in ((1, NON_INFERIOR), (-1, INFERIOR)):
        bets = np.geomspace(0.003, 0.98 / (1 - sign * margin), 16)
        logs = up * np.log1p(bets * sign * (margin - 1)) + down * np.log1p(bets * sign * (margin + 1))
        logs += (n - up - down) * np.log1p(bets * sign * margin)
        if scipy.special.logsumexp(logs) - math.log(16) >= math.log(1 / alpha):
            return name
    return ""


def test_a_driver_that_is_worse_by_the_margin_is_rarely_called_non_inferior():
    assert 0.0 < wrong(0.3, 0.4, 0.1, 25) <= ALPHA
    assert 0.0 < wrong(0.3, 0.3, 0.0, 25) <= ALPHA


@pytest.mark.parametrize("margin", [0.05, 0.3])
@pytest.mark.parametrize("alpha", [0.05, 0.001])
def test_a_verdict_comes_with_the_first_pair_that_the_counts_call_decided(margin, alpha):
    rng, verdicts = np.random.default_rng(1), set()
    for worse, better in ((0.0, 0.02), (0.02, 0.02), (0.6, 0.0), (0.4, 0.1)):
        sequence, counts, found = PairedSequence(margin, alpha), {1: 0, 0: 0, -1: 0}, ""
        for n in range(1, 301):
            draw = rng.random()
            change = 1 if draw < worse else -1 if draw < worse + better else 0
            both = rng.random() < 0.3 and not change
            counts[change] += 1
            found = found or verdict(margin, n, counts[1], counts[-1], alpha)
            assert sequence.add(old_failed=change < 0 or both, new_failed=change > 0 or both) == found
            assert sequence.n == n
        verdicts.add(found)
    assert INFERIOR in verdicts
    assert NON_INFERIOR in verdicts or (margin, alpha) == (0.05, 0.001)


def decided(rates, margin, rng, most=40_000):
    """The verdict on planted drivers, and the number of pairs that it took; rates: of the old, the new, and both."""
    old, new, both = rates
    sequence = PairedSequence(margin)
    for draw in rng.random(most):
        old_failed = draw < old
        new_failed = draw < both or old <= draw < old + new - both
        if sequence.add(old_failed=old_failed, new_failed=new_failed):
            break
    return sequence.verdict, sequence.n


def test_the_same_driver_is_decided_as_soon_as_planned():
    assert decided((0.05, 0.05, 0.05), 0.01, np.random.default_rng(0)) == (NON_INFERIOR, 558)


@pytest.mark.parametrize(("new", "expected", "median"), [(0.03, NON_INFERIOR, 406), (0.09, INFERIOR, 700)])
def test_planted_differences_are_found(new, expected, median):
    found = [decided((0.05, new, 0.02), 0.01, np.random.default_rng(seed)) for seed in range(8)]
    assert {verdict for verdict, _ in found} == {expected}
    assert median / 2 < np.median([n for _, n in found]) < median * 2


def test_a_verdict_stays():
    sequence = PairedSequence(0.1)
    while not sequence.add(old_failed=False, new_failed=True):
        pass
    for _ in range(1000):
        sequence.add(old_failed=True, new_failed=False)
    assert sequence.verdict == INFERIOR


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, "Give either below"),
        ({"below": 0.1, "until": 0.1}, "Give either below"),
        ({"below": 0.9e-7}, "below 9e-08 must lie between 1e-07 and 1"),
        ({"below": 1.0}, "below 1.0 must lie"),
        ({"until": 0.0099}, "until 0.0099 must lie between 0.01 and 1"),
        ({"until": 1.0}, "until 1.0 must lie"),
        ({"below": float("nan")}, "below nan must lie"),
    ],
)
def test_a_goal_out_of_range_is_refused(given, message):
    with pytest.raises(InputError, match=message):
        Goal(**given)


def test_a_goal_chooses_the_sequence_that_decides_it():
    assert Goal(below=1e-7).sequence == RateSequence.for_rate(1e-7)
    assert Goal(below=0.999).sequence == RateSequence.for_rate(0.999)
    assert Goal("failed", until=0.01).sequence == Goal("failed", until=0.99).sequence == RateSequence()
    assert Goal(below=0.1).outcome == "collision"
    assert Decision.of(Goal(below=0.01), 500, 2) == Decision(
        Goal(below=0.01), 500, 2, *RateSequence.for_rate(0.01).interval(2, 500)
    )


@pytest.mark.parametrize(
    ("goal", "n", "count", "ends", "verdict", "words"),
    [
        (
            Goal(below=0.05),
            100,
            1,
            (0.001, 0.049),
            "below",
            "Below 5 %: collision in 1 of 100 scenarios (0.100% to 4.900%; 95 %, valid at any time)",
        ),
        (
            Goal(below=0.001),
            100,
            0,
            (0.0, 0.0005),
            "below",
            "Below 0.1 %: collision in none of 100 scenarios (at most 0.050%; 95 %, valid at any time)",
        ),
        (
            Goal("lines", below=0.05),
            100,
            20,
            (0.06, 0.3),
            "above",
            "Above 5 %: lines in 20 of 100 scenarios (6.000% to 30.000%; 95 %, valid at any time)",
        ),
        (
            Goal(below=0.05),
            100,
            5,
            (0.05, 0.05),
            "",
            "Not decided: collision in 5 of 100 scenarios (5.000% to 5.000%; 95 %, valid at any time)",
        ),
        (
            Goal("failed", until=0.25),
            100,
            50,
            (0.375, 0.625),
            "known",
            "Known as precisely as wanted: failed in 50 of 100 scenarios (37.500% to 62.500%; 95 %, valid at any time)",
        ),
        (
            Goal("failed", until=0.25),
            100,
            50,
            (0.37, 0.63),
            "",
            "Not decided: failed in 50 of 100 scenarios (37.000% to 63.000%; 95 %, valid at any time)",
        ),
        (
            Goal("failed", until=0.25),
            100,
            0,
            (0.0, 0.0),
            "",
            "Not decided: failed in none of 100 scenarios (at most 0.000%; 95 %, valid at any time)",
        ),
    ],
)
def test_a_decision_is_a_verdict_and_a_sentence(goal, n, count, ends, verdict, words):
    found = Decision(goal, n, count, *ends)
    assert found.verdict == verdict
    assert found.words == words
