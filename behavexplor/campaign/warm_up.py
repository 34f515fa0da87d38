"""Loading of what judging and mining need, while workers start."""

import numpy as np

from behavexplor.behavior.clusters import load_clustering
from behavexplor.behavior.novelty import NoveltyArchive
from behavexplor.data.motion_bytes import unpack_motion
from behavexplor.data.trace import RESOLUTION, Trace
from behavexplor.judge.specs import judge

_FRAMES = 31
_SPEED = 10.0  # [m/s]


def load_analysis() -> None:
    """Import the modules and load the machine code that the analysis of a trace needs, by analyzing a small one.

    The first campaign on a machine compiles that code here. Otherwise, its first execution would wait for it.
    """
    load_clustering()
    unpack_motion(np.zeros((1, 2, _FRAMES), dtype=np.uint8), _FRAMES, RESOLUTION)
    trace = _pass_by()
    judge(trace)
    NoveltyArchive().observe(trace)


def _pass_by() -> Trace:
    """Return a trace of an ego that passes a standing vehicle."""
    time = np.arange(_FRAMES) / 20
    position, velocity = np.zeros((2, _FRAMES, 2, 2))
    position[:, 0, 0], position[:, 1], velocity[:, 0, 0] = _SPEED * time, (8.0, 4.0), _SPEED
    return Trace(
        time=time,
        position=position,
        heading=np.zeros((_FRAMES, 2)),
        velocity=velocity,
        size=np.array([[5.0, 2.0], [5.0, 2.0]]),
        actions=np.zeros((0, 1)),
        action_frame=np.zeros(0, dtype=np.int64),
        route=np.array([[0.0, 0.0], [50.0, 0.0], [100.0, 0.0]]),
        destination=np.array([100.0, 0.0]),
        illegal_lines=np.array([[[0.0, -4.0], [100.0, -4.0]]]),
        end="timeout",
    )
