"""When and where a trace violated a spec."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behavexplor.data.geometry import box_corners, box_segment_distance, point_segment_distance
from behavexplor.data.trace import RESOLUTION, Trace
from behavexplor.judge.fault import touched_npc
from behavexplor.judge.specs import ERROR, Collision, Destination, Lines, gap_across

Floats = NDArray[np.float64]
Ints = NDArray[np.intp]

R1, R2, R3 = "R1", "R2", "R3"
_BLOCK: Final = 8  # frames that are looked at together in the search for a touched line
REQUIREMENTS: Final = {Collision().name: R1, Lines().name: R2, Destination().name: R3}  # by the names of the specs


@dataclass(frozen=True)
class ViolationEvent:
    """When a spec was violated first.

    Attributes:
        spec: "R1", "R2", "R3", or the name of a user's spec.
        frame: frame of the trace; the last frame for all but R2.
        partner: the touched vehicle (R1, an index of `trace.size`), or the touched line (R2, an index of
            `trace.illegal_lines`); -1 for all others.
    """

    spec: str
    frame: int
    partner: int = -1


def violation_event(trace: Trace, violated: Sequence[str]) -> ViolationEvent | None:
    """Return the violation event of the first violated spec.

    R1 comes before R2 before R3, since a collision keeps the ego from its destination. Specs of a user come last.

    Args:
        trace: the trace of an episode.
        violated: names of the violated specs, as in `behavexplor.judge.specs.Verdict`.

    Returns:
        The event, or None if no spec is violated.
    """
    ranked = [*(name for name in REQUIREMENTS if name in violated), *violated]
    if not ranked or ranked[0] == ERROR:
        return None
    spec, last = REQUIREMENTS.get(ranked[0], ranked[0]), len(trace.time) - 1
    if spec == R1:
        npc = touched_npc(trace)
        return None if npc is None else ViolationEvent(R1, last, npc)
    if spec == R2:
        return first_line_touch(trace)
    return ViolationEvent(spec, last)


def first_line_touch(trace: Trace) -> ViolationEvent | None:
    """The first frame in which the ego's box touches an illegal line, and the line."""
    lines, position, heading = trace.illegal_lines, trace.position[:, 0], trace.heading[:, 0]
    if not len(lines):
        return None
    first = np.arange(0, len(position), _BLOCK)
    stray = position - np.repeat(position[first], _BLOCK, axis=0)[: len(position)]
    reach = np.hypot(*trace.size[0]) / 2 + np.maximum.reduceat(np.hypot(stray[:, 0], stray[:, 1]), first)
    block, line = np.nonzero(point_segment_distance(position[first, None], lines[:, 0], lines[:, 1]) <= reach[:, None])
    frame = np.minimum(first[block, None] + np.arange(_BLOCK), len(position) - 1).ravel()
    line = np.repeat(line, _BLOCK)
    near = gap_across(position[frame], heading[frame], trace.size[0], lines[line]) <= RESOLUTION
    frame, line = frame[near], line[near]
    box = box_corners(position[frame], heading[frame], trace.size[0])
    touching = np.flatnonzero(box_segment_distance(box, lines[line]) <= RESOLUTION)
    if not len(touching):
        return None
    earliest = touching[frame[touching].argmin()]
    return ViolationEvent(R2, int(frame[earliest]), int(line[earliest]))


def recent(trace: Trace, frame: int, seconds: float) -> Ints:
    """The frames of the last `seconds` up to a frame, at least that frame [s]."""
    return np.arange(np.searchsorted(trace.time, trace.time[frame] - seconds - 1e-9), frame + 1)


def recent_decisions(trace: Trace, frame: int, seconds: float) -> Ints:
    """The decisions given in the last `seconds` before a frame [s]."""
    given = trace.time[trace.action_frame]
    return np.flatnonzero((given >= trace.time[frame] - seconds - 1e-9) & (trace.action_frame < frame))
