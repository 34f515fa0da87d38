"""Features of the ego's behavior: its states on an even time grid, and their statistics over sliding windows.

Source: paper section 3.2.1, state interpolation and state merging. The windows of a series are computed side by side,
so that the processor can treat several of them at once. In each window, all sums run in the order of time.
"""

import math
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from behavexplor.data.array_types import Floats
from behavexplor.data.geometry import project_on_polyline
from behavexplor.data.trace import Trace
from behavexplor.jit import kernel, kernel_in_place, kernel_inner

Tail = Literal["padded", "cut"]
HeadingFrame = Literal["route", "world"]
Labels = NDArray[np.uint8]  # an abstract trace: one abstract state (cluster) per window

TIME_STEP: Final = 0.1  # step of the even grid [s]
ATTRIBUTES: Final = (  # of a state; the paper leaves their number M open
    "speed",  # [m/s]
    "speed-change",  # signed acceleration [m/s2]
    "velocity-along",  # along the heading [m/s]
    "velocity-across",  # to the right of the heading [m/s]
    "acceleration-along",  # [m/s2]
    "acceleration-across",  # [m/s2]
    "yaw-rate",  # [rad/s]
    "heading",  # [rad]
)
STATISTICS: Final = (  # the paper's D = 8 statistics of an attribute in a window
    "mean",
    "variance",
    "minimum",
    "maximum",
    "mean-change",
    "mean-abs-change",
    "non-linearity",
    "complexity",
)
MEAN, VARIANCE, LEAST, GREATEST, CHANGE, ABS_CHANGE, NON_LINEARITY, COMPLEXITY = range(8)  # indices of `STATISTICS`
N_STATISTICS: Final = len(STATISTICS)
N_FEATURES: Final = len(ATTRIBUTES) * N_STATISTICS

STILL: Final = 1e-3  # a smaller deviation of any attribute, in its unit, is jitter and not behavior
NEGLIGIBLE: Final = np.tile(  # effect of such a deviation on each feature, shape (64,)
    [STILL, STILL**2, STILL, STILL, STILL, STILL, STILL**3, STILL], len(ATTRIBUTES)
)


def known_states(heading_frame: HeadingFrame, states: NDArray[np.float32]) -> dict[str, NDArray[np.float32]]:
    """Return states that another process has computed, as arguments of `Trace.of_packed` for `state_matrix`."""
    return {f"_{heading_frame}_states": states}


def state_matrix(trace: Trace, heading_frame: HeadingFrame = "route") -> NDArray[np.float32]:
    """Compute the ego's states on a grid of `TIME_STEP`, the paper's X-bar; a read-only matrix, shape (N', 8).

    A rate of change belongs to the frame at which the change begins, so T frames give T - 1 states before
    interpolation; N' = 0 for a single frame. The columns are those of `ATTRIBUTES`. With "route", headings are relative
    to the direction of the ego's route at its nearest point, so that the compass direction of a road does not matter.
    With "world", they are absolute.
    """
    known: NDArray[np.float32] | None = vars(trace).get(f"_{heading_frame}_states")
    if known is not None:
        return known
    if len(trace.time) < 2:
        return np.zeros((0, len(ATTRIBUTES)), dtype=np.float32)
    heading = _without_jumps(trace.heading[:, 0])
    speed = np.hypot(trace.velocity[:, 0, 0], trace.velocity[:, 0, 1])
    motion = np.array([speed, heading, np.cos(heading), np.sin(heading)])
    count = int((trace.time[-2] + 1e-9) / TIME_STEP) + 1
    states, places, room = np.empty((count, len(ATTRIBUTES))), np.empty((count, 2)), np.empty((2, len(ATTRIBUTES)))
    vectors = np.ascontiguousarray(trace.position), np.ascontiguousarray(trace.velocity)
    fill_states(np.ascontiguousarray(trace.time), *vectors, motion, TIME_STEP, room, states, places)
    if heading_frame == "route":
        states[:, -1] -= project_on_polyline(places, trace.route)[1]
    states[:, -1] -= 2 * np.pi * np.rint(states[0, -1] / (2 * np.pi))
    matrix = states.astype(np.float32)
    matrix.setflags(write=False)
    return matrix


