"""Compact replays for a page: int16 differences, deflated, in base64."""

import base64
import zlib
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from behavexplor.data.array_types import Floats, Ints
from behavexplor.data.trace import Trace

Steps = Ints

FRAME_TIME: Final = 0.1  # time between two frames of a replay [s]
MAX_FRAMES: Final = 900  # greatest number of frames of a replay; a longer one has frames farther apart
LENGTH_UNIT: Final = 0.01  # unit of positions [m]; larger where a replay spans more than 650 m
TURN: Final = 2 * np.pi / 65536  # unit of headings [rad]
SPEED_UNIT: Final = 0.01  # unit of speeds [m/s]
TIME_UNIT: Final = 0.01  # unit of times [s]
_SPAN: Final = 65_000  # usable range of an int16


@dataclass(frozen=True)
class Packed:
    """The motion of all vehicles, packed for the page's script.

    The data are a matrix of int16. Its rows are the time, the ego's speed, then x, y and heading of each vehicle. Each
    row holds the first value, then the differences, modulo 2^16. All low bytes come before all high bytes.
    """

    frames: int  # number of frames
    kept: Ints  # indices of these frames in the trace, shape (frames,)
    vehicles: int  # number of vehicles, the ego first
    middle: tuple[float, float]  # middle of all positions [m], the origin of x and y
    unit: float  # unit of x and y [m]
    data: str  # base64 of the deflated matrix
    spans: list[tuple[int, int]]  # first and last frame in which each vehicle is present

    def values(self) -> dict[str, Any]:
        """Return the fields for the page's script, as JSON values."""
        return {
            "frames": self.frames,
            "vehicles": self.vehicles,
            "middle": list(self.middle),
            "unit": self.unit,
            "data": self.data,
            "spans": self.spans,
        }


def pack(trace: Trace, frame: int) -> Packed:
    """Pack a trace, and keep its frame of a given index."""
    kept = _kept(trace, frame)
    position = _held(trace)[kept]
    low, high = position.min((0, 1)), position.max((0, 1))
    middle = np.rint((low + high) / 2)
    unit = max(LENGTH_UNIT, float(np.ceil((high - low).max() / _SPAN * 1000) / 1000))
    places = np.rint((position - middle) / unit)
    headings = np.rint(np.unwrap(trace.heading[kept], axis=0) / TURN)
    speed = np.rint(np.hypot(*trace.velocity[kept, 0].T) / SPEED_UNIT)
    motion = np.stack([places[..., 0], places[..., 1], headings], axis=-1)  # (frames, vehicles, 3)
    rows = [np.rint(trace.time[kept] / TIME_UNIT), speed, *motion.reshape(len(kept), -1).T]
    origin = (float(middle[0]), float(middle[1]))
    return Packed(len(kept), kept, len(trace.size), origin, unit, _deflated(rows), _spans(trace, kept))


def _spans(trace: Trace, kept: Ints) -> list[tuple[int, int]]:
    """Return the first and the last of the kept frames in which each vehicle is present; (1, 0) if it is in none."""
    if not trace.present.size:
        return [(0, len(kept) - 1)] * len(trace.size)
    spans = []
    for seen in trace.present[kept].T:
        frames = np.flatnonzero(seen)
        spans.append((int(frames[0]), int(frames[-1])) if len(frames) else (1, 0))
    return spans


def _held(trace: Trace) -> Floats:
    """Return the positions. An absent vehicle is where it appears next, or else where it was last."""
    if not trace.present.size:
        return trace.position
    position = trace.position.copy()
    every = np.arange(len(trace.time))
    for vehicle, seen in enumerate(trace.present.T):
        frames = np.flatnonzero(seen)
        nearest = frames[np.clip(np.searchsorted(frames, every), 0, len(frames) - 1)]
        position[:, vehicle] = trace.position[nearest, vehicle]
    return position


def _kept(trace: Trace, frame: int) -> Ints:
    """Return frames about `FRAME_TIME` apart, with the given frame and the last one."""
    count = min(MAX_FRAMES, int(trace.duration / FRAME_TIME + 1e-6) + 1)
    times = np.linspace(0, (count - 1) * FRAME_TIME if count < MAX_FRAMES else trace.duration, count)
    even = np.searchsorted(trace.time, times - 1e-9)
    return np.unique(np.concatenate([even, [frame, len(trace.time) - 1]])).astype(np.int64)


def _deflated(rows: list[Floats]) -> str:
    steps: Steps = np.diff(np.stack(rows), axis=1, prepend=0).astype(np.int64)
    words = (steps & 0xFFFF).astype("<u2").ravel()
    planes = words.view(np.uint8).reshape(-1, 2).T  # high bytes are mostly equal, so they deflate better separately
    return base64.b64encode(zlib.compress(planes.tobytes(), 9)).decode("ascii")
