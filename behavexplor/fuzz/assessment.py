"""Assessment: the violation degree and the failure that guide a search, where they differ from the recorded verdict.

The recorded verdict comes from the specs alone (`behavexplor.judge.specs`) and is the same for every search method. The
authors' released program is guided by figures that differ from the paper's formulas. These options reproduce them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np

from behavexplor.data.array_types import Floats
from behavexplor.data.geometry import point_box_distance
from behavexplor.data.roadmap import CURB, DOUBLE_YELLOW
from behavexplor.data.trace import Trace
from behavexplor.data.validation import between, validated
from behavexplor.judge.specs import Collision, Lines, Verdict, final_distance

_REACH = 10.0  # distance to the destination at which its term saturates [m], as in the paper's section 3.2.2
MAX_SHRINK = 1.0  # [m]; no vehicle is that narrow


@validated
class AssessmentOptions:
    """Options of the assessment of an execution. With the defaults it equals the verdict.

    Attributes:
        degree: violation degree. "sum" is the sum of the specs' degrees, the paper's O. "clipped" is the mean of the
            terms D_b, D_yellow, D_curb (at most 1 m each) and 1 - min(D, 10) / 10, as released.
        box_shrink: length by which every vehicle is made shorter and narrower [m], for the clipped terms and for a
            distance from the ego's box; twice the margin on each of its sides.
        destination_from: part of the ego whose distance from the destination counts: its "center", or its "box", within
            which the distance is 0.
        destination_threshold: distance from the destination beyond which the end of an execution counts as a failure
            [m]; None for the verdict of the spec.
        retreat: growth of the distance to the destination within one frame beyond which an execution counts as a
            failure and its trace is cut off [m]; None for no such limit.

    Raises:
        InputError: if an option is out of range; the message names the option.
    """

    degree: Literal["sum", "clipped"] = "sum"
    box_shrink: Annotated[float, between(0, MAX_SHRINK)] = 0.0
    destination_from: Literal["center", "box"] = "center"
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


def assess(trace: Trace, verdict: Verdict, line_kinds: Sequence[str], options: AssessmentOptions) -> Assessment:
    """Assess an execution.

    Args:
        trace: trace of the execution.
        verdict: verdict of the specs.
        line_kinds: the kinds of the illegal lines in the trace.
        options: options of the assessment.
    """
    seen = _until_retreat(trace, options)
    degree = verdict.degree if options.degree == "sum" else _clipped_degree(seen, line_kinds, options)
    failed = verdict.failed
    if options.destination_threshold is not None:
        others = [name for name in verdict.violated if name != "destination"]
        failed = bool(others) or _final_distance(seen, options) > options.destination_threshold
    return Assessment(seen, degree, failed or seen is not trace)


def _distances(trace: Trace, options: AssessmentOptions) -> Floats:
    """Compute the ego's distance from its destination in each frame, shape (T,) [m]."""
    position, heading = trace.position[:, 0], trace.heading[:, 0]
    size = trace.size[0] - options.box_shrink if options.destination_from == "box" else np.zeros(2)
    return point_box_distance(trace.destination, position, heading, size)


def _final_distance(trace: Trace, options: AssessmentOptions) -> float:
    return final_distance(trace) if options.destination_from == "center" else float(_distances(trace, options)[-1])


def _until_retreat(trace: Trace, options: AssessmentOptions) -> Trace:
    """Return the trace up to the first frame in which the distance to the destination grew by more than the limit.

    Without such a frame, or without a limit, return the trace itself.
    """
    if options.retreat is None:
        return trace
    growing = np.flatnonzero(np.diff(_distances(trace, options)) > options.retreat)
    if not len(growing):
        return trace
    frames = int(growing[0]) + 2  # keep the frame in which the distance grew
    return trace.until(frames, "timeout")


def _clipped_degree(trace: Trace, line_kinds: Sequence[str], options: AssessmentOptions) -> float:
    smaller = replace(trace, size=trace.size - options.box_shrink)
    kinds = np.array(line_kinds)
    terms = [Collision().degree(smaller)]
    terms += [
        Lines().degree(replace(smaller, illegal_lines=trace.illegal_lines[kinds == kind]))
        for kind in (DOUBLE_YELLOW, CURB)
    ]
    clipped = [min(term, 1.0) for term in terms]
    return float(np.mean([*clipped, 1 - min(_final_distance(trace, options), _REACH) / _REACH]))
