"""Classes of violations, read from the trace alone, so that they apply to any driving system.

Two failures belong to one class if a person would describe them with the same words: the ego's maneuver, the direction
from which the other vehicle came, and its size. The bounds between classes lie where traffic has gaps, such as between
two directions at a crossing. In highway-env's own environments, maneuver and direction are read from the signals that
`behavexplor.envs.highway.episode_record` makes of the vehicles' lanes (`behavexplor.judge.lanes`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, Self

import numpy as np

from behavexplor.data.array_types import Floats
from behavexplor.data.trace import Trace
from behavexplor.judge.events import R1, R2, R3, ViolationEvent, violation_event
from behavexplor.judge.lanes import had_crashed
from behavexplor.judge.situation import (
    HALF_LANE,
    bearing_of,
    behavior_of,
    leader_of,
    maneuver_of,
    motion_of,
    offset_to_right,
    route_offsets,
    speed_of,
    touched_side,
)

LARGE: Final = 7.0  # vehicles longer than this are large [m]
SLOW: Final = 6.0  # an ego that touches a line at less than this speed was slow [m/s]

_OFF: Final = "off-"  # begins the side on which an ego left the road of a highway-env environment

_VEHICLES: Final = {  # the other vehicle of a collision, by the conflict, if it drove straight and if it had turned
    "leading": ("{} ahead", "{} ahead that had turned"),
    "from-behind": ("{} from behind", "{} from behind that had turned"),
    "on-the-right": ("{} on the right", "{} on the right that had turned"),
    "on-the-left": ("{} on the left", "{} on the left that had turned"),
    "oncoming": ("oncoming {}", "oncoming {} that had turned"),
    "crossing-from-right": ("{} crossing from the right", "{} that had turned in from the right"),
    "crossing-from-left": ("{} crossing from the left", "{} that had turned in from the left"),
    "behind": ("{} behind", ""),  # this and the rest only in highway-env: mostly where it was a second before the crash
    "ahead-on-the-right": ("{} ahead in a lane to the right", ""),
    "ahead-on-the-left": ("{} ahead in a lane to the left", ""),
    "behind-on-the-right": ("{} behind in a lane to the right", ""),
    "behind-on-the-left": ("{} behind in a lane to the left", ""),
    "merging-from-right": ("{} merging from the right", ""),
    "merging-from-left": ("{} merging from the left", ""),
    "crashed-before": ("{} that had crashed before", ""),
}
_PHRASES: Final = {  # where the words of a class are not its id's
    "changing-right": "changing lanes right",
    "changing-left": "changing lanes left",
    "having-changed-right": "going on after changing lanes right",
    "having-changed-left": "going on after changing lanes left",
    "slow": "at low speed",
    "fast": "at speed",
    "ended-by-standstill": "stood still",
    "ended-by-timeout": "ran out of time",
    "never-in-its-lane": "without ever being in its lane",
    "having-left-its-lane": "after leaving its lane",
    "having-left-its-lane-again": "after entering its lane and leaving it again",
    "nobody-ahead": "with no vehicle ahead",
}
_WHOLE: Final = {  # classes without parts: of executions in which the driving system failed, and of bare collisions
    R1: "Collision with something that is not known",
    "error/raised": "The driving system raised an exception",
    "error/invalid": "The driving system returned something that is not an action",
    "error/exit": "The driving system ended its process by sys.exit",
    "error/memory": "The driving system ran out of memory",
    "error/hang": "The driving system did not answer in time",
    "error/crash": "The process of the driving system died",
}


@dataclass(frozen=True)
class ViolationClass:
    """A kind of violation. Classes are comparable across campaigns."""

    spec: str  # "R1", "R2", "R3", or the name of a user's spec
    maneuver: str  # the ego's maneuver

    # R1: position or origin of the other vehicle, or what it was; R2: side of the touched line, or "off-" and the side
    # on which the ego left the road; R3 and users' specs: end of the episode
    conflict: str
    # second distinction. R1: size of the other vehicle; R2: speed of the ego; R3: the vehicle ahead of the ego, or its
    # way past the destination
    mark: str
    # further information that does not distinguish classes: whether the ego braked, crept or stood, its touched side,
    # and whether the other vehicle crept or stood
    detail: str = field(default="", compare=False)

    @property
    def id(self) -> str:
        """Readable and stable identifier, such as "R1/turning-left/crossing-from-right/large"."""
        return "/".join(filter(None, (self.spec, self.maneuver, self.conflict, self.mark)))

    @classmethod
    def from_id(cls, class_id: str) -> Self:
        """Return the class, without a detail, from its id.

        Raises:
            ValueError: if it is not the id of a class.
        """
        spec, maneuver, conflict, *mark = class_id.split("/")
        return cls(spec, maneuver, conflict, "/".join(mark))

    @property
    def words(self) -> str:
        """Class and detail as a sentence, such as "Collision with an oncoming car-sized vehicle; the ego was ..."."""
        if self.spec == R2:
            what = "Left the road" if self.conflict.startswith(_OFF) else "Touched a line"
            side = self.conflict.removeprefix(_OFF)
            return f"{what} on its {side} {_phrase(self.mark)} while {_phrase(self.maneuver)}"
        if self.spec == R1:
            sentence = f"Collision with {_vehicle(self.conflict, self.mark)}"
        elif self.spec == R3:
            sentence = f"Missed the destination: {_phrase(self.conflict)} {_phrase(self.mark)}"
        else:
            sentence = f"Violated {self.spec} (end of the episode: {self.conflict.removeprefix('ended-by-')})"
        return f"{sentence}; the ego was {_phrase(self.maneuver)}" + (f", {self.detail}" if self.detail else "")


def words_of(class_id: str) -> str:
    """Return the class in a record as a sentence, without the details that only the trace tells.

    The class of an execution in which the driving system failed is "error/" and the kind of its failure. That of a
    collision without a known vehicle or obstacle is "R1". A class that is not known is its own sentence.
    """
    kind = _WHOLE.get(class_id)
    if kind is not None:
        return kind
    try:
        return ViolationClass.from_id(class_id).words
    except (ValueError, KeyError):
        return class_id


def _phrase(part: str) -> str:
    return _PHRASES.get(part, part.replace("-", " "))


def _vehicle(conflict: str, size: str) -> str:
    """Describe the other vehicle of a collision, or the obstacle, with its article."""
    if conflict == "obstacle":
        return "an obstacle"
    straight, turned = _VEHICLES[conflict.removesuffix("-turning")]
    words = (turned if conflict.endswith("-turning") else straight).format(f"{size} vehicle")
    return f"an {words}" if words.startswith("oncoming") else f"a {words}"


def violation_class(trace: Trace, violated: Sequence[str]) -> ViolationClass | None:
    """Return the class of the first violated spec, R1 before R2 before R3 before the specs of a user; None if none is.

    For the names of specs, see `behavexplor.judge.specs.Verdict`. The decision log of the trace is not used.
    """
    event = violation_event(trace, violated)
    return None if event is None else event_class(trace, event)


def event_class(trace: Trace, event: ViolationEvent, end: str | None = None) -> ViolationClass:
    """Return the class of a violation event, or the class that a violation would have had at a near miss.

    The decision log of the trace is not used. `end` is the kind of end that a violation of R3 would have had; None for
    that of the trace.
    """
    if event.spec == R1:
        return _collision(trace, event)
    if event.spec == R2:
        return _line(trace, event)
    if event.spec == R3:
        return _destination(trace, event, end or trace.end)
    return _other(trace, event, end or trace.end)


def _collision(trace: Trace, event: ViolationEvent) -> ViolationClass:
    frame, npc = event.frame, event.partner
    bearing, motion = bearing_of(trace, frame, npc), motion_of(trace, frame, npc)
    size = "large" if trace.size[npc, 0] > LARGE else "car-sized"
    if bearing == "obstacle":
        size = motion = ""
    ego = ", ".join(filter(None, (behavior_of(trace, frame), f"with contact at its {touched_side(trace, frame, npc)}")))
    detail = ego + (f"; the other vehicle was {motion}" if motion else "")
    return ViolationClass(R1, maneuver_of(trace, frame), bearing, size, detail)


def _line(trace: Trace, event: ViolationEvent) -> ViolationClass:
    frame = event.frame
    if event.partner < 0:
        side = _OFF + ("right" if route_offsets(trace)[frame] > 0 else "left")
    else:
        side = _side_of_line(trace, frame, trace.illegal_lines[event.partner])
    speed = "slow" if speed_of(trace, frame, 0) < SLOW else "fast"
    return ViolationClass(R2, maneuver_of(trace, frame), side, speed)


def _side_of_line(trace: Trace, frame: int, line: Floats) -> str:
    """Return the side of the ego on which a line lies, given its end points, shape (2, 2)."""
    start, end = line
    place, along = trace.position[frame, 0], end - start
    nearest = start + np.clip((place - start) @ along / (along @ along), 0.0, 1.0) * along
    return "right" if offset_to_right(nearest - place, trace.heading[frame, 0]) > 0 else "left"


def _destination(trace: Trace, event: ViolationEvent, end: str) -> ViolationClass:
    frame, maneuver = event.frame, maneuver_of(trace, event.frame)
    if end == "passed":
        offset = trace.position[frame, 0] - trace.destination
        side = "right" if offset_to_right(offset, trace.heading[frame, 0]) > 0 else "left"
        return ViolationClass(R3, maneuver, f"passed-it-on-the-{side}", _way_there(trace))
    leader = leader_of(trace, frame)
    behind = "nobody-ahead" if leader is None else f"behind-a-{_motion_of_leader(trace, frame, leader)}-vehicle"
    return ViolationClass(R3, maneuver, f"ended-by-{end}", behind, behavior_of(trace, frame))


def _motion_of_leader(trace: Trace, frame: int, leader: int) -> str:
    return "crashed" if had_crashed(trace, frame, leader) else motion_of(trace, frame, leader) or "moving"


def _other(trace: Trace, event: ViolationEvent, end: str) -> ViolationClass:
    """Return the class for a user's spec, made of its name, the ego's maneuver and the end of the episode."""
    frame = event.frame
    return ViolationClass(event.spec, maneuver_of(trace, frame), f"ended-by-{end}", "", behavior_of(trace, frame))


def _way_there(trace: Trace) -> str:
    """Return when an ego that missed its destination was in the lane of its route: never, from the start, or later."""
    offset = np.abs(route_offsets(trace))
    if (offset > HALF_LANE).all():
        return "never-in-its-lane"
    return "having-left-its-lane" if offset[0] <= HALF_LANE else "having-left-its-lane-again"
