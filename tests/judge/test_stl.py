import math
import operator
from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from behavexplor.errors import InputError
from behavexplor.judge.signals import acceleration, gap_ahead
from behavexplor.judge.stl import Signal, always, eventually, implies, until
from tests.fakes import make_trace

INF = math.inf
TICK = 0.05  # s
LONGEST = 20  # samples
OPERATORS = {"not": operator.invert, "and": operator.and_, "or": operator.or_, "implies": implies}
OPERATORS |= {"always": always, "eventually": eventually, "until": until}

# A formula is ("atom", index) or (operator, interval in ticks or None, formula, ...).
INTERVALS = st.tuples(st.integers(0, 12), st.integers(0, 12) | st.just(INF)).map(lambda ab: (ab[0], ab[0] + ab[1]))
ATOMS = st.tuples(st.just("atom"), st.sampled_from([0, 1]))


def _larger(smaller):
    return st.one_of(
        st.tuples(st.just("not"), st.none(), smaller),
        st.tuples(st.sampled_from(["and", "or", "implies"]), st.none(), smaller, smaller),
        st.tuples(st.sampled_from(["always", "eventually"]), INTERVALS, smaller),
        st.tuples(st.just("until"), INTERVALS, smaller, smaller),
    )


FORMULAS = st.recursive(ATOMS, _larger, max_leaves=5)
VALUES = st.integers(-6, 6).map(float) | st.floats(-9, 9) | st.sampled_from([INF, -INF])


@st.composite
def sampled(draw, values=VALUES):
    """Ticks of the samples, uniform or not, and the values of two atoms at them."""
    gaps = draw(st.lists(st.integers(1, 5), max_size=LONGEST - 1) | st.integers(0, LONGEST - 1).map(lambda n: [1] * n))
    ticks = [0, *np.cumsum(gaps).tolist()]
    atoms = draw(st.lists(st.lists(values, min_size=len(ticks), max_size=len(ticks)), min_size=2, max_size=2))
    return ticks, atoms


def signal(*robustness):
    return Signal(np.arange(len(robustness)), robustness)


def signals(ticks, atoms):
    return [Signal(np.array(ticks) * TICK, atom) for atom in atoms]


def build(formula, atoms):
    """The formula by the module under test, with its intervals in seconds."""
    name, interval, *parts = formula
    if name == "atom":
        return atoms[interval]
    bounds = [] if interval is None else [bound * TICK for bound in interval]
    return OPERATORS[name](*(build(part, atoms) for part in parts), *bounds)


def read(formula, ticks, atoms, no, every, some):
    """A formula at every sample, word for word as it is defined; on whole ticks, where no tolerance is needed."""
    name, interval, *parts = formula
    if name == "atom":
        return atoms[interval]
    p, q = (read(part, ticks, atoms, no, every, some) for part in (parts[0], parts[-1]))
    at = {
        "not": lambda i: no(p[i]),
        "and": lambda i: every([p[i], q[i]]),
        "or": lambda i: some([p[i], q[i]]),
        "implies": lambda i: some([no(p[i]), q[i]]),
        "always": lambda i: every([p[j] for j in window(i, interval, ticks)]),
        "eventually": lambda i: some([p[j] for j in window(i, interval, ticks)]),
        "until": lambda i: some([every([q[j], *p[i:j]]) for j in window(i, interval, ticks)]),
    }[name]
    return [at(i) for i in range(len(ticks))]


def window(i, interval, ticks):
    return [j for j, tick in enumerate(ticks) if interval[0] <= tick - ticks[i] <= interval[1]]


def least(values):
    return min(values, default=INF)


def greatest(values):
    return max(values, default=-INF)


def same(left, right):
    return np.array_equal(left.time, right.time) and np.array_equal(left.robustness, right.robustness)


# What others publish


LEFT, RIGHT = signal(100, -1, -2, 5, -1), signal(20, -2, 10, 4, -1)


