"""Signal temporal logic (STL): requirements on the timing of events, as formulas over sampled signals.

A formula is a `Signal`. It holds the robustness of the formula at each sample: the distance from a violation where the
formula holds, and minus the distance from satisfaction where it does not. Formulas are built from margins, which are
positive where a condition holds:

    def brakes_for_leader(trace: Trace) -> float:
        close = Signal(trace.time, 10.0 - gap_ahead(trace))
        brakes = Signal(trace.time, -acceleration(trace))
        return float(always(implies(close, eventually(brakes, 0, 2))))

This formula requires that the ego always decelerates within 2 s when a leader is closer than 10 m. A robustness above 0
means satisfied, below 0 violated, and exactly 0 undecided. A robustness can mix units, here m and m/s2. Scale the
margins where that matters.

The semantics are the usual quantitative semantics of space robustness [1, 2], evaluated at the samples. Nothing is
assumed between two samples, and the samples need not be equally spaced. Let w be the samples with a time in
[t + start, t + end], both ends included up to `TOLERANCE`. Then at time t:

    ~p                           -p(t)
    p & q                        min(p(t), q(t))
    p | q                        max(p(t), q(t))
    implies(p, q)                max(-p(t), q(t))
    always(p, start, end)        min of p over w
    eventually(p, start, end)    max of p over w
    until(p, q, start, end)      max, over t' in w, of min(q(t'), min of p over [t, t'))

In `until`, p need not hold at t' itself. This is the discrete-time semantics, as in RTAMT [3]. Donze and Maler [2]
close the interval at t', which is `until(p, p & q, start, end)` here.

The end of the signal truncates w. For an empty w, `always` is +inf (nothing can violate it), and `eventually` and
`until` are -inf (nothing can satisfy them). So a response that is due after the end counts as missing unless it came
earlier. `always(p, 0, max(trace.duration - 2, 0))` requires responses within 2 s only where 2 s are left. Because the
robustness of a whole formula may be infinite, the caller has to check that it is finite.

Sources:
    [1] Fainekos and Pappas, "Robustness of temporal logic specifications for continuous-time signals", Theoretical
        Computer Science 410 (2009).
    [2] Donze and Maler, "Robust satisfaction of temporal logic over real-valued signals", FORMATS 2010.
    [3] Nickovic and Yamaguchi, "RTAMT: online robustness monitors from STL", ATVA 2020; README, "Specification
        Language".
    [4] Donze, Ferrere and Maler, "Efficient robust monitoring for STL", CAV 2013.
"""

import math
from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np

from behavexplor.data.array_types import Floats, Ints
from behavexplor.errors import InputError, brief

TOLERANCE = 1e-9  # tolerance of times [s], so that 0.1 + 0.2 is within [0, 0.3]


@dataclass(frozen=True, eq=False)
class Signal:
    """The robustness of a formula at every sample.

    The operators `&`, `|` and `~` combine signals. `float(signal)` is the robustness at the first sample, which is the
    robustness of the formula on the whole signal.

    Attributes:
        time: times of the samples, shape (T,) [s], increasing by more than `TOLERANCE`; T >= 1. Read-only.
        robustness: values in the signal's own unit, shape (T,), positive where the formula holds; may be infinite,
            never NaN. Read-only.

    Raises:
        InputError: if an array has a wrong shape or wrong values, or if combined signals differ in time.
    """

    time: Floats
    robustness: Floats

    def __post_init__(self) -> None:
        for name in ("time", "robustness"):
            object.__setattr__(self, name, _frozen(name, getattr(self, name)))
        if self.time.shape != self.robustness.shape:
            raise InputError(f"time and robustness: {len(self.time)} and {len(self.robustness)} samples do not match")
        if not np.isfinite(self.time).all() or (np.diff(self.time) <= TOLERANCE).any():
            raise InputError(f"time: must be finite and increase by more than {TOLERANCE:g} s at each sample")
        if np.isnan(self.robustness).any():
            raise InputError(f"robustness: sample {np.isnan(self.robustness).argmax()} is not a number (NaN)")

    def __and__(self, other: "Signal") -> "Signal":
        _check_signals(self, other)
        return Signal(self.time, np.minimum(self.robustness, other.robustness))

    def __or__(self, other: "Signal") -> "Signal":
        _check_signals(self, other)
        return Signal(self.time, np.maximum(self.robustness, other.robustness))

    def __invert__(self) -> "Signal":
        return Signal(self.time, -self.robustness)

    def __float__(self) -> float:
        return float(self.robustness[0])

    def __bool__(self) -> bool:
        # Without this, `p and q` would silently be q.
        raise InputError("A signal is neither true nor false: combine signals with &, | and ~, not with and, or, not")


def implies(condition: Signal, consequence: Signal) -> Signal:
    """Return the formula "wherever the condition holds, the consequence holds": `~condition | consequence`.

    Raises:
        InputError: if the arguments are not signals with the same times.
    """
    _check_signals(condition, consequence)
    return ~condition | consequence


