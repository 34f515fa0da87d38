"""The compiled generator draws numpy's numbers, bit by bit, and leaves the same state behind."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from behavexplor.envs.engine import pcg64
from behavexplor.envs.engine.pcg64 import N_WORDS, generator_words, give, put_words
from behavexplor.jit import kernel_in_place

NAMES = ["exr", "sxr", "nxr"]


def cumulated(n):
    shares = np.arange(n) / np.arange(n).sum()
    sums = shares.cumsum()
    return shares, sums / sums[-1]


def shuffled_by_numpy(generator, n):
    table = np.arange(3.0 * n).reshape(n, 3).astype(np.float32)
    generator.shuffle(table[1:])
    return table.tolist()


def shuffled(words, n):
    table = np.arange(3.0 * n).reshape(n, 3).astype(np.float32)
    shuffle(words, table)
    return table.tolist()


@kernel_in_place
def draw(words, what, n):
    if what == 0:
        return pcg64.random(words)
    return pcg64.uniform(words, 1.5, n) if what == 1 else pcg64.normal(words)


@kernel_in_place
def integer(words, n):
    return pcg64.integer(words, n)


@kernel_in_place
def two_of(words, n):
    return pcg64.two_of(words, n)


@kernel_in_place
def weighted(words, sums):
    return pcg64.weighted(words, sums)


@kernel_in_place
def shuffle(words, table):
    pcg64.shuffle_rows(words, table, 1)


@kernel_in_place
def skip_half(words):
    pcg64.next_half(words)


DRAWS = {  # numpy's draw and ours; n is from 2 to 60
    "random": (lambda g, n: g.random(), lambda w, n: draw(w, 0, n)),
    "uniform": (lambda g, n: g.uniform(1.5, n), lambda w, n: draw(w, 1, n)),
    "integers": (lambda g, n: g.integers(n), integer),
    "integers from 1": (lambda g, n: g.integers(1, n + 1), lambda w, n: 1 + integer(w, n)),
    "many integers": (lambda g, n: g.integers(2**32 - n), lambda w, n: integer(w, 2**32 - n)),
    "all integers": (lambda g, n: g.integers(2**32), lambda w, n: integer(w, 2**32)),
    "one integer": (lambda g, n: g.integers(1), lambda w, n: integer(w, 1)),
    "choice": (lambda g, n: g.choice(NAMES), lambda w, n: NAMES[integer(w, 3)]),
    "two of": (lambda g, n: tuple(g.choice(range(n), size=2, replace=False)), two_of),
    "weighted": (
        lambda g, n: g.choice(np.arange(n), size=1, p=cumulated(n)[0])[0],
        lambda w, n: weighted(w, cumulated(n)[1]),
    ),
    "normal": (lambda g, n: g.normal(), lambda w, n: draw(w, 2, n)),
    "normal around": (lambda g, n: g.normal(1.0), lambda w, n: 1.0 + draw(w, 2, n)),
    "shuffle": (shuffled_by_numpy, shuffled),
}


@given(st.integers(0, 2**64), st.lists(st.tuples(st.sampled_from(list(DRAWS)), st.integers(2, 60)), max_size=60))
def test_draws_in_any_order_are_numpy_s(seed, draws):
    generator = np.random.default_rng(seed)
    words = generator_words(generator)
    for name, n in draws:
        expected, ours = DRAWS[name]
        assert ours(words, n) == expected(generator, n)
    assert (words == generator_words(generator)).all()


@pytest.mark.parametrize("name", DRAWS)
def test_5000_draws_of_each_kind_are_numpy_s(name):
    generator = np.random.default_rng(7)
    words = generator_words(generator)
    expected, ours = DRAWS[name]
    assert [ours(words, 2 + k % 59) for k in range(5000)] == [expected(generator, 2 + k % 59) for k in range(5000)]


def test_the_tail_of_the_normal_distribution_is_numpy_s():
    generator = np.random.default_rng(3)
    words = generator_words(generator)
    draws = np.array([draw(words, 2, 0) for _ in range(200_000)])
    assert (draws == generator.normal(size=200_000)).all()
    assert (np.abs(draws) > 3.7).any()  # beyond the last layer


MULTIPLIER = 0x2360ED051FC65DA44385DF649FCCF645  # of PCG64, as in numpy's pcg64.h


def about_to_draw(word):
    """A generator whose next 64 bits are given: those of the state after the next step, if its upper half is 0."""
    generator = np.random.default_rng(0)
    state = generator.bit_generator.state
    state["state"]["state"] = (word - state["state"]["inc"]) * pow(MULTIPLIER, -1, 2**128) % 2**128
    generator.bit_generator.state = state
    return generator


def about_to_draw_half(half):
    """A generator whose next 32 bits are given."""
    generator = np.random.default_rng(0)
    generator.bit_generator.state = generator.bit_generator.state | {"has_uint32": 1, "uinteger": half}
    return generator


@pytest.mark.parametrize("beyond", [-1, 0, 1])
def test_normal_numbers_at_the_edge_of_each_layer_are_numpy_s(beyond):
    for layer, edge in enumerate(pcg64._KI.tolist()):
        for is_negative in (0, 1):
            generator = about_to_draw(max(edge + beyond, 0) << 9 | is_negative << 8 | layer)
            words = generator_words(generator)
            assert draw(words, 2, 0) == generator.normal()
            assert (words == generator_words(generator)).all()


@pytest.mark.parametrize("n", [3, 1001, 3_000_000_001, 2**32 - 1])
def test_integers_at_the_edge_of_rejection_are_numpy_s(n):
    threshold = 2**32 % n  # Lemire, 2019: a product with less than that in its lower half is rejected
    for lower in {max(threshold + k, 0) for k in (-1, 0, 1)} | {n - 1, n, n + 1}:
        generator = about_to_draw_half(lower * pow(n, -1, 2**32) % 2**32)
        words = generator_words(generator)
        assert integer(words, n) == generator.integers(n)
        assert (words == generator_words(generator)).all()


@pytest.mark.parametrize("shares", [[0.25, 0.25, 0.5], [0.5, 0.0, 0.5], [0.0, 1.0]])
@pytest.mark.parametrize("position", [0.0, 0.25, 0.5, 1 - 2**-53])
def test_a_share_at_the_edge_of_two_choices_is_numpy_s(shares, position):
    generator = about_to_draw(int(position * 2**64))
    words = generator_words(generator)
    assert weighted(words, np.cumsum(shares)) == generator.choice(len(shares), size=1, p=shares)[0]


@given(st.integers(0, 2**64), st.integers(0, 3))
def test_a_generator_goes_on_where_the_array_stopped(seed, halves):
    generator, other = np.random.default_rng(seed), np.random.default_rng(0)
    words = generator_words(generator)
    for _ in range(halves):  # an odd number leaves half a word over
        skip_half(words)
    put_words(words, other)
    assert [integer(words, 9) for _ in range(5)] == other.integers(9, size=5).tolist()
    assert (words == generator_words(other)).all()


def test_given_draws_are_used_in_their_order_and_then_it_draws_again():
    generator = np.random.default_rng(3)
    words = np.pad(generator_words(generator), (0, 7))
    give(words, np.array([0.25, -3.5, 0.99, 0.5, 0.9, 1 / 3, 0.0]))
    assert draw(words, 0, 0) == 0.25
    assert draw(words, 2, 0) == -3.5
    assert integer(words, 5) == 4
    assert integer(words, 1) == 0  # a choice among one is no draw
    assert two_of(words, 4) == (2, 3)
    assert weighted(words, np.array([0.2, 0.6, 1.0])) == 1
    assert draw(words, 1, 3.5) == 1.5
    assert draw(words, 0, 0) == generator.random()
    give(words[:N_WORDS], np.zeros(0))
    assert draw(words, 0, 0) == generator.random()
