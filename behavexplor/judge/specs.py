"""Requirements on a driving system: specs R1-R3, their violation degrees, and the verdict on a trace.

Source: paper section 2.3 (R1, R2, R3) and 3.2.2 (violation degree O). Traces are judged outside the search methods,
so that every method is scored by the same code. An episode in which the ego arrives is judged up to the moment of its
arrival (`poses_until_arrival`).

In a highway-env environment, a violation is what the environment itself says, as the signals of a trace. There a crash
pushes the vehicles apart, so that their boxes do not tell it. Lines may be crossed, and not every environment has a
destination.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from types import MappingProxyType
from typing import Final, Protocol

import numpy as np

from behavexplor.data.array_types import Floats, Ints
from behavexplor.data.conventions import ARRIVAL_DISTANCE
from behavexplor.data.geometry import (
    changed_frames,
    distances_from_first,
    distances_from_segments,
    gap_bounds,
    gaps_from_lines,
    near_segments,
)
from behavexplor.data.trace import ARRIVED, CRASHED, OFF_ROAD, RESOLUTION, Trace
from behavexplor.errors import InputError

ERROR: Final = "error"  # recorded in place of a violated spec if the ADS failed instead of returning an action
NOTHING_NEAR = 1000.0  # degree without any NPC or without any illegal line [m]
_TOLERANCE = 1e-10  # slack of the bounds [m]; far below a trace's resolution, so that parallel motion makes few ties
_FIRST_LOOK = 16  # number of exact distances computed first


class Spec(Protocol):
    """A requirement on a trace."""

    @property
    def name(self) -> str:
        """Name of the requirement in records and reports."""

    def degree(self, trace: Trace) -> float:
        """Return the violation degree, finite, in the spec's unit. A lower degree is closer to a violation."""

    def violated(self, trace: Trace) -> bool:
        """Return whether the trace violates the spec."""


@dataclass(frozen=True)
class Collision:
    """R1: the ego touches no NPC; in a highway-env environment, it does not crash.

    The degree is D_b, the least distance between the ego's box and an NPC's box [m] (paper equation 1).
    """

    name: str = field(default="collision", init=False)

    def degree(self, trace: Trace) -> float:
        """Return D_b [m], or `NOTHING_NEAR` without any NPC. In highway-env, it is 0 if and only if the ego crashed."""
        if CRASHED not in trace.signals:
            return _npc_distance(trace)
        return 0.0 if self.violated(trace) else max(_npc_distance(trace), RESOLUTION)

    def violated(self, trace: Trace) -> bool:
        """Return whether D_b is 0 (paper equation 2), or whether the environment says that the ego crashed."""
        if CRASHED in trace.signals:
            return bool(trace.signals[CRASHED].any())
        return _npc_distance(trace) == 0.0


@dataclass(frozen=True)
class Lines:
    """R2: the ego touches no illegal line; in a highway-env environment, it does not leave the road.

    The degree is D_l, the least distance between the ego's box and an illegal line [m] (paper equation 3).
    """

    name: str = field(default="lines", init=False)

    def degree(self, trace: Trace) -> float:
        """Return D_l [m], or `NOTHING_NEAR` without any illegal line. It is 0 for an ego that left the road."""
        return 0.0 if self.violated(trace) else _line_distance(trace)

    def violated(self, trace: Trace) -> bool:
        """Return whether D_l is 0 (paper equation 4), or whether the environment says that the ego left the road."""
        if OFF_ROAD in trace.signals:
            return bool(trace.signals[OFF_ROAD].any())
        return _line_distance(trace) == 0.0


@dataclass(frozen=True)
class Destination:
    """R3: the ego ends at its destination; in a highway-env environment that has one, it arrives there.

    The degree is max(10 - D, 0) (paper section 3.2.2), where D is the final distance of the ego's center from the
    destination [m], see `final_distance`. So the farther from the destination the episode ends, the lower is the
    degree.

    Attributes:
        name: name in records and reports.
        threshold: greatest D without a violation [m] (paper equation 5).
        reach: D beyond which the degree is 0 [m].
    """

    name: str = field(default="destination", init=False)
    threshold: float = ARRIVAL_DISTANCE
    reach: float = 10.0

    def degree(self, trace: Trace) -> float:
        """Return max(reach - D, 0) [m]. In a highway-env environment, it is 0 for a violation, or else `reach`."""
        if trace.signals:
            return 0.0 if self.violated(trace) else self.reach
        return max(self.reach - final_distance(trace), 0.0)

    def violated(self, trace: Trace) -> bool:
        """Return whether D exceeds the threshold, or whether the environment says that the ego did not arrive."""
        if trace.signals:
            return ARRIVED in trace.signals and not trace.signals[ARRIVED].any()
        return final_distance(trace) > self.threshold


