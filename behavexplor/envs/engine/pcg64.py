"""numpy's random generator `Generator(PCG64)` in compiled code, equal to numpy bit by bit.

Numba accepts numpy's generators in compiled code, and draws the same numbers. But it spends 16 to 20 us on each
generator that it is handed, which is as long as an environment takes for a whole decision, and it has no `choice`. So
a generator is an array here: the high and low half of the state, the high and low half of the increment, whether half
of a 64-bit word is left over, and this half.

Draws can also be given. The array then goes on with the index of the next given draw, their number, and the draws
themselves, each a float in a standard form, stored as its bits. The form of a uniform number is its position u in the
range, that of a choice a u in [0, 1), and that of a normal number its value z in the standard normal distribution. When
all of them are used, the generator draws again.

The draws are those of numpy's `distributions.c` and `_generator.pyx` (BSD-3-Clause). The tables of the normal
distribution in `ziggurat.npz` are those of numpy's `ziggurat_constants.h`, as numba has them (BSD-2-Clause).
"""

import math
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behavexplor.data.array_types import Floats
from behavexplor.jit import int64, kernel_inner

Words = NDArray[np.uint64]

N_WORDS = 8
HIGH, LOW, INCREMENT_HIGH, INCREMENT_LOW, HAS_HALF, HALF, NEXT_GIVEN, N_GIVEN = range(N_WORDS)

TWO, THREE, FOUR = int64(2), int64(3), int64(4)  # as arguments of kernels

_MULTIPLIER_HIGH: Final = np.uint64(0x2360ED051FC65DA4)
_MULTIPLIER_LOW: Final = np.uint64(0x4385DF649FCCF645)
_LOW_HALF: Final = np.uint64(0xFFFFFFFF)
_HALF_BITS: Final = np.uint64(32)
_ONE: Final = np.uint64(1)
_ZERO: Final = np.uint64(0)
_MANTISSA: Final = np.uint64(0x000FFFFFFFFFFFFF)
_UNIT: Final = 1.0 / 9007199254740992.0  # 2^-53

with np.load(Path(__file__).with_name("ziggurat.npz")) as _tables:
    # of each layer of the ziggurat: size below which it is accepted at once, factor from size to x, density at its edge
    _KI: Words = _tables["ki"]
    _WI: Floats = _tables["wi"]
    _FI: Floats = _tables["fi"]
# where the tail begins, and its inverse: numpy's ziggurat_nor_r and ziggurat_nor_inv_r
_TAIL: Final = 3.654152885361009
_INVERSE_TAIL: Final = 0.2736612373297583


def generator_words(generator: np.random.Generator) -> Words:
    """Return the state of a numpy generator on `PCG64` as an array without given draws, shape (8,)."""
    state = generator.bit_generator.state
    word, increment = int(state["state"]["state"]), int(state["state"]["inc"])
    values = [*divmod(word, 1 << 64), *divmod(increment, 1 << 64), state["has_uint32"], state["uinteger"], 0, 0]
    return np.array(values, dtype=np.uint64)


def put_words(words: Words, generator: np.random.Generator) -> None:
    """Give a numpy generator on `PCG64` a state that `generator_words` returned, so that both draw the same numbers."""
    high, low, increment_high, increment_low, has_half, half = (int(word) for word in words[:NEXT_GIVEN])
    generator.bit_generator.state = {
        "bit_generator": "PCG64",
        "state": {"state": (high << 64) + low, "inc": (increment_high << 64) + increment_low},
        "has_uint32": has_half,
        "uinteger": half,
    }


def give(words: Words, forms: Floats) -> None:
    """Give a generator draws in standard form, shape (n,), in place of any earlier ones. The array must have room."""
    words[NEXT_GIVEN], words[N_GIVEN] = 0, len(forms)
    words[N_WORDS : N_WORDS + len(forms)] = forms.view(np.uint64)


@kernel_inner
def is_given(words: Words) -> bool:
    """Return whether the next draw is given."""
    return bool(words[NEXT_GIVEN] < words[N_GIVEN])


@kernel_inner
def next_form(words: Words) -> float:
    """Return the standard form of the next given draw."""
    place = np.int64(words[NEXT_GIVEN])
    words[NEXT_GIVEN] += _ONE
    return float(words.view(np.float64)[N_WORDS + place])


@kernel_inner
def next_word(words: Words) -> np.uint64:
    """Draw 64 bits: one step of PCG XSL-RR 128/64."""
    high, low = words[HIGH], words[LOW]
    # the 128-bit product of the state and the multiplier, from halves of 32 bits
    a, b, c, d = low & _LOW_HALF, low >> _HALF_BITS, _MULTIPLIER_LOW & _LOW_HALF, _MULTIPLIER_LOW >> _HALF_BITS
    middle = (a * c >> _HALF_BITS) + (a * d & _LOW_HALF) + (b * c & _LOW_HALF)
    product = (a * c & _LOW_HALF) | ((middle & _LOW_HALF) << _HALF_BITS)
    carried = b * d + (a * d >> _HALF_BITS) + (b * c >> _HALF_BITS) + (middle >> _HALF_BITS)
    carried += high * _MULTIPLIER_LOW + low * _MULTIPLIER_HIGH
    low = product + words[INCREMENT_LOW]
    high = carried + words[INCREMENT_HIGH] + (_ONE if low < product else _ZERO)
    words[HIGH], words[LOW] = high, low
    turn = high >> np.uint64(58)
    mixed = high ^ low
    word: np.uint64 = (mixed >> turn) | (mixed << ((np.uint64(64) - turn) & np.uint64(63)))
    return word


