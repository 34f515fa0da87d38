"""Classes of violations, of any ADS: what happened, read from the trace alone.

Two failures are of one class if a person would describe them with the same words: what the ego was doing, where the
other came from, how large it was. Bounds lie where traffic has gaps, such as between two directions at a crossing.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behavexplor.data.geometry import box_corners, project_on_polyline
from behavexplor.data.trace import Trace
from behavexplor.judge.events import R1, R2, R3, ViolationEvent, recent, violation_event
from behavexplor.judge.fault import ALIGNED, CUT_IN_TIME, STATIONARY_SPEED

Floats = NDArray[np.float64]

LARGE: Final = 7.0  # vehicles longer than this are large [m]
CREEPING: Final = 2.0  # slower ones creep [m/s]
BRAKING: Final = 2.0  # mean deceleration in the last `BRAKING_TIME` of one that brakes [m/s2]
BRAKING_TIME: Final = 1.0  # [s]
SLOW: Final = 6.0  # below, an ego that touches a line was slow [m/s]
BEFORE: Final = 30.0  # so far back on its way a vehicle had not begun the turn that it is in [m]
TURNED: Final = 0.35  # since then one that turns has turned by more than this [rad]
CURVE: Final = 0.5  # a route that turns by more than this has a curve [rad]
CURVE_EDGE: Final = 0.05  # which begins and ends where the heading has changed by this [rad]
BEHIND_CURVE: Final = 10.0  # so far behind it the ego is still coming out of it [m]
DRIFT: Final = 0.9  # who moved by more than this across the route is changing lanes [m]
CLOSE: Final = 15.0  # a leader within this is followed [m]
ASIDE: Final = 1.75  # who is farther from the ego's middle is in another lane [m]


@dataclass(frozen=True)
class ViolationClass:
    """What a violation looks like; equal in all campaigns.

    Attributes:
        spec: "R1", "R2", "R3", or the name of a user's spec.
        maneuver: of the ego.
        conflict: where the other was or came from (R1), on which side the touched line was (R2), how the drive ended
            (R3).
        mark: what else sets classes apart: the other's size (R1), whether the ego was slow (R2), behind whom it was or
            what it did before (R3).
        detail: what one looks at next, and does not set classes apart: which side of the ego was touched, whether the
            other crept or stood, whether the ego braked, crept or stood.
    """

    spec: str
    maneuver: str
    conflict: str
    mark: str
    detail: str = field(default="", compare=False)

    @property
    def id(self) -> str:
        """Readable and stable, such as "R1/turning-left/crossing-from-right/large"."""
        return "/".join(filter(None, (self.spec, self.maneuver, self.conflict, self.mark)))

    @property
    def words(self) -> str:
        """A line for people, with the detail."""
        what = {
            R1: f"Collision with a {self.mark} vehicle {self.conflict}",
            R2: f"Touched a line on the {self.conflict}, {self.mark}",
            R3: ", ".join(filter(None, (f"Not at the destination: {self.conflict}", self.mark))),
        }.get(self.spec, f"Violated {self.spec}; the episode {self.conflict}")
        words = f"{what}; the ego was {self.maneuver}" + (f", {self.detail}" if self.detail else "")
        return words.replace("-", " ")


def violation_class(trace: Trace, violated: Sequence[str]) -> ViolationClass | None:
    """Return the class of the first violated spec, R1 before R2 before R3 before the specs of a user.

    Args:
        trace: the trace of an episode. Its decision log is not looked at.
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
    other = f"the other {motion}, " if motion else ""
    detail = f"touched at its {_side(trace, frame, npc)}, {other}{_behavior(trace, frame)}"
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
    """Return the class of a user's spec: only its name, the ego's maneuver and the end of the episode are known."""
    frame = event.frame
    return ViolationClass(event.spec, maneuver_of(trace, frame), f"ended-by-{trace.end}", "", _behavior(trace, frame))


def _way_there(trace: Trace) -> str:
    """Whether an ego that passed its destination beside it ever was in its route's lane."""
    offset = np.abs(_offsets(trace))
    if (offset > ASIDE).all():
        return "never-in-its-lane"
    return "having-left-its-lane" if offset[0] <= ASIDE else "having-left-its-lane-again"


def _offsets(trace: Trace) -> Floats:
    """Distances of the ego from its route, right is positive, shape (T,) [m]."""
    station, along = project_on_polyline(trace.position[:, 0], trace.route)
    ends = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(trace.route, axis=0).T))])
    nearest = np.stack([np.interp(station, ends, trace.route[:, i]) for i in range(2)], -1)
    gap = trace.position[:, 0] - nearest
    return np.asarray(gap[:, 1] * np.cos(along) - gap[:, 0] * np.sin(along))


