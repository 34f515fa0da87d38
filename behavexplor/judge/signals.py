"""Signals for requirements on the ego's driving, computed from a trace, each of shape (T,)."""

import numpy as np

from behavexplor.data.array_types import Floats
from behavexplor.data.geometry import project_on_polyline
from behavexplor.data.trace import Trace
from behavexplor.judge.specs import NOTHING_NEAR


def speed(trace: Trace) -> Floats:
    """Return the ego's speed, forward or backward, shape (T,) [m/s]."""
    return np.hypot(trace.velocity[:, 0, 0], trace.velocity[:, 0, 1])


def acceleration(trace: Trace) -> Floats:
    """Return the ego's acceleration along its heading, negative where it brakes, shape (T,) [m/s2].

    The acceleration is the change of the forward speed from each frame to the next. The last frame repeats the value
    before it. In a trace of a single frame, it is 0.
    """
    heading = trace.heading[:, 0]
    forward = trace.velocity[:, 0, 0] * np.cos(heading) + trace.velocity[:, 0, 1] * np.sin(heading)
    change = np.diff(forward) / np.diff(trace.time)
    return np.append(change, change[-1:]) if len(change) else np.zeros(1)


def gap_ahead(trace: Trace) -> Floats:
    """Return the gap from the ego's front to the rear of the nearest vehicle ahead in its corridor, along its route.

    The corridor is the strip that the ego covers while it keeps its lateral offset from its route. It is as wide as the
    ego. A vehicle is in the corridor if its box reaches into it. It is ahead if its center is farther along the route
    than the ego's.

    Returns:
        Gaps, shape (T,) [m]: 0 where both vehicles overlap along the route, at most `NOTHING_NEAR`, and `NOTHING_NEAR`
        where no vehicle is ahead.
    """
    station, offset, turned = _on_route(trace)
    cos, sin = np.abs(np.cos(turned)), np.abs(np.sin(turned))
    length, width = trace.size[:, 0], trace.size[:, 1]
    along, across = (cos * length + sin * width) / 2, (sin * length + cos * width) / 2
    ahead = station[:, 1:] - station[:, :1]
    beside = np.abs(offset[:, 1:] - offset[:, :1]) - trace.size[0, 1] / 2 - across[:, 1:]
    gap = np.maximum(ahead - along[:, :1] - along[:, 1:], 0.0)
    gap[(ahead <= 0) | (beside >= 0)] = NOTHING_NEAR
    return np.asarray(gap.min(1, initial=NOTHING_NEAR))


def _on_route(trace: Trace) -> tuple[Floats, Floats, Floats]:
    """Return stations [m], offsets to the right [m] and headings relative to the route [rad], each of shape (T, N)."""
    points = trace.position.reshape(-1, 2)
    station, heading = project_on_polyline(points, trace.route)
    vertices = np.append(0.0, np.cumsum(np.hypot(*np.diff(trace.route, axis=0).T)))
    x, y = (points[:, i] - np.interp(station, vertices, trace.route[:, i]) for i in (0, 1))
    cos, sin = np.cos(heading), np.sin(heading)
    # Before its start and past its end, the route is extended straight.
    values = station + x * cos + y * sin, y * cos - x * sin, trace.heading.ravel() - heading
    station, offset, turned = (value.reshape(trace.heading.shape) for value in values)
    return station, offset, turned