@kernel_inner
def next_half(words: Words) -> np.uint64:
    """Draw 32 bits. The other half of the 64 bits that were drawn is kept for the next call."""
    if words[HAS_HALF] != _ZERO:
        words[HAS_HALF] = _ZERO
        return np.uint64(words[HALF])
    word = next_word(words)
    words[HAS_HALF], words[HALF] = _ONE, word >> _HALF_BITS
    return word & _LOW_HALF


@kernel_inner
def random(words: Words) -> float:
    """Draw a number from [0, 1): `Generator.random`."""
    if is_given(words):
        return next_form(words)
    return float((next_word(words) >> np.uint64(11)) * _UNIT)


@kernel_inner
def uniform(words: Words, low: float, high: float) -> float:
    """Draw a number from [low, high): `Generator.uniform`."""
    return low + (high - low) * random(words)


@kernel_inner
def integer(words: Words, n: int) -> int:
    """Draw a whole number from [0, n), where n is at most 2^32: `Generator.integers` and `Generator.choice`."""
    if n == 1:
        return 0
    if is_given(words):
        return min(int(next_form(words) * n), n - 1)
    # Lemire's method: products that would make some numbers more likely are drawn again
    count = np.uint64(n)
    product = next_half(words) * count
    if (product & _LOW_HALF) < count:
        threshold = (_LOW_HALF - (count - _ONE)) % count
        while (product & _LOW_HALF) < threshold:
            product = next_half(words) * count
    return np.int64(product >> _HALF_BITS)  # type: ignore[return-value]


@kernel_inner
def masked_integer(words: Words, n: int) -> int:
    """Draw a whole number from [0, n) as `Generator.shuffle` does for the rows of a table: by rejection."""
    last = np.uint64(n - 1)
    mask = last
    for shift in (1, 2, 4, 8, 16):
        mask |= mask >> np.uint64(shift)
    value = next_half(words) & mask
    while value > last:
        value = next_half(words) & mask
    return np.int64(value)  # type: ignore[return-value]


@kernel_inner
def normal(words: Words) -> float:
    """Draw from the standard normal distribution: `Generator.normal`, by numpy's ziggurat."""
    if is_given(words):
        return next_form(words)
    while True:
        word = next_word(words)
        layer = np.int64(word & np.uint64(0xFF))
        word >>= np.uint64(8)
        size = (word >> _ONE) & _MANTISSA
        x = size * _WI[layer]
        if word & _ONE != _ZERO:
            x = -x
        if size < _KI[layer]:
            return float(x)
        if layer == 0:
            return _tail(words, (size >> np.uint64(8)) & _ONE != _ZERO)
        if (_FI[layer - 1] - _FI[layer]) * random(words) + _FI[layer] < math.exp(-0.5 * x * x):
            return float(x)


@kernel_inner
def _tail(words: Words, is_negative: bool) -> float:
    """Draw from the normal distribution beyond the last layer of the ziggurat."""
    while True:
        x = -_INVERSE_TAIL * math.log1p(-random(words))
        y = -math.log1p(-random(words))
        if y + y > x * x:
            return -(_TAIL + x) if is_negative else _TAIL + x


@kernel_inner
def two_of(words: Words, n: int) -> tuple[int, int]:
    """Draw two different whole numbers from [0, n), n <= 10 000: `Generator.choice(n, size=2, replace=False)`.

    Given draws are the place of the first number among all, and that of the second one among the others.
    """
    if is_given(words):
        first = integer(words, n)
        second = integer(words, n - 1)
        return first, second + (second >= first)
    # as in numpy: Floyd's algorithm, then a shuffle of the two
    first = integer(words, n - 1)
    second = integer(words, n)
    if second == first:
        second = n - 1
    return (second, first) if integer(words, TWO) == 0 else (first, second)


@kernel_inner
def weighted(words: Words, cumulated: Floats) -> int:
    """Draw an index by cumulated probabilities, shape (n,), the last one 1: `Generator.choice(n, size=1, p=p)`."""
    share = random(words)
    i = 0
    while i < len(cumulated) and cumulated[i] <= share:
        i += 1
    return i


@kernel_inner
def shuffle_rows(words: Words, table: NDArray[np.generic], first: int) -> None:
    """Shuffle the rows of a table from the row `first` on: `Generator.shuffle(table[first:])`."""
    for i in range(len(table) - first - 1, 0, -1):
        j = masked_integer(words, i + 1)
        if i != j:
            for k in range(table.shape[1]):
                table[first + i, k], table[first + j, k] = table[first + j, k], table[first + i, k]
