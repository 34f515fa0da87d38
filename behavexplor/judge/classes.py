"""Classes of violations, read from the trace alone, so that they apply to any driving system.

Two failures belong to one class if a person would describe them with the same words: the ego's maneuver, the direction
from which the other vehicle came, and its size. The bounds between classes lie where traffic has gaps, such as between
two directions at a crossing.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behavexplor.data.conventions import REAR_END_ANGLE, STANDING_SPEED, wrapped
from behavexplor.data.geometry import box_corners, project_on_polyline
from behavexplor.data.trace import Trace
from behavexplor.judge.events import R1, R2, R3, ViolationEvent, recent, violation_event
from behavexplor.judge.fault import CUT_IN_TIME

Floats = NDArray[np.float64]

LARGE: Final = 7.0  # vehicles longer than this are large [m]
CREEPING: Final = 2.0  # vehicles slower than this creep [m/s]
BRAKING: Final = 2.0  # least mean deceleration of a braking ego over the last `BRAKING_TIME` [m/s2]
BRAKING_TIME: Final = 1.0  # [s]
SLOW: Final = 6.0  # an ego that touches a line at less than this speed was slow [m/s]
BEFORE: Final = 30.0  # distance driven since a vehicle's earlier heading, long enough to lie before its turn [m]
TURNED: Final = 0.35  # a vehicle whose heading has changed by more than this since then has turned [rad]
CURVE: Final = 0.5  # a route whose heading changes by more than this has a curve [rad]
CURVE_EDGE: Final = 0.05  # the curve begins and ends where the heading has changed by this [rad]
BEHIND_CURVE: Final = 10.0  # distance after the curve over which the ego still counts as turning [m]
DRIFT: Final = 0.9  # an ego that has moved across its route by more than this is changing lanes [m]
CLOSE: Final = 15.0  # the ego follows a leader within this distance [m]
ASIDE: Final = 1.75  # lateral distance from the route or the ego beyond which a vehicle is in another lane [m]

_VEHICLES: Final = {  # the other vehicle of a collision, by the conflict, if it drove straight and if it had turned
    "leading": ("{} ahead", "{} ahead that had turned"),
    "from-behind": ("{} from behind", "{} from behind that had turned"),
    "on-the-right": ("{} on the right", "{} on the right that had turned"),
    "on-the-left": ("{} on the left", "{} on the left that had turned"),
    "oncoming": ("oncoming {}", "oncoming {} that had turned"),
    "crossing-from-right": ("{} crossing from the right", "{} that had turned in from the right"),
    "crossing-from-left": ("{} crossing from the left", "{} that had turned in from the left"),
}
_PHRASES: Final = {  # where the words of a class are not its id's
    "changing-right": "changing lanes right",
    "changing-left": "changing lanes left",
    "slow": "at low speed",
    "fast": "at speed",
    "ended-by-standstill": "stood still",
    "ended-by-timeout": "ran out of time",
    "never-in-its-lane": "without ever being in its lane",
    "having-left-its-lane": "after leaving its lane",
    "having-left-its-lane-again": "after entering its lane and leaving it again",
    "nobody-ahead": "with no vehicle ahead",
}


@dataclass(frozen=True)
class ViolationClass:
    """A kind of violation. Classes are comparable across campaigns.

    Attributes:
        spec: "R1", "R2", "R3", or the name of a user's spec.
        maneuver: the ego's maneuver.
        conflict: position or origin of the other vehicle (R1), side of the touched line (R2), or end of the episode
            (R3 and users' specs).
        mark: second distinction: size of the other vehicle (R1), speed of the ego (R2), or the vehicle ahead of the
            ego or its way past the destination (R3).
        detail: further information that does not distinguish classes: whether the ego braked, crept or stood, its
            touched side, and whether the other vehicle crept or stood.
    """

    spec: str
    maneuver: str
    conflict: str
    mark: str
    detail: str = field(default="", compare=False)

    @property
    def id(self) -> str:
        """Readable and stable identifier, such as "R1/turning-left/crossing-from-right/large"."""
        return "/".join(filter(None, (self.spec, self.maneuver, self.conflict, self.mark)))

    @property
    def words(self) -> str:
        """Class and detail as a sentence, such as "Collision with an oncoming car-sized vehicle; the ego was ..."."""
        if self.spec == R2:
            return f"Touched a line on its {self.conflict} {_phrase(self.mark)} while {_phrase(self.maneuver)}"
        if self.spec == R1:
            sentence = f"Collision with {_vehicle(self.conflict, self.mark)}"
        elif self.spec == R3:
            sentence = f"Missed the destination: {_phrase(self.conflict)} {_phrase(self.mark)}"
        else:
            sentence = f"Violated {self.spec} (end of the episode: {self.conflict.removeprefix('ended-by-')})"
        return f"{sentence}; the ego was {_phrase(self.maneuver)}" + (f", {self.detail}" if self.detail else "")


def _phrase(part: str) -> str:
    return _PHRASES.get(part, part.replace("-", " "))


def _vehicle(conflict: str, size: str) -> str:
    """Describe the other vehicle of a collision, with its article."""
    straight, turned = _VEHICLES[conflict.removesuffix("-turning")]
    words = (turned if conflict.endswith("-turning") else straight).format(f"{size} vehicle")
    return f"an {words}" if words.startswith("oncoming") else f"a {words}"


def violation_class(trace: Trace, violated: Sequence[str]) -> ViolationClass | None:
    """Return the class of the first violated spec, R1 before R2 before R3 before the specs of a user.

    Args:
        trace: the trace of an episode. Its decision log is not used.
        violated: names of the violated specs, as in `behavexplor.judge.specs.Verdict`.

    Returns:
        The class, or None if no spec is violated.
    """
    event = violation_event(trace, violated)
    if event is None:
        return None
    return {R1: _collision, R2: _line, R3: _destination}.get(event.spec, _other)(trace, event)


def _collision(trace: Trace, event: ViolationEvent) -> ViolationClass:
    frame, npc = event.frame, event.partner
    size = "large" if trace.size[npc, 0] > LARGE else "car-sized"
    motion = motion_of(trace, frame, npc)
    ego = ", ".join(filter(None, (_behavior(trace, frame), f"with contact at its {_side(trace, frame, npc)}")))
    detail = ego + (f"; the other vehicle was {motion}" if motion else "")
    return ViolationClass(R1, maneuver_of(trace, frame), _bearing(trace, frame, npc), size, detail)


def _line(trace: Trace, event: ViolationEvent) -> ViolationClass:
    frame = event.frame
    start, end = trace.illegal_lines[event.partner]
    place, along = trace.position[frame, 0], end - start
    nearest = start + np.clip((place - start) @ along / (along @ along), 0.0, 1.0) * along
    side = "right" if _across(nearest - place, trace.heading[frame, 0]) > 0 else "left"
    speed = "slow" if speed_of(trace, frame, 0) < SLOW else "fast"
    return ViolationClass(R2, maneuver_of(trace, frame), side, speed)


def _destination(trace: Trace, event: ViolationEvent) -> ViolationClass:
    frame, maneuver = event.frame, maneuver_of(trace, event.frame)
    if trace.end == "passed":
        offset = trace.position[frame, 0] - trace.destination
        side = "right" if _across(offset, trace.heading[frame, 0]) > 0 else "left"
        return ViolationClass(R3, maneuver, f"passed-it-on-the-{side}", _way_there(trace))
    leader = _ahead(trace, frame)
    behind = "nobody-ahead" if leader is None else f"behind-a-{motion_of(trace, frame, leader) or 'moving'}-vehicle"
    return ViolationClass(R3, maneuver, f"ended-by-{trace.end}", behind, _behavior(trace, frame))


def _other(trace: Trace, event: ViolationEvent) -> ViolationClass:
    """Return the class for a user's spec, made of its name, the ego's maneuver and the end of the episode."""
    frame = event.frame
    return ViolationClass(event.spec, maneuver_of(trace, frame), f"ended-by-{trace.end}", "", _behavior(trace, frame))


def _way_there(trace: Trace) -> str:
    """Return when an ego that missed its destination was in the lane of its route: never, from the start, or later."""
    offset = np.abs(_offsets(trace))
    if (offset > ASIDE).all():
        return "never-in-its-lane"
    return "having-left-its-lane" if offset[0] <= ASIDE else "having-left-its-lane-again"


def _offsets(trace: Trace) -> Floats:
    """Return the ego's offsets from its route, positive to the right, shape (T,) [m]."""
    station, along = project_on_polyline(trace.position[:, 0], trace.route)
    ends = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(trace.route, axis=0).T))])
    nearest = np.stack([np.interp(station, ends, trace.route[:, i]) for i in range(2)], -1)
    gap = trace.position[:, 0] - nearest
    return np.asarray(gap[:, 1] * np.cos(along) - gap[:, 0] * np.sin(along))


