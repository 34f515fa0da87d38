"""The arrival of an ego, between the frames of its trace.

An episode ends in the first frame in which the ego's center is within `ARRIVAL_DISTANCE` of its destination. At a speed
v, this frame lies up to v times the time between two frames behind the moment of arrival, which is 0.56 m at 20 Hz and
the speed limit. How far behind is an accident of the sampling, and greater than the differences between most episodes.
So an episode is judged up to the moment of arrival.
"""

import math
from functools import lru_cache
from typing import Final

import numpy as np

from behavexplor.data.array_types import Floats
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


@lru_cache(maxsize=2)  # several specs ask for the poses of the same trace
def poses_until_arrival(trace: Trace) -> tuple[Floats, Floats]:
    """Return the poses of all vehicles in an episode up to the moment of arrival.

    The last frame of an ego that arrived is moved back to the moment at which its center came within
    `ARRIVAL_DISTANCE` of the destination, at the earliest to the frame before. All vehicles are interpolated linearly
    between these two frames. The poses of an episode with any other end are those of the trace.

    Returns:
        Positions, shape (T, N, 2) [m], and headings, shape (T, N) [rad].
    """
    share = _arrival_share(trace) if trace.end == ARRIVED and len(trace.time) > 1 else 1.0
    if share == 1.0:
        return trace.position, trace.heading
    position, heading = trace.position.copy(), trace.heading.copy()
    turned = np.remainder(heading[-1] - heading[-2] + np.pi, 2 * np.pi) - np.pi
    position[-1] = position[-2] + share * (position[-1] - position[-2])
    heading[-1] = heading[-2] + share * turned
    for array in (position, heading):
        array.setflags(write=False)
    return position, heading


def _arrival_share(trace: Trace) -> float:
    """Return the share of the last time step after which the ego arrived, in [0, 1]."""
    start, end = trace.position[-2:, 0] - trace.destination
    way = end - start
    squared, inward = float(way @ way), -float(start @ way)
    if squared == 0 or np.hypot(*end) > ARRIVAL_DISTANCE:
        return 1.0
    within = inward**2 - squared * (float(start @ start) - ARRIVAL_DISTANCE**2)
    return min(max((inward - math.sqrt(max(within, 0.0))) / squared, 0.0), 1.0)
