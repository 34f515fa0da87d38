"""Compiled interpolation of the ego's states, see `behavexplor.behavior.features.state_matrix`, which calls it."""

from behavexplor.data.array_types import Floats
from behavexplor.jit import kernel_in_place, kernel_inner


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
