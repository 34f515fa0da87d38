"""numpy's random generator `Generator(PCG64)` in compiled code, equal to numpy bit by bit.

Numba accepts numpy's generators in compiled code, and draws the same numbers. But it spends 16 to 20 us on each
generator that it is handed, which is as long as an environment takes for a whole decision, and it has no `choice`. So
a generator is an array here: the high and low half of the state, the high and low half of the increment, whether half
of a 64-bit word is left over, and this half.

Draws can also be given. The rest of the array is then the index of the next given draw, their number, and their
standard forms as the bits of floating-point numbers: the position u of a uniform number in its range, of a choice in
[0, 1); the distance z of a normal number from the mean. When all of them are used, the generator draws again.

The draws are those of numpy's `distributions.c` and `_generator.pyx` (BSD-3-Clause). The tables of the normal
distribution in `ziggurat.npz` are those of numpy's `ziggurat_constants.h`, as numba has them (BSD-2-Clause).
"""

import math
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behavexplor.data.array_types import Floats
from behavexplor.jit import kernel_inner

Words = NDArray[np.uint64]

N_WORDS = 8
HIGH, LOW, INCREMENT_HIGH, INCREMENT_LOW, HAS_HALF, HALF, NEXT_FORM, N_FORMS = range(N_WORDS)

# Numba would compile a function once more for each constant of Python's own type.
TWO: Any = np.int64(2)
THREE: Any = np.int64(3)
FOUR: Any = np.int64(4)

_MULTIPLIER_HIGH: Final = np.uint64(0x2360ED051FC65DA4)
_MULTIPLIER_LOW: Final = np.uint64(0x4385DF649FCCF645)
_MASK: Final = np.uint64(0xFFFFFFFF)
_BITS: Final = np.uint64(32)
_ONE: Final = np.uint64(1)
_NONE: Final = np.uint64(0)
_MANTISSA: Final = np.uint64(0x000FFFFFFFFFFFFF)
_UNIT: Final = 1.0 / 9007199254740992.0  # 2^-53

with np.load(Path(__file__).with_name("ziggurat.npz")) as _tables:
    _KI: Words = _tables["ki"]
    _WI: Floats = _tables["wi"]
    _FI: Floats = _tables["fi"]
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
    high, low, increment_high, increment_low, has_half, half = (int(word) for word in words[:NEXT_FORM])
    generator.bit_generator.state = {
        "bit_generator": "PCG64",
        "state": {"state": (high << 64) + low, "inc": (increment_high << 64) + increment_low},
        "has_uint32": has_half,
        "uinteger": half,
    }


def give(words: Words, forms: Floats) -> None:
    """Give a generator draws in standard form, shape (n,), in place of any earlier ones. It has room for them."""
    words[NEXT_FORM], words[N_FORMS] = 0, len(forms)
    words[N_WORDS : N_WORDS + len(forms)] = forms.view(np.uint64)


@kernel_inner
def is_given(words: Words) -> bool:
    """Return whether the next draw is given."""
    return bool(words[NEXT_FORM] < words[N_FORMS])


@kernel_inner
def next_form(words: Words) -> float:
    """Return the standard form of the next given draw."""
    place = np.int64(words[NEXT_FORM])
    words[NEXT_FORM] += _ONE
    return float(words.view(np.float64)[N_WORDS + place])


@kernel_inner
def next_word(words: Words) -> np.uint64:
    """Draw 64 bits: one step of PCG XSL-RR 128/64."""
    high, low = words[HIGH], words[LOW]
    a, b, c, d = low & _MASK, low >> _BITS, _MULTIPLIER_LOW & _MASK, _MULTIPLIER_LOW >> _BITS
    middle = (a * c >> _BITS) + (a * d & _MASK) + (b * c & _MASK)
    product = (a * c & _MASK) | ((middle & _MASK) << _BITS)
    carried = b * d + (a * d >> _BITS) + (b * c >> _BITS) + (middle >> _BITS)
    carried += high * _MULTIPLIER_LOW + low * _MULTIPLIER_HIGH
    low = product + words[INCREMENT_LOW]
    high = carried + words[INCREMENT_HIGH] + (_ONE if low < product else _NONE)
    words[HIGH], words[LOW] = high, low
    turn = high >> np.uint64(58)
    mixed = high ^ low
    word: np.uint64 = (mixed >> turn) | (mixed << ((np.uint64(64) - turn) & np.uint64(63)))
    return word


@kernel_inner
def next_half(words: Words) -> np.uint64:
    """Draw 32 bits. The other half of the 64 bits that were drawn is kept for the next call."""
    if words[HAS_HALF] != _NONE:
        words[HAS_HALF] = _NONE
        return np.uint64(words[HALF])
    word = next_word(words)
    words[HAS_HALF], words[HALF] = _ONE, word >> _BITS
    return word & _MASK


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
    count = np.uint64(n)
    product = next_half(words) * count
    if (product & _MASK) < count:
        threshold = (_MASK - (count - _ONE)) % count
        while (product & _MASK) < threshold:
            product = next_half(words) * count
    return np.int64(product >> _BITS)  # type: ignore[return-value]


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
        if word & _ONE != _NONE:
            x = -x
        if size < _KI[layer]:
            return float(x)
        if layer == 0:
            return _tail(words, (size >> np.uint64(8)) & _ONE != _NONE)
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
    first = integer(words, n - 1)
    second = integer(words, n)
    if second == first:
        second = n - 1
    return (second, first) if integer(words, TWO) == 0 else (first, second)


@kernel_inner
def weighted(words: Words, cumulated: Floats) -> int:
    """Draw an index with given cumulated probabilities, the last one 1: `Generator.choice(n, size=1, p=p)`."""
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