def _without_jumps(heading: Floats) -> Floats:
    """Return headings without jumps by a full turn, shape (T,) [rad]."""
    if np.abs(heading[1:] - heading[:-1]).max() < np.pi:  # np.unwrap takes twice as long to find this
        return heading + 0.0  # as np.unwrap does, so that -0 becomes 0
    return np.unwrap(heading)


def merged_states(states: NDArray[np.floating], window: int, tail: Tail = "padded") -> Floats:
    """Compute the statistics of each attribute over each window of consecutive states, the paper's H.

    Every statistic equals tsfresh's feature calculator of the same name. Non-linearity is `c3` with lag 1. Complexity
    is `cid_ce` of the normalized window, but 0 if the window's deviation is below `STILL`. Statistics that need more
    states than the window has are 0.

    The states have the shape (N', 8), and a window has `window` of them (the paper's w). With the tail "padded", a
    window begins at every state, and the last state is repeated beyond the end (paper). With "cut", only the N' - w + 1
    windows within the trace are used, or one padded window if the trace is too short. The result has the eight
    statistics of the first attribute, then of the second, and so on, shape (windows, 64).
    """
    columns = _padded_columns(states, window, tail)
    merged = np.empty((_n_windows(columns, window), N_FEATURES))
    fill_statistics(columns, window, STILL, merged)
    return merged


class Clusters(NamedTuple):
    """Centers of clusters in scaled features. Scaling subtracts the mean of each feature, then divides by its scale."""

    centers: Floats  # the centers, shape (K, features)
    squares: Floats  # the squared length of each center, shape (K,)
    mean: Floats  # the mean of each feature, shape (features,)
    scale: Floats  # the scale of each feature, shape (features,)

    @property
    def unscaled_centers(self) -> Floats:
        """The centers in features that are not scaled."""
        return self.centers * self.scale + self.mean


def nearest_clusters(states: NDArray[np.floating], window: int, tail: Tail, clusters: Clusters) -> Labels:
    """Return the index of the cluster that is nearest to each merged state, shape (windows,).

    For the ego's states, shape (N', 8), the window and the tail, see `merged_states`. The sums of the distances run in
    a fixed order, so that ties do not depend on the number of threads. The first of several clusters that are equally
    near is taken.
    """
    columns = _padded_columns(states, window, tail)
    labels = np.empty(_n_windows(columns, window), dtype=np.uint8)
    fill_labels(columns, window, STILL, clusters, labels)
    return labels


def _padded_columns(states: NDArray[np.floating], window: int, tail: Tail) -> Floats:
    """Return the states as columns, with the last one repeated, so that all windows are whole; shape (8, n)."""
    count = len(states)
    padding = (window - 1 if tail == "padded" else max(window - count, 0)) if count else 0
    columns = np.empty((len(ATTRIBUTES), count + padding))
    columns[:, :count] = states.T
    columns[:, count:] = columns[:, count - 1 : count]
    return columns


def _n_windows(columns: Floats, window: int) -> int:
    return max(int(columns.shape[1]) - window + 1, 0)


@kernel_in_place
def fill_states(
    time: Floats,
    position: Floats,
    velocity: Floats,
    motion: Floats,
    spacing: float,
    room: Floats,
    states: Floats,
    places: Floats,
) -> None:
    """Fill in the states and positions of the ego at times that are `spacing` [s] apart, interpolated as by NumPy.

    The interpolation is linear, and `time` [s] has T >= 2 frames. Positions [m] and velocities [m/s] are those of all
    vehicles, shape (T, N, 2), the ego first. `motion` is the speed of the ego [m/s], its heading without jumps [rad],
    and cosine and sine of that, shape (4, T). `room` is for two states, shape (2, 8). States, shape (N', 8), and
    places, shape (N', 2), are changed in place.
    """
    last, t = len(time) - 1, 0
    for i in range(len(states)):
        now = i * spacing
        while t < last and time[t + 1] <= now:
            t += 1
        if t >= last - 1 or time[t] == now:  # the last state is held
            _fill_state(time, velocity, motion, min(t, last - 1), states[i])
        else:
            _fill_state(time, velocity, motion, t, room[0])
            _fill_state(time, velocity, motion, t + 1, room[1])
            _interpolate(time, now, t, room[0], room[1], states[i])
        if t == last or time[t] == now:
            places[i, 0], places[i, 1] = position[t, 0, 0], position[t, 0, 1]
        else:
            _interpolate(time, now, t, position[t, 0], position[t + 1, 0], places[i])


