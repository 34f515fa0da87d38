"""The ego's maneuver and the other vehicle of a crash in a highway-env environment, as the lanes tell them.

There the ego chooses its lanes, so that no fixed route tells what it does, and a crash moves and turns the vehicles. So
the maneuver is what the ego did in the last second, and the other vehicle is where it was a second before the crash.
"""

import math
from typing import Final

import numpy as np

from behavexplor.data.conventions import wrapped
from behavexplor.data.trace import (
    CHANGING,
    ELSEWHERE,
    OBSTACLE,
    ON_ITS_WAY,
    PARTNER,
    PARTNER_LANES,
    WAY,
    WAYS,
    WRECKS,
    Trace,
)

BEFORE: Final = 1.0  # the time before a crash at which the vehicles are looked at [s]
ONCOMING: Final = math.pi * 3 / 4  # least angle between the headings of vehicles that meet [rad]
CROSSING: Final = math.pi / 4  # least angle between the headings of vehicles whose ways cross [rad]
IN_LINE: Final = 2.0  # a vehicle on another road that is no farther to the side is ahead or behind [m]
_PASSING: Final = frozenset({"turning-left", "turning-right", "entering-the-ring", "leaving-the-ring"})


def has_lane_signals(trace: Trace) -> bool:
    """Return whether a trace says what its vehicles' lanes were."""
    return WAY in trace.signals


def lane_change(trace: Trace, frame: int, seconds: float) -> str:
    """Return the side to which the ego last changed lanes in the last `seconds` [s]: "left", "right", or empty."""
    recent = trace.signals[CHANGING][trace.recent(frame, seconds)]
    sides = recent[recent != 0]
    if not len(sides):
        return ""
    return "right" if sides[-1] > 0 else "left"


def has_entered_ring(trace: Trace, frame: int, seconds: float) -> bool:
    """Return whether the ego entered a roundabout in the last `seconds` [s]."""
    return bool((trace.signals[WAY][trace.recent(frame, seconds)] == WAYS.index("entering-the-ring")).any())


def maneuver(trace: Trace, frame: int, after: float) -> str:
    """Return what the ego did in the last `BEFORE` seconds up to a frame in a highway-env environment.

    An earlier lane change, in the last `after` [s], is named as one that has ended.
    """
    side = lane_change(trace, frame, BEFORE)
    if side:
        return f"changing-{side}"
    ways = [WAYS[int(way)] for way in trace.signals[WAY][trace.recent(frame, BEFORE)]]
    passing = [way for way in ways if way in _PASSING]
    if passing:
        return passing[-1]
    side = lane_change(trace, frame, after)
    return f"having-changed-{side}" if side else ways[-1]


def had_crashed(trace: Trace, frame: int, npc: int) -> bool:
    """Return whether a vehicle had crashed before a frame."""
    return WRECKS in trace.signals and bool(trace.signals[WRECKS][:frame, npc].any())


def relation(trace: Trace, frame: int, npc: int) -> str:
    """Return what the other vehicle is, or where it was `BEFORE` the frame, or where it appeared if that was later."""
    where = trace.signals[PARTNER] if npc == trace.partner else np.full(len(trace.time), ELSEWHERE)
    if where[frame] == OBSTACLE:
        return "obstacle"
    if had_crashed(trace, frame, npc):
        return "crashed-before"
    seen = trace.recent(frame, BEFORE)
    begin = int(seen[trace.present[seen, npc].argmax()] if trace.present.size else seen[0])
    if where[begin] == ON_ITS_WAY:
        turned = wrapped(trace.heading[begin, npc] - trace.heading[begin, 0])
        ahead, _ = _seen_from(trace, begin, npc, turned / 2)  # in a bend, along the chord between them
        is_beside = abs(ahead) < (trace.size[0, 0] + trace.size[npc, 0]) / 2
        return _on_its_way(ahead, int(trace.signals[PARTNER_LANES][begin]), is_beside=bool(is_beside))
    return _on_another_road(trace, begin, npc)


def _seen_from(trace: Trace, frame: int, npc: int, turned: float = 0.0) -> tuple[float, float]:
    """Return how far a vehicle is ahead of the ego, and to the right [m], seen at the angle `turned` [rad]."""
    x, y = trace.position[frame, npc] - trace.position[frame, 0]
    heading = trace.heading[frame, 0] + turned
    cos, sin = math.cos(heading), math.sin(heading)
    return float(x * cos + y * sin), float(y * cos - x * sin)


def _on_another_road(trace: Trace, frame: int, npc: int) -> str:
    """Return where a vehicle on another road is or comes from: by the headings, or by its place if they are alike."""
    turned = wrapped(trace.heading[frame, npc] - trace.heading[frame, 0])
    if abs(turned) > ONCOMING:
        return "oncoming"
    if abs(turned) > CROSSING:
        return "crossing-from-left" if turned > 0 else "crossing-from-right"
    ahead, aside = _seen_from(trace, frame, npc)
    if abs(aside) < IN_LINE:
        return _on_its_way(ahead, 0, is_beside=False)
    return "merging-from-right" if aside > 0 else "merging-from-left"


def _on_its_way(ahead: float, lanes: int, *, is_beside: bool) -> str:
    """Return where a vehicle is that drives as the ego does: `ahead` of its center [m], `lanes` to the right of it."""
    if lanes == 0:
        return "leading" if ahead > 0 else "behind"
    side = "right" if lanes > 0 else "left"
    if is_beside:
        return f"on-the-{side}"
    return f"ahead-on-the-{side}" if ahead > 0 else f"behind-on-the-{side}"
