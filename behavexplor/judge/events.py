"""Violation events: the frame at which a trace violates a spec, and the vehicle or line that the ego touched."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from behavexplor.data.array_types import Ints
from behavexplor.data.geometry import distances_from_segments, gaps_from_lines, point_segment_distances
from behavexplor.data.trace import OFF_ROAD, RESOLUTION, Trace
from behavexplor.judge.fault import touched_npc
from behavexplor.judge.specs import ERROR, Collision, Destination, Lines

R1, R2, R3 = "R1", "R2", "R3"
_BLOCK: Final = 8  # frames that share one bound in the search for a touched line
REQUIREMENTS: Final = {Collision().name: R1, Lines().name: R2, Destination().name: R3}  # by name of the spec


@dataclass(frozen=True)
class ViolationEvent:
    """The first violation of a spec in a trace."""

    spec: str  # "R1", "R2", "R3", or the name of a user's spec
    frame: int  # frame of the violation; the last frame of the trace for all specs but R2
    # touched vehicle (R1, an index of `trace.size`) or touched line (R2, an index of `trace.illegal_lines`); -1 for all
    # other specs, and for an ego that left the road of a highway-env environment
    partner: int = -1


def violation_event(trace: Trace, violated: Sequence[str]) -> ViolationEvent | None:
    """Return the event of the first violated spec; None if none is violated, the ADS failed, or no contact is found.

    R1, R2, R3 come first, since a collision keeps the ego from its destination; `violated` holds names as in `Verdict`.
    """
    ranked = [*(name for name in REQUIREMENTS if name in violated), *violated]
    if not ranked or ranked[0] == ERROR:
        return None
    spec, last = REQUIREMENTS.get(ranked[0], ranked[0]), len(trace.time) - 1
    if spec == R1:
        npc = touched_npc(trace)
        return None if npc is None else ViolationEvent(R1, last, npc)
    if spec == R2 and OFF_ROAD in trace.signals:
        return ViolationEvent(R2, int(trace.signals[OFF_ROAD].argmax()))
    if spec == R2:
        return first_line_touch(trace)
    return ViolationEvent(spec, last)


def first_line_touch(trace: Trace) -> ViolationEvent | None:
    """Return the first contact of the ego's box with an illegal line, or None.

    Two bounds leave few pairs of frames and lines: one for each block of frames, then the gap from the infinite line.
    """
    lines, position, heading = trace.illegal_lines, trace.position[:, 0], trace.heading[:, 0]
    if not len(lines):
        return None
    first = np.arange(0, len(position), _BLOCK)
    stray = position - np.repeat(position[first], _BLOCK, axis=0)[: len(position)]
    reach = np.hypot(*trace.size[0]) / 2 + np.maximum.reduceat(np.hypot(stray[:, 0], stray[:, 1]), first)
    block, line = np.nonzero(point_segment_distances(position[first], lines) <= reach[:, None])
    frame = np.minimum(first[block, None] + np.arange(_BLOCK), len(position) - 1).ravel()
    line = np.repeat(line, _BLOCK)
    near = gaps_from_lines(position[frame], heading[frame], trace.size[0], lines, line) <= RESOLUTION
    frame, line = frame[near], line[near]
    gap = distances_from_segments(position[frame], heading[frame], trace.size[0], lines, line)
    touching = np.flatnonzero(gap <= RESOLUTION)
    if not len(touching):
        return None
    earliest = touching[frame[touching].argmin()]
    return ViolationEvent(R2, int(frame[earliest]), int(line[earliest]))


def recent_decisions(trace: Trace, frame: int, seconds: float) -> Ints:
    """Return the decisions made in the last `seconds` [s] before a frame."""
    given = trace.time[trace.action_frame]
    return np.flatnonzero((given >= trace.time[frame] - seconds - 1e-9) & (trace.action_frame < frame))