@pytest.mark.parametrize(
    ("formula", "expected"),
    [
        pytest.param(~LEFT, [-100, 1, 2, -5, 1], id="not"),
        pytest.param(LEFT & RIGHT, [20, -2, -2, 4, -1], id="and"),
        pytest.param(LEFT | RIGHT, [100, -1, 10, 5, -1], id="or"),
        pytest.param(implies(LEFT, RIGHT), [20, 1, 10, 4, 1], id="implies"),
        pytest.param(always(LEFT), [-2, -2, -2, -1, -1], id="always"),
        pytest.param(always(LEFT, 0, 1), [-1, -2, -2, -1, -1], id="always[0,1]"),
        pytest.param(eventually(LEFT), [100, 5, 5, 5, -1], id="eventually"),
        pytest.param(eventually(LEFT, 0, 1), [100, -1, 5, 5, -1], id="eventually[0,1]"),
        pytest.param(until(LEFT, RIGHT), [20, -1, 10, 4, -1], id="until"),
        pytest.param(until(LEFT, RIGHT, 0, 1), [20, -1, 10, 4, -1], id="until[0,1]"),
    ],
)
def test_the_values_that_rtamt_is_tested_with(formula, expected):
    """github.com/nickovic/rtamt, tests/python/semantics/test_stl_discrete_time_offline_evaluation.py."""
    assert formula.robustness.tolist() == expected


def test_the_worked_example_of_avunit():
    """Its documentation on semantics: always distance > 3.0, least at the sixth of these samples."""
    distance = np.array([10, 8.69, 7.32, 6.3, 5.4, 4.5, 5.0, 5.1])
    assert float(always(signal(*(distance - 3.0)))) == 1.5


def test_request_and_grant_by_hand():
    """RTAMT's README asks for always((req >= 3) implies eventually[0:5](gnt >= 3)); samples at 0, 3, 5, 7, 9, 11 s."""
    time = [0, 3, 5, 7, 9, 11]
    request, grant = np.array([0, 6, 0, 0, 0, 0]), np.array([0, 0, 0, 4, 0, 0])
    spec = implies(Signal(time, request - 3), eventually(Signal(time, grant - 3), 0, 5))
    assert spec.robustness.tolist() == [3, 1, 3, 3, 3, 3]  # at 3 s: max(-3, 4 - 3)
    assert float(always(spec)) == 1
    late = implies(Signal(time, request - 3), eventually(Signal(time, grant - 3), 0, 3.9))
    assert float(always(late)) == -3  # at 3 s no grant within reach: max(-3, -3)


# By hand


def test_left_need_not_hold_where_right_does():
    assert until(signal(1, 1, -5), signal(-2, -2, 3)).robustness.tolist() == [1, 1, 3]
    assert until(signal(1, 1, -5), signal(-2, -2, 3), 2, 2).robustness.tolist() == [1, -INF, -INF]


def test_left_must_hold_before_the_interval_too():
    assert float(until(signal(1, -5, 1, 1), signal(3, 3, 3, 3), 2, 3)) == -5


def test_a_chance_before_or_after_the_interval_does_not_count():
    right = signal(7, -2, -1, -3, 8)
    assert float(until(signal(9, 9, 9, 9, 9), right, 1, 3)) == float(eventually(right, 1, 3)) == -1


def test_both_ends_of_an_interval_count():
    p = Signal([0.0, 0.1, 0.2, 0.3, 0.4], [0, 3, 9, 5, 9])
    assert float(eventually(~p, 0.1, 0.1)) == -3
    assert float(always(p, 0.1, 0.3)) == 3
    assert float(always(~p, 0.1, 0.3)) == -9
    assert float(always(Signal([0.0, 0.1 + 0.2], [5, 1]), 0, 0.3)) == 1  # which is above 0.3 in floating point
    assert float(always(Signal([0.0, 0.3], [5, 1]), 0.1 + 0.2, 1)) == 1


def test_the_end_of_the_signal_cuts_the_interval_off():
    p = signal(5, 4, 3, 2)
    assert always(p, 1, 9).robustness.tolist() == [2, 2, 2, INF]
    assert eventually(p, 2, 9).robustness.tolist() == [3, 2, -INF, -INF]
    assert until(p, p, 2, 9).robustness.tolist() == [3, 2, -INF, -INF]


def test_an_interval_between_two_samples_is_empty():
    p = Signal([0.0, 1.0, 3.0], [1, 2, 3])
    assert always(p, 0.2, 0.8).robustness.tolist() == [INF, INF, INF]
    assert eventually(p, 1.0, 1.5).robustness.tolist() == [2, -INF, -INF]
    assert until(p, p, 0.2, 0.8).robustness.tolist() == [-INF, -INF, -INF]


def test_the_value_of_a_formula_is_that_at_the_first_sample():
    assert float(signal(4, -3, 2)) == 4
    assert isinstance(float(always(signal(4, -3, 2))), float)


