"""Signatures: the likely cause of a failure of the rule planner, from its trace and its decision log alone.

The rules follow the paper's sixteen paragraphs (section 4.1.2), as a person would apply them to a recording. A
signature names a weakness that changed the output of its module shortly before the violation, in a situation typical of
that weakness. Of several weaknesses, it names the first one in `_RULES`, where those whose situation is nearly always
given come last. The rules need no replay, unlike the causes that `behavexplor.triage.counterfactual` finds.
"""

from collections.abc import Callable, Sequence
from types import MappingProxyType
from typing import Final

import numpy as np

from behavexplor.data.conventions import STANDING_SPEED, wrapped
from behavexplor.data.trace import ENVIRONMENT, Trace, weakness_names
from behavexplor.judge.classes import LARGE
from behavexplor.judge.events import R1, R3, ViolationEvent, recent_decisions, violation_event
from behavexplor.judge.fault import contact_fault
from behavexplor.judge.situation import CREEPING, TURNED, heading_before, maneuver_of, speed_of

OUTLOOK: Final = 6.0  # time before a violation in which weaknesses are searched for [s]
SUDDEN: Final = 2.0  # greater acceleration or deceleration of the other vehicle is sudden [m/s2]
HIDDEN: Final = 0.2  # the other vehicle was hidden if it was out of sight for more than this share of the time


def signature(trace: Trace, violated: Sequence[str]) -> str | None:
    """Return the likely cause of the first violated spec, from a trace of the rule planner.

    It is one of the sixteen weaknesses, or "environment" if a faster vehicle drove into the ego's back; None if no
    weakness fits, no spec is violated, or the trace has no decision log.
    """
    event = violation_event(trace, violated)
    if event is None or "triggered" not in trace.decisions:
        return None
    if event.spec == R1 and contact_fault(trace) == "npc_rear_end":
        return ENVIRONMENT
    seconds = trace.duration if event.spec == R3 else OUTLOOK
    bits = trace.decisions["triggered"][recent_decisions(trace, event.frame, seconds)].astype(np.int64)
    triggered = weakness_names(int(np.bitwise_or.reduce(bits)))
    kindred = (name for name in _RULES if name in triggered and name.startswith(event.spec))
    return next((name for name in kindred if _RULES[name](trace, event)), None)


def _changing_lanes(trace: Trace, event: ViolationEvent) -> bool:
    return maneuver_of(trace, event.frame).startswith("changing")


def _overtaken_from(trace: Trace, event: ViolationEvent) -> bool:
    """Return whether the other vehicle came from behind while the ego changed lanes."""
    gap = trace.position[event.frame, event.partner] - trace.position[event.frame, 0]
    heading = trace.heading[event.frame, 0]
    return _changing_lanes(trace, event) and float(gap @ (np.cos(heading), np.sin(heading))) < 0.0


def _restarted(trace: Trace, event: ViolationEvent) -> bool:
    """Return whether the ego stood shortly before the violation."""
    frames = trace.recent(event.frame, OUTLOOK)
    return bool((np.hypot(*trace.velocity[frames, 0].T) < STANDING_SPEED).any())


def _crept(trace: Trace, event: ViolationEvent) -> bool:
    """Return whether the other vehicle crept most of the time."""
    speed = np.hypot(*trace.velocity[trace.recent(event.frame, OUTLOOK), event.partner].T)
    return float(np.median(speed)) < CREEPING


def _turned(trace: Trace, event: ViolationEvent) -> bool:
    """Return whether the other vehicle turned."""
    now = trace.heading[event.frame, event.partner]
    return abs(wrapped(now - heading_before(trace, event.frame, event.partner))) > TURNED


def _was_large(trace: Trace, event: ViolationEvent) -> bool:
    return bool(trace.size[event.partner, 0] > LARGE)


def _was_hidden(trace: Trace, event: ViolationEvent) -> bool:
    """Return whether the center of the other vehicle was out of the ego's sight for some time."""
    frames = trace.recent(event.frame, OUTLOOK)
    gap = trace.position[frames] - trace.position[frames][:, :1]
    distance = np.hypot(gap[..., 0], gap[..., 1])
    bearing = np.arctan2(gap[..., 1], gap[..., 0])
    apart = np.abs(np.remainder(bearing - bearing[:, [event.partner]] + np.pi, 2 * np.pi) - np.pi)
    covers = apart < np.arctan2(trace.size[:, 1] / 2, np.maximum(distance, 0.1))
    covers &= distance < distance[:, [event.partner]]
    covers[:, 0] = False
    return bool(covers.any(1).mean() > HIDDEN)


def _changed_suddenly(trace: Trace, event: ViolationEvent) -> bool:
    """Return whether the other vehicle changed its speed suddenly."""
    frames = trace.recent(event.frame, OUTLOOK)
    speed = np.hypot(*trace.velocity[frames, event.partner].T)
    return bool((np.abs(np.diff(speed) / np.diff(trace.time[frames])) > SUDDEN).any())


def _passed(trace: Trace, event: ViolationEvent) -> bool:  # noqa: ARG001 - a rule
    return trace.end == "passed"


def _ended_standing(trace: Trace, event: ViolationEvent) -> bool:
    return trace.end != "passed" and speed_of(trace, event.frame, 0) < STANDING_SPEED


def _always(trace: Trace, event: ViolationEvent) -> bool:  # noqa: ARG001 - a rule
    return True


_RULES: Final = MappingProxyType[str, Callable[[Trace, ViolationEvent], bool]](
    {  # in the order in which the rules are tried
        "R1-6": _overtaken_from,
        "R1-5": _changing_lanes,
        "R1-3": _restarted,
        "R1-2": _crept,
        "R1-8": _turned,
        "R1-7": _was_large,
        "R1-1": _was_hidden,
        "R1-4": _changed_suddenly,
        "R2-3": _always,
        "R2-2": _always,
        "R2-4": _always,
        "R2-1": _always,
        "R3-4": _ended_standing,
        "R3-3": _passed,
        "R3-2": _passed,
        "R3-1": _always,
    }
)
