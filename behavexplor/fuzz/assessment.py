"""What a search takes for the violation degree of a run, and for its failure, where it is not the verdict.

The verdict that is recorded is the specs' own (`behavexplor.judge.specs`), the same for every search method. The
authors' released program is guided by other figures than the paper prints; with these options a search can be, too.
"""

from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np

from behavexplor.data.roadmap import CURB, DOUBLE_YELLOW, RoadMap
from behavexplor.data.trace import Trace
from behavexplor.data.validation import between, validated
from behavexplor.judge.specs import Collision, Lines, Verdict

_REACH = 10.0  # distance to the destination beyond which more does not count [m], as in the paper's section III-B2
MAX_SHRINK = 1.0  # [m]; no vehicle is that narrow


@validated
class AssessmentOptions:
    """What a search is told about a run; the defaults are the verdict.

    Attributes:
        degree: the paper's O is the "sum" of the specs' degrees; or the mean of the "clipped" terms D_b, D_yellow,
            D_curb (at most 1 m each) and 1 - min(D, 10) / 10, as released.
        box_shrink: what is taken off the length and the width of every vehicle for the clipped terms [m].
        destination_threshold: the run fails if it ends farther than this from its destination [m]; None: as judged.
        retreat: the run fails, and is cut off, where its distance to the destination grows by more than this in
            one frame of the trace [m]; None: it may.

    Raises:
        InputError: naming the option that is out of range.
    """

    degree: Literal["sum", "clipped"] = "sum"
    box_shrink: Annotated[float, between(0, MAX_SHRINK)] = 0.0
    destination_threshold: Annotated[float, between(0)] | None = None
    retreat: Annotated[float, between(0)] | None = None


@dataclass(frozen=True)
class Assessment:
    """What a search is told about a run.

    Attributes:
        trace: what it sees of it.
        degree: the paper's O, lower is nearer to a violation.
        failed: whether it takes the run for a failure.
    """

    trace: Trace
    degree: float
    failed: bool


def assess(trace: Trace, verdict: Verdict, roadmap: RoadMap, options: AssessmentOptions) -> Assessment:
    """A run as the options have it seen.

    Args:
        trace: of the run.
        verdict: of the specs.
        roadmap: tells the kinds of the trace's illegal lines, which are this map's.
        options: how.
    """
    seen = _until_retreat(trace, options.retreat)
    degree = verdict.degree if options.degree == "sum" else _clipped_degree(seen, roadmap, options.box_shrink)
    failed = verdict.failed
    if options.destination_threshold is not None:
        others = [name for name in verdict.violated if name != "destination"]
        failed = bool(others) or seen.destination_distance > options.destination_threshold
    return Assessment(seen, degree, failed or seen is not trace)


def _until_retreat(trace: Trace, limit: float | None) -> Trace:
    """The trace up to the frame in which its distance to the destination grew by more than `limit`, if one did."""
    if limit is None:
        return trace
    apart = trace.position[:, 0] - trace.destination
    growing = np.flatnonzero(np.diff(np.hypot(apart[:, 0], apart[:, 1])) > limit)
    if not len(growing):
        return trace
    frames = int(growing[0]) + 2  # the frame in which it grew is the last one
    commands = trace.action_frame < frames
    return replace(
        trace,
        time=trace.time[:frames],
        position=trace.position[:frames],
        heading=trace.heading[:frames],
        velocity=trace.velocity[:frames],
        actions=trace.actions[commands],
        action_frame=trace.action_frame[commands],
        decisions={name: values[commands] for name, values in trace.decisions.items()},
    )


def _clipped_degree(trace: Trace, roadmap: RoadMap, shrink: float) -> float:
    smaller = replace(trace, size=trace.size - shrink)
    kinds = np.array(roadmap.line_kinds)
    terms = [Collision().degree(smaller)]
    terms += [
        Lines().degree(replace(smaller, illegal_lines=roadmap.illegal_lines[kinds == kind]))
        for kind in (DOUBLE_YELLOW, CURB)
    ]
    clipped = [min(term, 1.0) for term in terms]
    return float(np.mean([*clipped, 1 - min(trace.destination_distance, _REACH) / _REACH]))
