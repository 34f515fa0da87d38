"""The arrival of an ego, between the frames of its trace.

An episode ends in the first frame in which the ego's center is within `ARRIVAL_DISTANCE` of its destination. At a speed
v, this frame lies up to v times the time between two frames behind the moment of arrival, which is 0.56 m at 20 Hz and
the speed limit. How far behind is an accident of the sampling, and greater than the differences between most episodes.
So an episode is judged up to the moment of arrival.
"""

import math
from dataclasses import replace
from functools import lru_cache
from typing import Final

import numpy as np

from behavexplor.data.conventions import ARRIVAL_DISTANCE
from behavexplor.data.trace import Trace

ARRIVED: Final = "arrived"  # end of an episode, one of `behavexplor.data.trace.ENDS`


def final_distance(trace: Trace) -> float:
    """Return the ego's distance from its destination at the end of an episode, the paper's D_p2p [m].

    If the ego arrived, this is its closest approach: the least distance of the destination from the ego's course, which
    is the way between the last two frames and its straight continuation. It does not depend on where on this course the
    frames lie. On a course of curvature k, it is exact to k r (r + h) / 2 with r = `ARRIVAL_DISTANCE` and the distance
    h between the frames. For any other end, it is the distance of the last position.
    """
    if trace.end != ARRIVED or len(trace.time) < 2:
        return trace.destination_distance
    (x, y), (to_x, to_y) = trace.position[-2, 0].tolist(), trace.position[-1, 0].tolist()
    step = math.hypot(to_x - x, to_y - y)
    if step == 0:
        return trace.destination_distance
    cos, sin = (to_x - x) / step, (to_y - y) / step
    gap_x, gap_y = trace.destination[0] - x, trace.destination[1] - y
    ahead, across = gap_x * cos + gap_y * sin, gap_y * cos - gap_x * sin
    beyond = ahead - min(max(ahead, 0.0), step + ARRIVAL_DISTANCE)
    return math.hypot(beyond, across)


@lru_cache(maxsize=2)
def until_arrival(trace: Trace) -> Trace:
    """Return the trace of an episode up to the moment of arrival.

    The last frame of an ego that arrived is moved back to the moment at which its center came within
    `ARRIVAL_DISTANCE` of the destination. All vehicles are interpolated linearly between the last two frames. A trace
    with any other end is returned as it is.
    """
    if trace.end != ARRIVED or len(trace.time) < 2:
        return trace
    share = _arrival_share(trace)
    if share is None:
        return trace
    last = {name: getattr(trace, name).copy() for name in ("time", "position", "heading", "velocity")}
    for name, values in last.items():
        change = values[-1] - values[-2]
        if name == "heading":
            change = np.remainder(change + np.pi, 2 * np.pi) - np.pi
        values[-1] = values[-2] + share * change
    return replace(trace, **last)


def _arrival_share(trace: Trace) -> float | None:
    """Return the share of the last time step after which the ego arrived, in (0, 1]; None if it was there before."""
    start, end = trace.position[-2:, 0] - trace.destination
    if not np.hypot(*end) <= ARRIVAL_DISTANCE < np.hypot(*start):
        return None
    way = end - start
    squared, inward = float(way @ way), -float(start @ way)
    within = inward**2 - squared * (float(start @ start) - ARRIVAL_DISTANCE**2)
    return min((inward - math.sqrt(max(within, 0.0))) / squared, 1.0)
