"""Features of the ego's behavior: its states on an even time grid, and their statistics over sliding windows.

Source: paper section 3.2.1, state interpolation and state merging.
"""

from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from behavexplor.behavior.clusters import Clusters, Labels
from behavexplor.behavior.window_statistics import fill_labels, fill_statistics
from behavexplor.data.array_types import Floats
from behavexplor.data.geometry import project_on_polyline
from behavexplor.data.trace import Trace
from behavexplor.jit import kernel_in_place, kernel_inner

Tail = Literal["padded", "cut"]
HeadingFrame = Literal["route", "world"]

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
N_FEATURES: Final = len(ATTRIBUTES) * len(STATISTICS)

STILL: Final = 1e-3  # a smaller deviation of any attribute, in its unit, is jitter and not behavior
NEGLIGIBLE: Final = np.tile(  # effect of such a deviation on each feature, shape (64,)
    [STILL, STILL**2, STILL, STILL, STILL, STILL, STILL**3, STILL], len(ATTRIBUTES)
)


def state_matrix(trace: Trace, heading_frame: HeadingFrame = "route") -> NDArray[np.float32]:
    """Compute the ego's states on a grid of `TIME_STEP`, the paper's X-bar.

    A rate of change belongs to the frame at which the change begins, so T frames give T - 1 states before
    interpolation.

    Args:
        trace: a trace of T frames, at any rate.
        heading_frame: frame of the headings. With "route", they are relative to the direction of the ego's route at its
            nearest point, so that the compass direction of a road does not matter. With "world", they are absolute.

    Returns:
        Read-only matrix with the columns of `ATTRIBUTES`, shape (N', 8). N' = 0 if the trace has a single frame.
    """
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
    turned = heading[1:] - heading[:-1]
    if turned.min() > -np.pi and turned.max() < np.pi:  # np.unwrap takes twice as long to find this
        return heading + 0.0  # as np.unwrap does, so that -0 becomes 0
    return np.unwrap(heading)


def merged_states(states: NDArray[np.floating], window: int, tail: Tail = "padded") -> Floats:
    """Compute the statistics of each attribute over each window of consecutive states, the paper's H.

    Every statistic equals tsfresh's feature calculator of the same name. Non-linearity is `c3` with lag 1. Complexity
    is `cid_ce` of the normalized window, but 0 if the window's deviation is below `STILL`. Statistics that need more
    states than the window has are 0.

    Args:
        states: the ego's states, shape (N', 8).
        window: the paper's w, number of states in a window.
        tail: windows at the end of the trace. With "padded", a window begins at every state, and the last state is
            repeated beyond the end (paper). With "cut", only the N' - w + 1 windows within the trace are used, or one
            padded window if the trace is too short.

    Returns:
        The eight statistics of the first attribute, then of the second, and so on; shape (windows, 64).
    """
    columns = _padded_columns(states, window, tail)
    merged = np.empty((_n_windows(columns, window), N_FEATURES))
    fill_statistics(columns, window, STILL, merged)
    return merged


def nearest_clusters(states: NDArray[np.floating], window: int, tail: Tail, clusters: Clusters) -> Labels:
    """Return the cluster that is nearest to each merged state; see `merged_states`.

    The sums of the distances run in a fixed order, so that ties do not depend on the number of threads.

    Args:
        states: the ego's states, shape (N', 8).
        window: number of states in a window.
        tail: windows at the end of the trace.
        clusters: clusters of merged states.

    Returns:
        Indices of clusters, the first of several that are equally near; shape (windows,).
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
    """Fill in the states and the positions of the ego on an even grid of times, interpolated linearly as by NumPy.

    Args:
        time: time of each frame, shape (T,) [s], T >= 2.
        position: positions of all vehicles, the ego first, shape (T, N, 2) [m].
        velocity: velocities of all vehicles, shape (T, N, 2) [m/s].
        motion: speed of the ego [m/s], its heading without jumps [rad], and cosine and sine of that; shape (4, T).
        spacing: time between two states [s].
        room: room for two states, shape (2, 8).
        states: states, shape (N', 8); changed in place.
        places: positions of the ego, shape (N', 2); changed in place.
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
    """Fill in the attributes of the state in a frame, see `behavexplor.behavior.features.ATTRIBUTES`."""
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