def always(signal: Signal, start: float = 0.0, end: float = math.inf) -> Signal:
    """Return the formula "`signal` holds at every sample from `start` to `end` after now".

    Args:
        signal: the formula, T samples.
        start: beginning of the window, counted from each sample [s].
        end: end of the window, counted from each sample [s]; by default the end of the signal.

    Returns:
        The least robustness in each window, T samples in the unit of `signal`; +inf where a window has no sample.

    Raises:
        InputError: if `signal` is not a signal, or [start, end] is not an interval within [0, inf].
    """
    _check_signals(signal)
    return Signal(signal.time, _least(signal.robustness, *_windows(signal.time, start, end)))


def eventually(signal: Signal, start: float = 0.0, end: float = math.inf) -> Signal:
    """Return the formula "`signal` holds at some sample from `start` to `end` after now".

    Args:
        signal: the formula, T samples.
        start: beginning of the window, counted from each sample [s].
        end: end of the window, counted from each sample [s]; by default the end of the signal.

    Returns:
        The greatest robustness in each window, T samples in the unit of `signal`; -inf where a window has no sample.

    Raises:
        InputError: if `signal` is not a signal, or [start, end] is not an interval within [0, inf].
    """
    _check_signals(signal)
    return Signal(signal.time, -_least(-signal.robustness, *_windows(signal.time, start, end)))


def until(left: Signal, right: Signal, start: float = 0.0, end: float = math.inf) -> Signal:
    """Return the formula "`right` holds at a sample from `start` to `end` after now, and `left` holds until then".

    `left` need not hold at the sample at which `right` holds. Where `right` holds at once, `left` need not hold at all.

    Args:
        left: the formula that holds until then, T samples.
        right: the formula that ends the wait, T samples.
        start: beginning of the window for `right`, counted from each sample [s].
        end: end of the window for `right`, counted from each sample [s]; by default the end of the signal.

    Returns:
        The robustness, T samples; -inf where the window has no sample.

    Raises:
        InputError: if the arguments are not signals with the same times, or [start, end] is not an interval within
            [0, inf].
    """
    _check_signals(left, right)
    first, stop = _windows(left.time, start, end)
    # The minimum of these is exact [4]: `left` up to the window, untimed `until` from there, `right` within the window.
    # The reason: if the untimed `until` is satisfied only after the window, `left` holds throughout the window.
    bridged = _least(left.robustness, np.arange(len(first)), first)
    untimed = np.append(_untimed_until(left.robustness, right.robustness), -np.inf)  # for windows after the last sample
    within = -_least(-right.robustness, first, stop)
    return Signal(left.time, np.minimum(np.minimum(bridged, untimed[first]), within))


def _untimed_until(left: Floats, right: Floats) -> Floats:
    """Return `until` over [0, inf), shape (T,): `right` now, or `left` now and `until` again at the next sample."""
    result = np.empty(len(left))
    following = -math.inf
    for i in reversed(range(len(left))):
        following = result[i] = max(right[i], min(left[i], following))
    return result


def _windows(time: Floats, start: Any, end: Any) -> tuple[Ints, Ints]:
    """Return the first index of each sample's window and the index after its last one, both of shape (T,)."""
    for name, bound in (("start", start), ("end", end)):
        if isinstance(bound, bool) or not isinstance(bound, Real):
            raise InputError(f"{name}: expected a number of seconds, got {brief(bound)}")
    if not 0.0 <= start <= end or math.isinf(start):
        raise InputError(f"[{start}, {end}]: an interval must begin at 0 s or later, and must not end before it begins")
    first = np.searchsorted(time, time + (start - TOLERANCE), side="left")
    return first, np.searchsorted(time, time + (end + TOLERANCE), side="right")


def _least(values: Floats, first: Ints, stop: Ints) -> Floats:
    """Return the least value of each window values[first:stop], or +inf for an empty window, in O(T log T).

    Each window is the union of two overlapping stretches of 2^k values. The minima of the stretches are computed for
    k = 0, 1, ..., each from the minima of the previous k.
    """
    count = stop - first
    least = np.full(len(count), np.inf)
    stretch, size = values, 1  # stretch[i] is the least of values[i : i + size]
    while size <= count.max():
        now = (size <= count) & (count < 2 * size)
        least[now] = np.minimum(stretch[first[now]], stretch[stop[now] - size])
        stretch, size = np.minimum(stretch[:-size], stretch[size:]), 2 * size
    return least


def _check_signals(*signals: Any) -> None:
    for signal in signals:
        if not isinstance(signal, Signal):
            raise InputError(f"Expected a Signal(time, robustness), got {brief(signal)}")
    if not all(np.array_equal(signal.time, signals[0].time) for signal in signals):
        raise InputError("Signals of different times cannot be combined: sample them at the same times first")


def _frozen(name: str, values: Any) -> Floats:
    """Return a read-only copy of shape (T,), T >= 1."""
    try:
        given = np.asarray(values)
    except ValueError:  # rows of different lengths
        given = np.asarray(None)  # refused below, because it is no array of numbers
    if given.dtype.kind == "b":
        raise InputError(f"{name}: expected numbers, not truth values: write a margin, such as 3.0 - speed")
    if given.dtype.kind not in "iuf":
        raise InputError(f"{name}: expected an array of numbers, got {brief(values)}")
    if given.ndim != 1 or not given.size:
        raise InputError(f"{name}: expected one number for each of T >= 1 samples, got shape {given.shape}")
    array = given.astype(np.float64)
    array.setflags(write=False)
    return array
