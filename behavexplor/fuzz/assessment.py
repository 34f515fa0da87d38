"""Assessment: the violation degree and the failure that guide a search, where they differ from the recorded verdict.

The recorded verdict comes from the specs alone (`behavexplor.judge.specs`) and is the same for every search method. The
authors' released program is guided by figures that differ from the paper's formulas. These options reproduce them.
"""

from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np

from behavexplor.data.roadmap import CURB, DOUBLE_YELLOW, RoadMap
from behavexplor.data.trace import Trace
from behavexplor.data.validation import between, validated
from behavexplor.judge.specs import Collision, Lines, Verdict

_REACH = 10.0  # distance to the destination at which its term saturates [m], as in the paper's section III-B2
MAX_SHRINK = 1.0  # [m]; no vehicle is that narrow


@validated
class AssessmentOptions:
    """Options of the assessment of an execution. With the defaults it equals the verdict.

    Attributes:
        degree: violation degree. "sum" is the sum of the specs' degrees, the paper's O. "clipped" is the mean of the
            terms D_b, D_yellow, D_curb (at most 1 m each) and 1 - min(D, 10) / 10, as released.
        box_shrink: length by which every vehicle is made shorter and narrower for the clipped terms [m].
        destination_threshold: distance from the destination beyond which the end of an execution counts as a failure
            [m]; None for the verdict of the spec.
        retreat: growth of the distance to the destination within one frame beyond which an execution counts as a
            failure and its trace is cut off [m]; None for no such limit.

    Raises:
        InputError: if an option is out of range; the message names the option.
    """

    degree: Literal["sum", "clipped"] = "sum"
    box_shrink: Annotated[float, between(0, MAX_SHRINK)] = 0.0
    destination_threshold: Annotated[float, between(0)] | None = None
    retreat: Annotated[float, between(0)] | None = None


@dataclass(frozen=True)
class Assessment:
    """Assessment of an execution for a search.

    Attributes:
        trace: the trace, up to its cut if it was cut off.
        degree: violation degree, the paper's O. A lower degree is nearer to a violation.
        failed: whether the execution counts as a failure.
    """

    trace: Trace
    degree: float
    failed: bool


def assess(trace: Trace, verdict: Verdict, roadmap: RoadMap, options: AssessmentOptions) -> Assessment:
    """Assess an execution.

    Args:
        trace: trace of the execution.
        verdict: verdict of the specs.
        roadmap: map of the execution, which gives the kinds of the illegal lines in the trace.
        options: options of the assessment.
    """
    seen = _until_retreat(trace, options.retreat)
    degree = verdict.degree if options.degree == "sum" else _clipped_degree(seen, roadmap, options.box_shrink)
    failed = verdict.failed
    if options.destination_threshold is not None:
        others = [name for name in verdict.violated if name != "destination"]
        failed = bool(others) or seen.destination_distance > options.destination_threshold
    return Assessment(seen, degree, failed or seen is not trace)


def _until_retreat(trace: Trace, limit: float | None) -> Trace:
    """Return the trace up to the first frame in which the distance to the destination grew by more than `limit`.

    Without such a frame, or with a limit of None, return the trace itself.
    """
    if limit is None:
        return trace
    apart = trace.position[:, 0] - trace.destination
    growing = np.flatnonzero(np.diff(np.hypot(apart[:, 0], apart[:, 1])) > limit)
    if not len(growing):
        return trace
    frames = int(growing[0]) + 2  # keep the frame in which the distance grew
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