@pytest.mark.parametrize(("pull", "robustness"), [(-2.0, 2.0), (0.5, -0.5)])
def test_a_requirement_on_a_trace_takes_three_lines(pull, robustness):
    """An ego of 5 m/s comes within 10 m of a standing leader after 1.4 s; from 2 s on it accelerates by `pull`."""

    def brakes_for_leader(trace):
        close = Signal(trace.time, 10.0 - gap_ahead(trace))
        brakes = Signal(trace.time, -acceleration(trace))
        return float(always(implies(close, eventually(brakes, 0, 2))))

    time = np.arange(61) / 20
    speed = 5 + pull * np.maximum(time - 2, 0)
    x = 5 * time + pull * np.maximum(time - 2, 0) ** 2 / 2
    still = np.zeros((61, 3))
    trace = make_trace(still + np.outer(x, (1, 0, 0)), [still + (17 + 4.7, 0, 0)])
    trace = replace(trace, velocity=np.einsum("t,nk->tnk", speed, [[1.0, 0.0], [0.0, 0.0]]))
    assert brakes_for_leader(trace) == pytest.approx(robustness, abs=1e-6)


# By definition


@settings(max_examples=200, deadline=None)
@given(formula=FORMULAS, at=sampled())
def test_a_nested_formula_is_what_the_definitions_say(formula, at):
    assert build(formula, signals(*at)).robustness.tolist() == read(formula, *at, operator.neg, least, greatest)


@settings(max_examples=150, deadline=None)
@given(name=st.sampled_from(["always", "eventually", "until"]), interval=INTERVALS, at=sampled())
def test_a_temporal_operator_is_what_the_definition_says(name, interval, at):
    formula = name, interval, *[("atom", 0), ("atom", 1)][: 2 if name == "until" else 1]
    assert build(formula, signals(*at)).robustness.tolist() == read(formula, *at, operator.neg, least, greatest)


@settings(max_examples=60, deadline=None)
@given(name=st.sampled_from(["always", "eventually", "until"]), at=sampled())
def test_an_interval_reaches_from_now_to_the_end_by_default(name, at):
    parts = signals(*at)[: 2 if name == "until" else 1]
    assert same(OPERATORS[name](*parts), OPERATORS[name](*parts, 0, at[0][-1] * TICK))


@settings(max_examples=200, deadline=None)
@given(formula=FORMULAS, at=sampled(st.integers(1, 9) | st.integers(-9, -1)))
def test_the_sign_tells_whether_a_formula_holds(formula, at):
    ticks, atoms = at
    truth = read(formula, ticks, [[value > 0 for value in atom] for atom in atoms], operator.not_, all, any)
    assert (build(formula, signals(ticks, atoms)).robustness > 0).tolist() == truth


@settings(max_examples=100, deadline=None)
@given(formula=FORMULAS, at=sampled(st.floats(-9, 9, allow_subnormal=False)), seed=st.integers(0, 10**6))
def test_a_change_smaller_than_the_robustness_keeps_the_verdict(formula, at, seed):
    """Fainekos and Pappas 2009: the robustness is a distance from changing one's mind."""
    ticks, atoms = at
    robustness = float(build(formula, signals(ticks, atoms)))
    reach = min(abs(robustness), 1e6)
    changed = np.array(atoms) + np.random.default_rng(seed).choice([-0.99, 0.99], np.shape(atoms)) * reach
    assert np.sign(float(build(formula, signals(ticks, changed)))) == np.sign(robustness)


@settings(max_examples=100, deadline=None)
@given(at=sampled(), interval=INTERVALS)
def test_the_operators_are_dual(at, interval):
    p, q = signals(*at)
    a, b = (bound * TICK for bound in interval)
    true = Signal(p.time, np.full(len(p.time), INF))
    assert same(always(p, a, b), ~eventually(~p, a, b))
    assert same(eventually(p, a, b), until(true, p, a, b))
    assert same(p & q, ~(~p | ~q))
    assert same(implies(p, q), ~(p & ~q))
    assert same(always(p & q, a, b), always(p, a, b) & always(q, a, b))
    assert same(until(p, p | q, a, b), until(p, p, a, b) | until(p, q, a, b))


@settings(max_examples=100, deadline=None)
@given(at=sampled(), interval=INTERVALS)
def test_the_closed_until_of_donze_and_maler_is_a_formula_too(at, interval):
    ticks, (left, right) = at
    closed = [
        greatest([min([right[j], *left[i : j + 1]]) for j in window(i, interval, ticks)]) for i in range(len(ticks))
    ]
    p, q = signals(*at)
    assert until(p, p & q, *(bound * TICK for bound in interval)).robustness.tolist() == closed


# What cannot be used