SPECS: tuple[Spec, ...] = (Collision(), Lines(), Destination())  # the paper's R1, R2 and R3


@dataclass(frozen=True)
class Verdict:
    """The judgment of all specs on one trace.

    Attributes:
        degrees: violation degree by spec name, in the order of the specs.
        violated: names of the violated specs, in the same order.
    """

    degrees: Mapping[str, float]
    violated: tuple[str, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "degrees", MappingProxyType(dict(self.degrees)))

    @property
    def degree(self) -> float:
        """The paper's O: the sum of all violation degrees (paper equation 10)."""
        return sum(self.degrees.values())

    @property
    def failed(self) -> bool:
        """True if any spec is violated."""
        return bool(self.violated)


def judge(trace: Trace, specs: Sequence[Spec] = SPECS) -> Verdict:
    """Judge a trace by all specs.

    Raises:
        InputError: if two specs have the same name, a degree is not a finite number, or a user's spec fails.
    """
    degrees: dict[str, float] = {}
    for spec in specs:
        degree = float(spec.degree(trace))
        if spec.name in degrees:
            raise InputError(f"Two specs are named {spec.name!r}: give each a name of its own")
        if not np.isfinite(degree):
            raise InputError(f"The degree of the spec {spec.name!r} must be a finite number, got {degree}")
        degrees[spec.name] = degree
    return Verdict(degrees, tuple(spec.name for spec in specs if spec.violated(trace)))


@lru_cache(maxsize=2)
def _npc_distance(trace: Trace) -> float:
    """Return D_b [m]. Circles inside and around the boxes bound each distance, so few exact distances are needed."""
    if len(trace.size) == 1:
        return NOTHING_NEAR
    position, heading = poses_until_arrival(trace)
    reach = np.hypot(trace.size[:, 0], trace.size[:, 1]) / 2
    within = trace.size.min(1) / 2
    lower, upper = gap_bounds(position, heading, reach, within)

    def exact(pairs: Ints) -> Floats:
        frame, npc = np.divmod(pairs, len(trace.size) - 1)
        return distances_from_first(position, heading, trace.size, frame, npc + 1)

    return _least(lower.ravel(), upper, exact)


@lru_cache(maxsize=2)
def _line_distance(trace: Trace) -> float:
    """Return D_l [m]. Bounds are computed first, so the exact distance is needed for few pairs of frames and lines."""
    lines = trace.illegal_lines
    if not len(lines):
        return NOTHING_NEAR
    positions, headings = poses_until_arrival(trace)
    frames = changed_frames(positions, headings)
    position, heading = positions[frames, 0], headings[frames, 0]
    reach, within = np.hypot(*trace.size[0]) / 2, trace.size[0].min() / 2
    frame, line, upper = near_segments(position, lines, reach + _TOLERANCE, within)
    lower = gaps_from_lines(position[frame], heading[frame], trace.size[0], lines, line)

    def exact(pairs: Ints) -> Floats:
        at = frame[pairs]
        return distances_from_segments(position[at], heading[at], trace.size[0], lines, line[pairs])

    return _least(lower, upper, exact)


def _least(lower: Floats, upper: float, exact: Callable[[Ints], Floats]) -> float:
    """Return the least of n distances [m], given cheap bounds. A value of at most a trace's resolution counts as 0.

    `lower` are lower bounds, shape (n,). `upper` is an upper bound of the least. `exact` is a function from indices to
    exact distances.
    """
    open_ = np.flatnonzero(lower - _TOLERANCE <= upper)
    order = open_[np.argsort(lower[open_], kind="stable")]
    least, start, count = np.inf, 0, _FIRST_LOOK
    while start < len(order) and lower[order[start]] < least - _TOLERANCE:
        least = min(least, float(exact(order[start : start + count]).min()))
        start, count = start + count, 2 * count
    return least if least > RESOLUTION else 0.0


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
    """Return the poses of all vehicles up to the moment of arrival: positions (T, N, 2) [m], headings (T, N) [rad].

    The last frame of an ego that arrived is moved back to the moment at which its center came within
    `ARRIVAL_DISTANCE` of the destination, at the earliest to the frame before. All vehicles are interpolated linearly
    between these two frames. The poses of an episode with any other end are those of the trace.

    An episode ends in the first frame in which the ego's center is within `ARRIVAL_DISTANCE` of its destination. At a
    speed v, this frame lies up to v times the time between two frames behind the moment of arrival: 0.56 m at the speed
    limit and 20 Hz. How far behind is an accident of the sampling, and greater than the differences between most
    episodes. So what follows the arrival is not judged.
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
