"""Signals that requirements on an ego's driving need, each of shape (T,) and straight from a trace."""

import numpy as np
from numpy.typing import NDArray

from behavexplor.data.geometry import project_on_polyline
from behavexplor.data.trace import Trace
from behavexplor.judge.specs import NOTHING_NEAR

Floats = NDArray[np.float64]


def speed(trace: Trace) -> Floats:
    """The ego's speed, whichever way it moves, shape (T,) [m/s]."""
    return np.hypot(trace.velocity[:, 0, 0], trace.velocity[:, 0, 1])


def acceleration(trace: Trace) -> Floats:
    """The ego's acceleration along its heading, negative where it brakes.

    That is the change of its forward speed from each frame to the next; the last frame repeats the one before it.

    Args:
        trace: of an episode of T frames.

    Returns:
        Shape (T,) [m/s2]; 0 for a single frame, where nothing can change.
    """
    heading = trace.heading[:, 0]
    forward = trace.velocity[:, 0, 0] * np.cos(heading) + trace.velocity[:, 0, 1] * np.sin(heading)
    change = np.diff(forward) / np.diff(trace.time)
    return np.append(change, change[-1:]) if len(change) else np.zeros(1)


def gap_ahead(trace: Trace) -> Floats:
    """The gap from the ego's front to the rear of the nearest vehicle ahead in its corridor, along its route.

    The corridor is the strip, as wide as the ego, that it covers if it keeps its lateral offset to its route. A
    vehicle is in it if its box reaches into it, and ahead if its center is farther along the route than the ego's.

    Args:
        trace: of an episode of T frames.

    Returns:
        Shape (T,) [m]: 0 where the two overlap along the route, at most `NOTHING_NEAR`, also where nobody is ahead.
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
    """Station and offset to the right [m], and heading relative to the route [rad], of all vehicles; (T, N) each."""
    points = trace.position.reshape(-1, 2)
    station, heading = project_on_polyline(points, trace.route)
    vertices = np.append(0.0, np.cumsum(np.hypot(*np.diff(trace.route, axis=0).T)))
    x, y = (points[:, i] - np.interp(station, vertices, trace.route[:, i]) for i in (0, 1))
    cos, sin = np.cos(heading), np.sin(heading)
    # What remains along the route lies before its start or past its end, where it goes straight on.
    values = station + x * cos + y * sin, y * cos - x * sin, trace.heading.ravel() - heading
    station, offset, turned = (value.reshape(trace.heading.shape) for value in values)
    return station, offset, turned
