"""The ego's situation at a frame of a trace: its maneuver, and the other vehicles around it."""

import math
from typing import Final

import numpy as np

from behavexplor.data.array_types import Floats
from behavexplor.data.conventions import REAR_END_ANGLE, STANDING_SPEED, wrapped
from behavexplor.data.geometry import box_corners, project_on_polyline
from behavexplor.data.trace import Trace
from behavexplor.judge.fault import CUT_IN_TIME
from behavexplor.judge.lanes import has_lane_signals, maneuver, relation

CREEPING: Final = 2.0  # vehicles slower than this creep [m/s]
BRAKING: Final = 2.0  # least mean deceleration of a braking ego over the last `BRAKING_TIME` [m/s2]
BRAKING_TIME: Final = 1.0  # [s]
BEFORE: Final = 30.0  # distance driven since a vehicle's earlier heading, long enough to lie before its turn [m]
TURNED: Final = 0.35  # a vehicle whose heading has changed by more than this since then has turned [rad]
CURVE: Final = 0.5  # a route whose heading changes by more than this has a curve [rad]
CURVE_EDGE: Final = 0.05  # the curve begins and ends where the heading has changed by this [rad]
BEHIND_CURVE: Final = 10.0  # distance after the curve over which the ego still counts as turning [m]
DRIFT: Final = 0.9  # an ego that has moved across its route by more than this is changing lanes [m]
CLOSE: Final = 15.0  # the ego follows a leader within this distance [m]
HALF_LANE: Final = 1.75  # half the width of a lane; what is farther to the side is in another lane [m]


def maneuver_of(trace: Trace, frame: int) -> str:
    """Return the ego's maneuver at a frame: a turn of its route, a lane change, or going straight.

    In a highway-env environment, the lanes tell it; see `behavexplor.judge.lanes.maneuver`.
    """
    if has_lane_signals(trace):
        return maneuver(trace, frame, CUT_IN_TIME)
    frames = trace.recent(frame, CUT_IN_TIME)
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


def bearing_of(trace: Trace, frame: int, npc: int) -> str:
    """Return the position or origin of the other vehicle relative to the ego, with a suffix if it had turned.

    In a highway-env environment, the lanes tell it; see `behavexplor.judge.lanes.relation`.
    """
    if has_lane_signals(trace):
        return relation(trace, frame, npc)
    now = wrapped(trace.heading[frame, npc] - trace.heading[frame, 0])
    before = heading_before(trace, frame, npc)
    turning = "-turning" if abs(wrapped(trace.heading[frame, npc] - before)) > TURNED else ""
    if abs(now) < REAR_END_ANGLE:
        return _position(trace, frame, npc) + turning
    came = wrapped(before - heading_before(trace, frame, 0))
    if abs(came) > math.pi * 3 / 4:
        return "oncoming" + turning
    if abs(came) < math.pi / 4:  # it came from the ego's direction, and turned across the ego's path
        return _position(trace, frame, npc) + turning
    return ("crossing-from-left" if came > 0 else "crossing-from-right") + turning


def _position(trace: Trace, frame: int, npc: int) -> str:
    """Return the position of a vehicle relative to the ego: leading, from behind, or on one side."""
    gap = trace.position[frame, npc] - trace.position[frame, 0]
    heading = trace.heading[frame, 0]
    ahead = float(gap[0] * math.cos(heading) + gap[1] * math.sin(heading))
    if ahead > trace.size[0, 0] / 2:
        return "leading"
    if ahead < -trace.size[0, 0] / 2:
        return "from-behind"
    return "on-the-right" if offset_to_right(gap, heading) > 0 else "on-the-left"


def heading_before(trace: Trace, frame: int, vehicle: int) -> float:
    """Return a vehicle's heading before it drove the last `BEFORE` meters, at the earliest in the first frame [rad]."""
    steps = np.diff(trace.position[: frame + 1, vehicle], axis=0)
    left = np.cumsum(np.hypot(steps[:, 0], steps[:, 1])[::-1])  # distance left to drive [m]
    back = int(np.searchsorted(left, BEFORE))
    return float(trace.heading[frame - back, vehicle])


def touched_side(trace: Trace, frame: int, npc: int) -> str:
    """Return the touched side of the ego: front, rear, left or right.

    Of all points on the two outlines, those that lie deepest inside both boxes decide it.
    """
    boxes = box_corners(trace.position[frame, [0, npc]], trace.heading[frame, [0, npc]], trace.size[[0, npc]])
    points = np.concatenate([_outline(boxes[0]), _outline(boxes[1])])
    depth = np.maximum(_beyond(points, trace, frame, 0), _beyond(points, trace, frame, npc))
    touched = points[depth <= depth.min() + 0.1].mean(0) - trace.position[frame, 0]
    heading = trace.heading[frame, 0]
    ahead = (touched[0] * math.cos(heading) + touched[1] * math.sin(heading)) / trace.size[0, 0]
    across = offset_to_right(touched, heading) / trace.size[0, 1]
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


def leader_of(trace: Trace, frame: int) -> int | None:
    """Return the nearest vehicle close ahead of the ego and in its way, or None."""
    gaps = trace.position[frame, 1:] - trace.position[frame, 0]
    heading = trace.heading[frame, 0]
    ahead = gaps[:, 0] * math.cos(heading) + gaps[:, 1] * math.sin(heading)
    across = gaps[:, 1] * math.cos(heading) - gaps[:, 0] * math.sin(heading)
    reach = ahead - (trace.size[0, 0] + trace.size[1:, 0]) / 2
    in_way = (ahead > 0) & (reach < CLOSE) & (np.abs(across) < HALF_LANE + trace.size[1:, 1] / 2)
    return 1 + int(np.where(in_way, reach, np.inf).argmin()) if in_way.any() else None


def motion_of(trace: Trace, frame: int, vehicle: int) -> str:
    """Return "standing" or "creeping"; empty for a faster vehicle."""
    speed = speed_of(trace, frame, vehicle)
    if speed < STANDING_SPEED:
        return "standing"
    return "creeping" if speed < CREEPING else ""


def behavior_of(trace: Trace, frame: int) -> str:
    """Return "standing", "braking" or "creeping"; empty if the ego drives on."""
    speed, motion = speed_of(trace, frame, 0), motion_of(trace, frame, 0)
    if motion == "standing":
        return motion
    begin = int(trace.recent(frame, BRAKING_TIME)[0])
    elapsed = trace.time[frame] - trace.time[begin]
    if elapsed > 0 and (speed_of(trace, begin, 0) - speed) / elapsed > BRAKING:
        return "braking"
    return motion


def speed_of(trace: Trace, frame: int, vehicle: int) -> float:
    """Return the speed of a vehicle [m/s]."""
    return math.hypot(*trace.velocity[frame, vehicle])


def route_offsets(trace: Trace) -> Floats:
    """Return the ego's offsets from its route, positive to the right, shape (T,) [m]."""
    station, along = project_on_polyline(trace.position[:, 0], trace.route)
    ends = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(trace.route, axis=0).T))])
    nearest = np.stack([np.interp(station, ends, trace.route[:, i]) for i in range(2)], -1)
    gap = trace.position[:, 0] - nearest
    return np.asarray(gap[:, 1] * np.cos(along) - gap[:, 0] * np.sin(along))


def offset_to_right(gap: Floats, heading: float) -> float:
    """Return the component of a gap across a heading, positive to the right [m]."""
    return float(gap[1] * math.cos(heading) - gap[0] * math.sin(heading))
