"""Fault of a collision, as far as the trace alone can tell.

The paper counts every collision as a violation of R1. NPCs do not react to the ego, so they cause many collisions
themselves, for example by driving into the back of an ego that had to slow down. The verdicts of this module are
reported next to the raw count and never change it.
"""

import math
from collections.abc import Sequence
from typing import Final, Literal

import numpy as np

from behavexplor.data.conventions import STANDING_SPEED, is_rear_end, wrapped
from behavexplor.data.geometry import box_corners, box_distance, project_on_polyline
from behavexplor.data.trace import Trace
from behavexplor.judge.lanes import had_crashed, has_entered_ring, has_lane_signals, lane_change
from behavexplor.judge.specs import Collision, Destination

Fault = Literal["ego_cut_in", "npc_rear_end", "struck_stationary", "npc_wreck", "other"]
NPC_CAUSED: Final = frozenset({"npc_rear_end", "struck_stationary"})
# Verdicts of this module and of `behavexplor.triage.blame`, which searches for a way to avoid the collision.
AT_FAULT: Final = frozenset({"ego_cut_in", "preventable"})
NOT_AT_FAULT: Final = NPC_CAUSED | {"unpreventable"}

CUT_IN_TIME: Final = 3.0  # time after a lane change in which a hit from behind is the ego's fault [s]
LATERAL_SPEED: Final = 0.3  # an ego that moves faster than this across its route is changing lanes [m/s]

_ENDED_BY_COLLISION: Final = frozenset({Collision().name, Destination().name})


def is_at_fault(fault: str | None) -> bool:
    """Return whether the driving system is at fault for a failure, by the verdict on a collision (None: no collision).

    It is, unless the failure is a collision that an NPC caused, or one that triage found no way to avoid. A touched
    line, a missed destination and an error are always its own fault.
    """
    return fault not in NOT_AT_FAULT


def own_violations(trace: Trace, violated: Sequence[str]) -> tuple[str, ...]:
    """Return the violations of a trace that are the ego's own.

    `violated` are the names of the violated specs, as in `behavexplor.judge.specs.Verdict`.

    A collision that another vehicle caused is left out. It also ended the drive, so a missed destination is left out
    with it.
    """
    if is_at_fault(contact_fault(trace)):
        return tuple(violated)
    return tuple(name for name in violated if name not in _ENDED_BY_COLLISION)


def collision_fault(trace: Trace, violated: Sequence[str]) -> Fault | None:
    """Return the verdict on the collision for which a trace counts as a failure.

    `violated` are the names of the violated specs, as in `behavexplor.judge.specs.Verdict`. The result is None if R1 is
    not the first of them.
    """
    return contact_fault(trace) if violated and violated[0] == Collision().name else None


def contact_fault(trace: Trace) -> Fault | None:
    """Return the verdict on the collision at the end of a trace; None if the ego touches no vehicle in the last frame.

    The verdicts are checked in this order:

    - `ego_cut_in`: a faster vehicle hit the ego from behind while the ego changed lanes or entered a roundabout, or at
      most `CUT_IN_TIME` later. This is the ego's fault.
    - `npc_rear_end`: a faster vehicle with about the same heading hit the ego from behind.
    - `struck_stationary`: the ego was standing.
    - `npc_wreck`: the vehicle that the ego touches had crashed before.
    - `other`: the trace alone cannot tell.

    `behavexplor.triage.blame` drives the scenario again to find out about the last two.
    """
    npc = touched_npc(trace)
    if npc is None:
        return None
    if _struck_from_behind(trace, npc):
        return "ego_cut_in" if _changed_lanes(trace) else "npc_rear_end"
    if is_standing(trace):
        return "struck_stationary"
    return "npc_wreck" if had_crashed(trace, len(trace.time) - 1, npc) else "other"


def touched_npc(trace: Trace) -> int | None:
    """Return the vehicle that the ego touches in the last frame, the nearest by its center if there are several.

    In a highway-env environment, it is the vehicle into which the ego crashed, as the trace says.
    """
    if trace.signals:
        return trace.partner if trace.partner > 0 else None
    boxes = box_corners(trace.position[-1], trace.heading[-1], trace.size)
    touched = 1 + np.flatnonzero(box_distance(boxes[:1], boxes[1:]) == 0.0)
    if not len(touched):
        return None
    gaps = np.hypot(*(trace.position[-1, touched] - trace.position[-1, 0]).T)
    return int(touched[gaps.argmin()])


def _struck_from_behind(trace: Trace, npc: int) -> bool:
    """Return whether a faster vehicle with about the same heading touches the ego from behind.

    In a highway-env environment, it is judged by the frame before the last one, because the crash has already moved the
    vehicles.
    """
    last = len(trace.time) - 1
    frame = max(last - 1, 0) if has_lane_signals(trace) else last
    heading = trace.heading[frame, 0]
    ahead = (trace.position[frame, npc] - trace.position[frame, 0]) @ (math.cos(heading), math.sin(heading))
    turned = wrapped(trace.heading[frame, npc] - heading)
    ego_speed, npc_speed = np.hypot(*trace.velocity[frame, [0, npc]].T)
    return bool(is_rear_end(ahead, turned, trace.size[0, 0], ego_speed, npc_speed))


def is_standing(trace: Trace) -> bool:
    """Return whether the ego stands in the end."""
    return math.hypot(*trace.velocity[-1, 0]) < STANDING_SPEED


def _changed_lanes(trace: Trace) -> bool:
    """Return whether the ego moved across its route in the last `CUT_IN_TIME`.

    In a highway-env environment, it must have changed lanes or entered a roundabout, and must not stand.
    """
    if has_lane_signals(trace):
        if is_standing(trace):
            return False
        last = len(trace.time) - 1
        return bool(lane_change(trace, last, CUT_IN_TIME)) or has_entered_ring(trace, last, CUT_IN_TIME)
    recent = trace.time >= trace.time[-1] - CUT_IN_TIME
    _, along = project_on_polyline(trace.position[recent, 0], trace.route)
    velocity = trace.velocity[recent, 0]
    across = velocity[:, 1] * np.cos(along) - velocity[:, 0] * np.sin(along)
    return bool((np.abs(across) > LATERAL_SPEED).any())
