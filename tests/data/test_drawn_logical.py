"""Sampling, mutation and encoding of the draws of an environment."""

import numpy as np
import pytest
from scipy.stats import kstest

from behavexplor.data.drawn_logical import NORMAL, UNIFORM, Draw, DrawnLogicalScenario
from behavexplor.data.drawn_scenario import DrawnScenario, Setup
from behavexplor.data.scenario import Noise
from behavexplor.data.scripted import ScriptedScenario
from behavexplor.errors import InputError

SETUP = Setup("merge-v0", "{}", "default", "1.12.1")
LOGICAL = DrawnLogicalScenario(
    SETUP,
    (
        Draw("a", 0, UNIFORM, 0),
        Draw("a", 1, NORMAL, 0),
        Draw("a", 2, UNIFORM, 1),
        Draw("b", 0, NORMAL, 1),
        Draw("b", 1, UNIFORM, 2),
    ),
)
NOISE = Noise(0.0, 1.0, 1.0, 0.1)


def sampled(seed=0):
    return LOGICAL.sample(np.random.default_rng(seed))


def test_samples_have_the_distribution_of_the_environment():
    forms = np.array([LOGICAL.forms(sampled(seed)) for seed in range(600)])
    assert kstest(forms[:, 0], "uniform").pvalue > 1e-3
    assert kstest(forms[:, 1], "norm").pvalue > 1e-3
    assert len({sampled(seed).seed for seed in range(100)}) == 100


def test_samples_are_valid_and_the_same_for_the_same_seed():
    LOGICAL.check(sampled())
    assert sampled() == sampled() != sampled(1)


@pytest.mark.parametrize(
    ("scenario", "message"),
    [
        (ScriptedScenario("lane-follow", ()), "functional: this is a scenario of 'lane-follow', not of 'merge-v0'"),
        (DrawnScenario(Setup("exit-v0", "{}", "default", "1.12.1"), 0, ()), "another environment: env is 'exit-v0'"),
        (DrawnScenario(SETUP, 0, (("a", (1.0,)),)), r"draws\['a'\]\[0\]: 1.0 is not in \[0, 1\)"),
    ],
)
def test_scenarios_of_another_place_are_refused(scenario, message):
    with pytest.raises(InputError, match=message):
        LOGICAL.check(scenario)


def test_a_draw_that_is_missing_or_unknown_is_allowed():
    LOGICAL.check(DrawnScenario(SETUP, 0, (("a", (0.5,)), ("elsewhere", (3.0,)))))


def test_small_mutations_are_small_and_stay_in_range():
    rng, parent = np.random.default_rng(1), sampled()
    shares = LOGICAL.shares(LOGICAL.forms(parent))
    moved = []
    for _ in range(300):
        mutant = LOGICAL.mutate_little(parent, rng, NOISE)
        LOGICAL.check(mutant)
        assert mutant.seed == parent.seed
        moved.append(LOGICAL.shares(LOGICAL.forms(mutant)) - shares)
    assert np.abs(moved).max() < 0.5
    assert np.std(moved) == pytest.approx(0.1, rel=0.25)


def test_kept_blocks_stay_as_they_are():
    rng, parent = np.random.default_rng(2), sampled()
    kept = 0
    for _ in range(200):
        mutant = LOGICAL.mutate_much(parent, rng, 0.6)
        changed = LOGICAL.forms(mutant) != LOGICAL.forms(parent)
        for block in LOGICAL.blocks:
            assert changed[block].all() or not changed[block].any()
            kept += not changed[block].any()
    assert kept / 600 == pytest.approx(0.6, abs=0.1)


def test_an_encoded_scenario_is_decoded_to_itself():
    encoding = LOGICAL.encoding
    vector = np.random.default_rng(3).random(encoding.size)
    scenario = encoding.decode(vector)
    assert encoding.decode(encoding.encode(scenario)) == scenario
    assert LOGICAL.forms(encoding.decode(encoding.encode(sampled()))) == pytest.approx(LOGICAL.forms(sampled()))
    assert encoding.decode(encoding.encode(sampled())).seed == sampled().seed


def test_uniform_vectors_are_samples():
    encoding, rng = LOGICAL.encoding, np.random.default_rng(4)
    forms = np.array([LOGICAL.forms(encoding.decode(rng.random(encoding.size))) for _ in range(600)])
    assert kstest(forms[:, 0], "uniform").pvalue > 1e-3
    assert kstest(forms[:, 3], "norm").pvalue > 1e-3


def test_vectors_beyond_the_range_are_clipped():
    encoding = LOGICAL.encoding
    LOGICAL.check(encoding.decode(np.full(encoding.size, 1.7)))
    LOGICAL.check(encoding.decode(np.full(encoding.size, -0.7)))
    with pytest.raises(InputError, match="vector: expected"):
        encoding.decode(np.zeros(2))


def test_features_are_the_shares_of_the_draws():
    encoding = LOGICAL.encoding
    features = encoding.features(encoding.encode(sampled())[None])
    assert features[0] == pytest.approx(LOGICAL.shares(LOGICAL.forms(sampled())))


def test_an_environment_without_draws_cannot_be_searched():
    with pytest.raises(InputError, match="makes no random draws"):
        _ = DrawnLogicalScenario(SETUP, ()).encoding


def test_it_survives_json():
    assert DrawnLogicalScenario.from_json(LOGICAL.to_json()) == LOGICAL


def test_parts_make_the_scenario_again_and_leave_out_medians():
    assert LOGICAL.with_parts(sampled(), LOGICAL.parts(sampled())) == sampled()
    assert sum(part.free for part in LOGICAL.parts(sampled())) == len(LOGICAL.draws)
    plain = LOGICAL.scenario(0, np.array([0.5, 0.0, 0.5, 0.0, 0.5]))
    assert all(part.free == 0 for part in LOGICAL.parts(plain))
    assert LOGICAL.with_parts(plain, LOGICAL.parts(plain)) == plain


def test_parts_out_of_range_are_refused():
    parts = LOGICAL.parts(sampled())
    uniform = [[draw.kind for draw in LOGICAL.draws][j] == "uniform" for j in LOGICAL.blocks[0]]
    values = tuple(1.0 if is_uniform else None for is_uniform in uniform)
    with pytest.raises(InputError, match="not in"):
        LOGICAL.with_parts(sampled(), (parts[0]._replace(values=values), *parts[1:]))


def test_a_failed_driver_leaves_a_trace_of_one_frame():
    assert LOGICAL.first_frame(sampled(), "error").end == "error"