def maneuver_of(trace: Trace, frame: int) -> str:
    """What the ego's route and its motion across it amount to."""
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
    """The turn of the route around a station; empty where it is straight."""
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
    """Where the other was, or came from, as the ego saw it; and whether it was in a turn of its own."""
    now = wrapped(trace.heading[frame, npc] - trace.heading[frame, 0])
    before = heading_before(trace, frame, npc)
    turning = "-turning" if abs(wrapped(trace.heading[frame, npc] - before)) > TURNED else ""
    if abs(now) < ALIGNED:
        return _relation(trace, frame, npc) + turning
    came = wrapped(before - heading_before(trace, frame, 0))
    if abs(came) > math.pi * 3 / 4:
        return "oncoming" + turning
    if abs(came) < math.pi / 4:  # it came the same way, and turned across the ego's
        return _relation(trace, frame, npc) + turning
    return ("crossing-from-left" if came > 0 else "crossing-from-right") + turning


def _relation(trace: Trace, frame: int, npc: int) -> str:
    """Where another is beside the ego: leading, from behind, beside."""
    gap = trace.position[frame, npc] - trace.position[frame, 0]
    heading = trace.heading[frame, 0]
    ahead = float(gap[0] * math.cos(heading) + gap[1] * math.sin(heading))
    if ahead > trace.size[0, 0] / 2:
        return "leading"
    if ahead < -trace.size[0, 0] / 2:
        return "from-behind"
    return "on-the-right" if _across(gap, heading) > 0 else "on-the-left"


def heading_before(trace: Trace, frame: int, vehicle: int) -> float:
    """The heading that a vehicle had before it drove the last `BEFORE` meters, or in the beginning [rad]."""
    steps = np.diff(trace.position[: frame + 1, vehicle], axis=0)
    left = np.cumsum(np.hypot(steps[:, 0], steps[:, 1])[::-1])  # meters to the end
    back = int(np.searchsorted(left, BEFORE))
    return float(trace.heading[max(frame - back, 0), vehicle])


def _side(trace: Trace, frame: int, npc: int) -> str:
    """Which side of the ego is touched: front, rear, left or right."""
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
    """Points all round a box of shape (4, 2), shape (48, 2)."""
    share = np.linspace(0, 1, 12, endpoint=False)[:, None, None]
    return np.asarray((1 - share) * box + share * np.roll(box, -1, axis=0)).reshape(-1, 2)


def _beyond(points: Floats, trace: Trace, frame: int, vehicle: int) -> Floats:
    """How far points lie outside of a vehicle's box, negative inside, along its nearest axis, shape (n,) [m]."""
    heading = trace.heading[frame, vehicle]
    x, y = (points - trace.position[frame, vehicle]).T
    ahead, across = x * math.cos(heading) + y * math.sin(heading), y * math.cos(heading) - x * math.sin(heading)
    length, width = trace.size[vehicle]
    return np.asarray(np.maximum(np.abs(ahead) - length / 2, np.abs(across) - width / 2))


def _ahead(trace: Trace, frame: int) -> int | None:
    """The nearest vehicle close ahead of the ego, in its way."""
    gaps = trace.position[frame, 1:] - trace.position[frame, 0]
    heading = trace.heading[frame, 0]
    ahead = gaps[:, 0] * math.cos(heading) + gaps[:, 1] * math.sin(heading)
    across = gaps[:, 1] * math.cos(heading) - gaps[:, 0] * math.sin(heading)
    reach = ahead - (trace.size[0, 0] + trace.size[1:, 0]) / 2
    in_way = (ahead > 0) & (reach < CLOSE) & (np.abs(across) < ASIDE + trace.size[1:, 1] / 2)
    return 1 + int(np.where(in_way, reach, np.inf).argmin()) if in_way.any() else None


def motion_of(trace: Trace, frame: int, vehicle: int) -> str:
    """Whether a vehicle stands or creeps; empty if it drives."""
    speed = speed_of(trace, frame, vehicle)
    if speed < STATIONARY_SPEED:
        return "standing"
    return "creeping" if speed < CREEPING else ""


def _behavior(trace: Trace, frame: int) -> str:
    """Whether the ego stood, crept, braked or drove."""
    speed, motion = speed_of(trace, frame, 0), motion_of(trace, frame, 0)
    if motion == "standing":
        return motion
    begin = int(recent(trace, frame, BRAKING_TIME)[0])
    elapsed = trace.time[frame] - trace.time[begin]
    if elapsed > 0 and (speed_of(trace, begin, 0) - speed) / elapsed > BRAKING:
        return "braking"
    return motion or "driving"


def speed_of(trace: Trace, frame: int, vehicle: int) -> float:
    """Speed of a vehicle [m/s]."""
    return math.hypot(*trace.velocity[frame, vehicle])


def _across(gap: Floats, heading: float) -> float:
    """The part of a gap that lies across a heading, positive to the right [m]."""
    return float(gap[1] * math.cos(heading) - gap[0] * math.sin(heading))


def wrapped(angle: float) -> float:
    """An angle in [-pi, pi] [rad]."""
    return math.remainder(angle, 2 * math.pi)