@kernel_inner
def _fill_state(time: Floats, velocity: Floats, motion: Floats, t: int, state: Floats) -> None:
    """Fill in the attributes of the state in a frame, in the order of `ATTRIBUTES`."""
    step, cos, sin = time[t + 1] - time[t], motion[2, t], motion[3, t]
    x, y = velocity[t, 0, 0], velocity[t, 0, 1]
    change_x, change_y = (velocity[t + 1, 0, 0] - x) / step, (velocity[t + 1, 0, 1] - y) / step
    state[0], state[1] = motion[0, t], (motion[0, t + 1] - motion[0, t]) / step
    state[2], state[3] = x * cos + y * sin, y * cos - x * sin
    state[4], state[5] = change_x * cos + change_y * sin, change_y * cos - change_x * sin
    state[6], state[7] = (motion[1, t + 1] - motion[1, t]) / step, motion[1, t]


@kernel_inner
def _interpolate(time: Floats, now: float, t: int, first: Floats, second: Floats, between: Floats) -> None:
    """Fill in the values between those in a frame and those in the next one."""
    for k in range(len(between)):
        slope = (second[k] - first[k]) / (time[t + 1] - time[t])
        between[k] = slope * (now - time[t]) + first[k]


@kernel
def fill_statistics(x: Floats, window: int, still: float, filled: Floats) -> None:
    """Fill in the statistics of each attribute in each window; see `merged_states`.

    `x` are the states, shape (attributes, n). A deviation of less than `still` in a window is no movement. `filled` is
    changed in place: the statistics of the first attribute, then of the second, and so on, shape (n - window + 1,
    attributes * statistics).
    """
    columns, terms = np.empty((N_STATISTICS, len(filled))), np.empty(x.shape[1])
    for j in range(len(x)):
        _fill_columns(x[j], window, still, terms, columns)
        for i in range(len(filled)):
            for k in range(N_STATISTICS):
                filled[i, j * N_STATISTICS + k] = columns[k, i]


@kernel
def fill_labels(x: Floats, window: int, still: float, clusters: Clusters, labels: NDArray[np.uint8]) -> None:
    """Fill in the cluster whose center is nearest to the statistics of each window, the first of several.

    For the states `x` and for `still`, see `fill_statistics`. The `labels`, indices of clusters, shape
    (n - window + 1,), are changed in place.
    """
    columns, terms = np.empty((N_STATISTICS, len(labels))), np.empty(x.shape[1])
    products = np.zeros((2, len(clusters.centers), len(labels)))  # of even and odd features
    for j in range(len(x)):
        _fill_columns(x[j], window, still, terms, columns)
        first = j * N_STATISTICS
        for k in range(N_STATISTICS):
            _scale(columns[k], clusters.mean[first + k], clusters.scale[first + k])
        for k in range(len(clusters.centers)):
            center = clusters.centers[k, first : first + N_STATISTICS]
            _add_products(columns, 0, center, products[0, k])
            _add_products(columns, 1, center, products[1, k])
    _find_nearest(products, clusters.squares, labels)


@kernel_inner
def _fill_columns(x: Floats, window: int, still: float, terms: Floats, columns: Floats) -> None:
    """Fill in `columns`, the statistics of one attribute, shape (statistics, windows). Loops are simple, to be fast.

    `x` are its states, shape (n,). For `still`, see `fill_statistics`. `terms` is room for intermediate results, shape
    (n,).
    """
    count = columns.shape[1]
    columns[:] = 0.0
    _add_up(x, window, columns[MEAN])
    _divide(columns[MEAN], window)
    _add_squares(x, window, columns[MEAN], columns[VARIANCE])
    _divide(columns[VARIANCE], window)
    _find_least(x, 1.0, window, terms, columns[LEAST])
    _find_least(x, -1.0, window, terms, columns[GREATEST])
    if window > 1:
        before, after, changes = x[:-1], x[1:], terms[:-1]
        _subtract(x[window - 1 :], x[:count], columns[CHANGE])
        _divide(columns[CHANGE], window - 1)
        _find_distances(before, after, changes)
        _add_up(changes, window - 1, columns[ABS_CHANGE])
        _divide(columns[ABS_CHANGE], window - 1)
        _multiply(changes, changes, changes)
        _add_up(changes, window - 1, columns[COMPLEXITY])
    if window > 2:
        products = terms[:-2]
        _multiply(x[2:], x[1:-1], products)
        _multiply(products, x[:-2], products)
        _add_up(products, window - 2, columns[NON_LINEARITY])
        _divide(columns[NON_LINEARITY], window - 2)
    _find_complexity(columns[VARIANCE], still, columns[COMPLEXITY])