def maneuver_of(trace: Trace, frame: int) -> str:
    """Return the ego's maneuver at a frame: a turn of its route, a lane change, or going straight."""
    frames = recent(trace, frame, CUT_IN_TIME)
    station, along = project_on_polyline(trace.position[frames, 0], trace.route)
    turn = _turn(trace.route, float(station[-1]))
    if turn:
        return turn
    velocity = trace.velocity[frames[:-1], 0]
    across = velocity[:, 1] * np.cos(along[:-1]) - velocity[:, 0] * np.sin(along[:-1])
    drift = float(across @ np.diff(trace.time[frames]))
    if abs(drift) > DRIFT:
        return "changing-right" if drift > 0 else "changing-left"
    return "going-straight"


def _turn(route: Floats, station: float) -> str:
    """Return the turn of a route at a station [m]; empty where the route is straight."""
    along = np.diff(route, axis=0)
    heading = np.unwrap(np.arctan2(along[:, 1], along[:, 0]))
    turned = heading[-1] - heading[0]
    if abs(turned) < CURVE:
        return ""
    ends = np.cumsum(np.hypot(along[:, 0], along[:, 1]))
    begin = ends[np.argmax(np.abs(heading - heading[0]) > CURVE_EDGE)]
    end = ends[len(heading) - 1 - np.argmax(np.abs(heading - heading[-1])[::-1] > CURVE_EDGE)]
    if not begin <= station <= end + BEHIND_CURVE:
        return ""
    return "turning-right" if turned > 0 else "turning-left"


