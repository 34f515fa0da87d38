"""Ten-line stand-ins for a simulator with an ADS in it, and traces made by hand."""

import numpy as np

from behavexplor.data.conventions import EGO_SIZE
from behavexplor.data.trace import Trace
from behavexplor.envs.functional import IntersectionStraightEnv
from behavexplor.testing import synthetic_trace

LOGICAL = IntersectionStraightEnv.logical

RATE = 20  # frames per second


def make_trace(ego, npcs=(), *, sizes=None, lines=(), destination=(0.0, 0.0), time=None, route=None):
    """A trace from poses.

    `ego` and each of `npcs` are (T, 3) rows of x, y, heading; velocities are their differences.
    """
    poses = np.stack([np.asarray(pose, dtype=float).reshape(-1, 3) for pose in (ego, *npcs)], axis=1)
    time = np.arange(len(poses)) / RATE if time is None else np.asarray(time, dtype=float)
    velocity = np.gradient(poses[..., :2], time, axis=0) if len(poses) > 1 else np.zeros_like(poses[..., :2])
    return Trace(
        time=time,
        position=poses[..., :2],
        heading=poses[..., 2],
        velocity=velocity,
        size=np.array([EGO_SIZE] * poses.shape[1] if sizes is None else sizes, dtype=float),
        actions=np.zeros((0, 1)),
        action_frame=np.zeros(0, dtype=int),
        route=np.array([[0.0, 0.0], [100.0, 0.0]]) if route is None else route,
        destination=np.array(destination, dtype=float),
        illegal_lines=np.array(lines, dtype=float).reshape(-1, 2, 2),
        end="timeout",
    )


def simulate(scenario, logical=LOGICAL):
    """An ADS that never looks: it follows its route, hurries, dawdles and stops as the scenario's letters tell it."""
    return synthetic_trace(scenario, logical)