@pytest.mark.parametrize(
    ("time", "robustness", "message"),
    [
        pytest.param([0, 1], [1.0, math.nan], "robustness: sample 1 is not a number", id="NaN"),
        pytest.param([0, 1, 2], [1.0, 2.0], "time and robustness: 3 and 2 samples do not match", id="lengths"),
        pytest.param([0, 1, 1], [1, 2, 3], "time: must be finite and increase", id="time stands"),
        pytest.param([0, 2, 1], [1, 2, 3], "time: must be finite and increase", id="time goes back"),
        pytest.param([0, 1e-10], [1, 2], "time: must be finite and increase by more than 1e-09", id="too close"),
        pytest.param([0, 1e-9], [1, 2], "time: must be finite and increase by more than 1e-09", id="just too close"),
        pytest.param([0, math.nan], [1, 2], "time: must be finite", id="NaN in time"),
        pytest.param([0, INF], [1, 2], "time: must be finite", id="endless time"),
        pytest.param([], [], "time: expected one number for each of T >= 1 samples", id="no sample"),
        pytest.param([0], 1.0, r"robustness: expected one number .* got shape \(\)", id="one number"),
        pytest.param([0, 1], [[1, 2], [3, 4]], r"robustness: expected one number .* got shape \(2, 2\)", id="a table"),
        pytest.param([0, 1], ["1", "2"], "robustness: expected an array of numbers", id="text"),
        pytest.param([0, 1], [[1], [2, 3]], "robustness: expected an array of numbers", id="ragged"),
        pytest.param([0, 1], [None, 1], "robustness: expected an array of numbers", id="None"),
        pytest.param([0, 1], [True, False], "robustness: expected numbers, not truth values", id="truth values"),
    ],
)
def test_a_bad_signal_is_refused(time, robustness, message):
    with pytest.raises(InputError, match=message):
        Signal(time, robustness)


@pytest.mark.parametrize(
    ("start", "end", "message"),
    [
        pytest.param(-1, 2, r"\[-1, 2\]: an interval must begin at 0 s or later", id="negative"),
        pytest.param(2, 1, r"\[2, 1\]: .* must not end before it begins", id="reversed"),
        pytest.param(INF, INF, "an interval must begin", id="never"),
        pytest.param(math.nan, 1, "an interval must begin", id="NaN start"),
        pytest.param(0, math.nan, "an interval must begin", id="NaN end"),
        pytest.param("0", 1, "start: expected a number of seconds, got '0'", id="text"),
        pytest.param(0, None, "end: expected a number of seconds, got None", id="None"),
        pytest.param(0, True, "end: expected a number of seconds, got True", id="truth value"),
    ],
)
@pytest.mark.parametrize("name", ["always", "eventually", "until"])
def test_a_bad_interval_is_refused(name, start, end, message):
    parts = [LEFT, RIGHT][: 2 if name == "until" else 1]
    with pytest.raises(InputError, match=message):
        OPERATORS[name](*parts, start, end)


@pytest.mark.parametrize("name", ["and", "or", "implies", "until"])
@pytest.mark.parametrize(
    ("other", "message"),
    [
        pytest.param(signal(1, 2), "Signals of different times cannot be combined", id="fewer"),
        pytest.param(Signal([0, 1, 2, 3, 5], np.ones(5)), "Signals of different times", id="other times"),
        pytest.param(np.ones(5), r"Expected a Signal\(time, robustness\), got array", id="an array"),
        pytest.param("text", r"Expected a Signal\(time, robustness\), got 'text'", id="text"),
    ],
)
def test_what_does_not_fit_is_refused(name, other, message):
    with pytest.raises(InputError, match=message):
        OPERATORS[name](LEFT, other)


@pytest.mark.parametrize("operator_", [implies, until])
def test_an_array_is_no_condition(operator_):
    with pytest.raises(InputError, match="Expected a Signal"):
        operator_(np.ones(5), LEFT)


@pytest.mark.parametrize("operator_", [always, eventually])
def test_an_array_is_no_formula(operator_):
    with pytest.raises(InputError, match="Expected a Signal"):
        operator_(np.ones(5))


def test_the_words_and_or_not_are_refused():
    """Python would take one of the two signals and drop the other without a word."""
    for use in (lambda: LEFT and RIGHT, lambda: LEFT or RIGHT, lambda: not LEFT):
        with pytest.raises(InputError, match="combine signals with &"):
            use()


def test_a_signal_cannot_be_changed():
    robustness = np.array([1.0, 2.0])
    p = Signal([0, 1], robustness)
    robustness[0] = 9
    assert float(p) == 1
    with pytest.raises(ValueError, match="read-only"):
        p.robustness[0] = 9
    with pytest.raises(FrozenInstanceError):
        p.time = p.robustness