def _bearing(trace: Trace, frame: int, npc: int) -> str:
    """Return the position or origin of the other vehicle relative to the ego, with a suffix if it had turned."""
    now = wrapped(trace.heading[frame, npc] - trace.heading[frame, 0])
    before = heading_before(trace, frame, npc)
    turning = "-turning" if abs(wrapped(trace.heading[frame, npc] - before)) > TURNED else ""
    if abs(now) < REAR_END_ANGLE:
        return _relation(trace, frame, npc) + turning
    came = wrapped(before - heading_before(trace, frame, 0))
    if abs(came) > math.pi * 3 / 4:
        return "oncoming" + turning
    if abs(came) < math.pi / 4:  # it came from the ego's direction, and turned across the ego's path
        return _relation(trace, frame, npc) + turning
    return ("crossing-from-left" if came > 0 else "crossing-from-right") + turning


def _relation(trace: Trace, frame: int, npc: int) -> str:
    """Return the position of a vehicle relative to the ego: leading, from behind, or on one side."""
    gap = trace.position[frame, npc] - trace.position[frame, 0]
    heading = trace.heading[frame, 0]
    ahead = float(gap[0] * math.cos(heading) + gap[1] * math.sin(heading))
    if ahead > trace.size[0, 0] / 2:
        return "leading"
    if ahead < -trace.size[0, 0] / 2:
        return "from-behind"
    return "on-the-right" if _across(gap, heading) > 0 else "on-the-left"


def heading_before(trace: Trace, frame: int, vehicle: int) -> float:
    """Return a vehicle's heading before it drove the last `BEFORE` meters, at the earliest in the first frame [rad]."""
    steps = np.diff(trace.position[: frame + 1, vehicle], axis=0)
    left = np.cumsum(np.hypot(steps[:, 0], steps[:, 1])[::-1])  # distance left to drive [m]
    back = int(np.searchsorted(left, BEFORE))
    return float(trace.heading[max(frame - back, 0), vehicle])


