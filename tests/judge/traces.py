"""Traces made by hand, and the same seen from elsewhere: turned by an angle, and in a mirror."""

from dataclasses import replace

import numpy as np

from behavexplor.data.trace import Trace

# of the whole world [rad]: among them, headings that cross pi, and such whose cosine and sine have either sign
TURNS = (0.0, 0.7, 2.5, np.pi - 0.01, -2.2)
CAR = (4.0, 2.0)  # length and width [m]
ROUTE = ((-200.0, 0.0), (200.0, 0.0))


def driven(*vehicles, time=None, route=ROUTE, sizes=None, **fields):
    """A trace of vehicles, the ego first, each of them rows of x, y, heading and speed along it, shape (T, 4)."""
    rows = np.stack([np.atleast_2d(np.asarray(one, dtype=float)) for one in vehicles], 1)
    heading = rows[..., 2]
    along = np.stack([np.cos(heading), np.sin(heading)], -1)
    found = {
        "time": np.arange(len(rows)) / 10.0 if time is None else np.asarray(time, dtype=float),
        "position": rows[..., :2],
        "heading": heading,
        "velocity": rows[..., 3:] * along,
        "size": np.array([CAR] * len(vehicles) if sizes is None else sizes, dtype=float),
        "actions": np.zeros((0, 1)),
        "action_frame": np.zeros(0, dtype=int),
        "route": np.array(route, dtype=float),
        "destination": np.array([100.0, 0.0]),
        "illegal_lines": np.empty((0, 2, 2)),
        "end": "timeout",
    }
    return Trace(**{**found, **fields})


def turned(trace: Trace, angle: float) -> Trace:
    """The same in a world that is turned by an angle [rad] and moved; headings are in [-pi, pi]."""
    cos, sin = np.cos(angle), np.sin(angle)
    rotation = np.array([[cos, sin], [-sin, cos]])
    moved = {
        name: getattr(trace, name) @ rotation + (30.0, -70.0)
        for name in ("position", "route", "destination", "illegal_lines")
    }
    heading = np.angle(np.exp(1j * (trace.heading + angle)))
    return replace(trace, velocity=trace.velocity @ rotation, heading=heading, **moved)


def mirrored(trace: Trace) -> Trace:
    """The same with left and right exchanged."""
    names = ("position", "route", "destination", "illegal_lines", "velocity")
    return replace(trace, heading=-trace.heading, **{name: getattr(trace, name) * (1, -1) for name in names})


def other_side(words: str) -> str:
    """Return words with left and right exchanged."""
    return words.replace("left", "LEFT").replace("right", "left").replace("LEFT", "right")


def views(trace: Trace):
    """Yield the trace in each turned world, and its mirror image, with what changes the words about it."""
    for angle in TURNS:
        yield turned(trace, angle), str
        yield turned(mirrored(trace), angle), other_side
