"""Do the searches find what was planted, more often than uniform sampling does? Run with -m quality.

Each method runs `SEEDS` campaigns on the landscape of `landscape.py`, one candidate in flight, and as many campaigns of
uniform sampling with the same budget stand against it. Compared is the number of failures of a campaign, by a one-sided
rank test (Mann-Whitney) at `LEVEL`. With 20 campaigns a side such a test finds a method whose campaign beats a uniform
one four times in five with a power of 0.89, and nine times in ten with a power of 0.99; three times in four: 0.65.
Seeds are fixed, so a test that passes once passes always, until a method or the landscape is changed.
"""

from functools import lru_cache

import numpy as np
import pytest
from scipy.stats import mannwhitneyu

from behavexplor.campaign.config import checked, read_config
from behavexplor.fuzz.methods import load_method
from behavexplor.judge.specs import judge

from .landscape import LOGICAL, simulate

pytestmark = pytest.mark.quality

SEEDS = 20
LEVEL = 0.01
BUDGET = 750
BUDGETS = {"samota": 200}  # it is slow, and needs no more to be told apart


def campaign(name, preset, seed, budget):
    """What each execution violates first, as names; "" if nothing."""
    method = load_method(name)
    options = read_config(preset).get("options", {}) if preset else {}
    search = method(LOGICAL, seed, checked(method.Options, options, "options"))
    first = []
    for _ in range(budget):
        candidate = search.ask()
        trace = simulate(candidate.scenario)
        verdict = judge(trace)
        search.tell(candidate, trace, verdict)
        first.append(verdict.violated[0] if verdict.failed else "")
    return first


@lru_cache
def campaigns(name, preset=None, budget=BUDGET):
    return [campaign(name, preset, seed, budget) for seed in range(SEEDS)]


def failures(runs, spec=None):
    """Failures of each campaign, or those of one spec."""
    return np.array([sum(name == spec if spec else bool(name) for name in run) for run in runs])


def compare(name, preset=None, spec=None):
    """How often a campaign has more failures than a uniform one (ties half), and the p-value of that."""
    budget = BUDGETS.get(name, BUDGET)
    found = failures(campaigns(name, preset, budget), spec)
    other = failures(campaigns("uniform", None, budget), spec)
    statistic, p = mannwhitneyu(found, other, alternative="greater")
    wins = statistic / len(found) / len(other)
    versus = f"{found.mean():.1f} {spec or 'failures'} against {other.mean():.1f} of uniform"
    print(f"{preset or name}: {versus}, {budget} executions, {SEEDS} seeds: more in {wins:.0%}, p = {p:.2g}")
    return wins, p


@pytest.mark.parametrize("name", ["behavexplor", "samota", "nsga2", "map-elites", "novelty-search"])
def test_a_guided_search_finds_more_failures_than_uniform_sampling(name):
    _, p = compare(name)
    assert p < LEVEL


def test_avfuzzer_finds_more_but_not_in_enough_campaigns_to_be_told_apart():
    """It finds many or none: more on average, and in most pairs, but p is between 0.01 and 0.05."""
    wins, p = compare("avfuzzer")
    assert failures(campaigns("avfuzzer")).mean() > 2 * failures(campaigns("uniform")).mean()
    assert wins > 0.6
    assert LEVEL < p < 0.05


@pytest.mark.parametrize("preset", ["without-behavior-guidance", "without-energy", "random-novelty", "released"])
def test_so_do_variants_of_behavexplor(preset):
    _, p = compare("behavexplor", preset)
    assert p < LEVEL


@pytest.mark.parametrize(
    ("name", "preset"),
    [("nsga2", None), ("map-elites", None), ("samota", "samota-seeded")],
    ids=lambda value: value or "",
)
def test_those_that_refine_what_they_found_find_more_of_both_optima(name, preset):
    for spec in ("collision", "lines"):
        assert compare(name, preset, spec)[1] < LEVEL


def test_samota_as_published_finds_no_more_collisions_than_uniform_sampling():
    """Its searches do not begin with what was found."""
    _, p = compare("samota", spec="collision")
    assert p > LEVEL


def test_behavexplor_finds_one_optimum_and_not_the_other():
    """Probably its noise of 6 m/s steps over collisions, which are about 1 m/s wide."""
    wins, p = compare("behavexplor", spec="collision")
    assert p > LEVEL
    assert wins < 0.5
    assert compare("behavexplor", spec="lines")[1] < LEVEL


def test_measured_novelty_finds_no_more_failures_than_random_novelty():
    """Of the two optima here; it is the control, not the claim, that this is about."""
    measured, random = (failures(campaigns("behavexplor", preset)) for preset in (None, "random-novelty"))
    assert mannwhitneyu(measured, random, alternative="greater").pvalue > LEVEL


def test_random_is_no_better_than_uniform_sampling():
    """Nothing guides it."""
    assert compare("random")[1] > LEVEL