def _side(trace: Trace, frame: int, npc: int) -> str:
    """Return the touched side of the ego: front, rear, left or right."""
    boxes = box_corners(trace.position[frame, [0, npc]], trace.heading[frame, [0, npc]], trace.size[[0, npc]])
    points = np.concatenate([_outline(boxes[0]), _outline(boxes[1])])
    depth = np.maximum(_beyond(points, trace, frame, 0), _beyond(points, trace, frame, npc))
    touched = points[depth <= depth.min() + 0.1].mean(0) - trace.position[frame, 0]
    heading = trace.heading[frame, 0]
    ahead = (touched[0] * math.cos(heading) + touched[1] * math.sin(heading)) / trace.size[0, 0]
    across = _across(touched, heading) / trace.size[0, 1]
    if abs(ahead) >= abs(across):
        return "front" if ahead > 0 else "rear"
    return "right" if across > 0 else "left"


def _outline(box: Floats) -> Floats:
    """Return 48 points along the edges of a box of shape (4, 2), shape (48, 2)."""
    share = np.linspace(0, 1, 12, endpoint=False)[:, None, None]
    return np.asarray((1 - share) * box + share * np.roll(box, -1, axis=0)).reshape(-1, 2)


def _beyond(points: Floats, trace: Trace, frame: int, vehicle: int) -> Floats:
    """Return how far points lie outside a vehicle's box along its nearest axis, negative inside, shape (n,) [m]."""
    heading = trace.heading[frame, vehicle]
    x, y = (points - trace.position[frame, vehicle]).T
    ahead, across = x * math.cos(heading) + y * math.sin(heading), y * math.cos(heading) - x * math.sin(heading)
    length, width = trace.size[vehicle]
    return np.asarray(np.maximum(np.abs(ahead) - length / 2, np.abs(across) - width / 2))


def _ahead(trace: Trace, frame: int) -> int | None:
    """Return the nearest vehicle close ahead of the ego and in its way, or None."""
    gaps = trace.position[frame, 1:] - trace.position[frame, 0]
    heading = trace.heading[frame, 0]
    ahead = gaps[:, 0] * math.cos(heading) + gaps[:, 1] * math.sin(heading)
    across = gaps[:, 1] * math.cos(heading) - gaps[:, 0] * math.sin(heading)
    reach = ahead - (trace.size[0, 0] + trace.size[1:, 0]) / 2
    in_way = (ahead > 0) & (reach < CLOSE) & (np.abs(across) < ASIDE + trace.size[1:, 1] / 2)
    return 1 + int(np.where(in_way, reach, np.inf).argmin()) if in_way.any() else None


def motion_of(trace: Trace, frame: int, vehicle: int) -> str:
    """Return "standing" or "creeping"; empty for a faster vehicle."""
    speed = speed_of(trace, frame, vehicle)
    if speed < STANDING_SPEED:
        return "standing"
    return "creeping" if speed < CREEPING else ""


def _behavior(trace: Trace, frame: int) -> str:
    """Return "standing", "braking" or "creeping"; empty if the ego drives on."""
    speed, motion = speed_of(trace, frame, 0), motion_of(trace, frame, 0)
    if motion == "standing":
        return motion
    begin = int(recent(trace, frame, BRAKING_TIME)[0])
    elapsed = trace.time[frame] - trace.time[begin]
    if elapsed > 0 and (speed_of(trace, begin, 0) - speed) / elapsed > BRAKING:
        return "braking"
    return motion


def speed_of(trace: Trace, frame: int, vehicle: int) -> float:
    """Return the speed of a vehicle [m/s]."""
    return math.hypot(*trace.velocity[frame, vehicle])


def _across(gap: Floats, heading: float) -> float:
    """Return the component of a gap across a heading, positive to the right [m]."""
    return float(gap[1] * math.cos(heading) - gap[0] * math.sin(heading))