@kernel_inner
def _add_up(terms: Floats, length: int, sums: Floats) -> None:
    """Add consecutive terms, as many as `length`, to the sum of each window, one after the other."""
    count, whole = len(sums), length - length % 4
    for k in range(0, whole, 4):
        a, b, c, d = terms[k:], terms[k + 1 :], terms[k + 2 :], terms[k + 3 :]
        for i in range(count):
            sums[i] = sums[i] + a[i] + b[i] + c[i] + d[i]
    for k in range(whole, length):
        for i in range(count):
            sums[i] += terms[k + i]


@kernel_inner
def _find_least(x: Floats, sign: float, window: int, room: Floats, least: Floats) -> None:
    """Find the least number in each window, or the greatest one if the sign is -1.

    The least number of a window is the lesser of those of two shorter windows that cover it.
    """
    for i in range(len(x)):
        room[i] = sign * x[i]
    reached = 1  # length of the windows in `room`
    while 2 * reached <= window:
        for i in range(len(x) - 2 * reached + 1):
            room[i] = min(room[i], room[i + reached])
        reached *= 2
    for i in range(len(least)):
        least[i] = sign * min(room[i], room[i + window - reached])


@kernel_inner
def _subtract(values: Floats, others: Floats, differences: Floats) -> None:
    for i in range(len(differences)):
        differences[i] = values[i] - others[i]


@kernel_inner
def _find_distances(values: Floats, others: Floats, distances: Floats) -> None:
    for i in range(len(distances)):
        distances[i] = abs(others[i] - values[i])


@kernel_inner
def _multiply(values: Floats, others: Floats, products: Floats) -> None:
    for i in range(len(products)):
        products[i] = values[i] * others[i]


@kernel_inner
def _divide(values: Floats, by: float) -> None:
    for i in range(len(values)):
        values[i] /= by


@kernel_inner
def _add_squares(x: Floats, length: int, mean: Floats, sums: Floats) -> None:
    """Add the squared deviations from each window's mean to the sum of the window, one after the other."""
    count, whole = len(sums), length - length % 2
    for k in range(0, whole, 2):
        first, second = x[k:], x[k + 1 :]
        for i in range(count):
            a, b = first[i] - mean[i], second[i] - mean[i]
            sums[i] = sums[i] + a * a + b * b
    for k in range(whole, length):
        for i in range(count):
            sums[i] += (x[k + i] - mean[i]) * (x[k + i] - mean[i])


@kernel_inner
def _find_complexity(variance: Floats, still: float, energy: Floats) -> None:
    """Replace the energy of each window by its complexity."""
    for i in range(len(energy)):
        deviation = math.sqrt(variance[i])
        complexity = math.sqrt(energy[i]) / deviation  # also where it is not used, which is faster than to branch
        energy[i] = complexity if deviation > still else 0.0


@kernel_inner
def _scale(values: Floats, mean: float, scale: float) -> None:
    for i in range(len(values)):
        values[i] = (values[i] - mean) / scale


@kernel_inner
def _add_products(columns: Floats, side: int, center: Floats, sums: Floats) -> None:
    """Add the products of one attribute's features and a center's, of the even features or of the odd ones.

    The order of the sums decides between centers that are equally near but for the last bits. It is the order in which
    numpy adds up on most processors.
    """
    a, b, c, d = columns[side], columns[side + 2], columns[side + 4], columns[side + 6]
    u, v, w, x = center[side], center[side + 2], center[side + 4], center[side + 6]
    for i in range(len(sums)):
        sums[i] = sums[i] + d[i] * x + c[i] * w + b[i] * v + a[i] * u


@kernel_inner
def _find_nearest(products: Floats, squares: Floats, labels: NDArray[np.uint8]) -> None:
    for i in range(len(labels)):
        best, least = 0, math.inf
        for k in range(len(squares)):
            distance = squares[k] - 2 * (products[0, k, i] + products[1, k, i])
            if distance < least:
                best, least = k, distance
        labels[i] = best
