"""Whose fault a contact was, as far as the trace alone tells.

The paper counts every collision as a violation of R1. NPCs react to nothing, so many contacts are theirs: they drive
into the back of an ego that had to slow down. The verdicts here stand beside the raw count and never change it.
"""

import math
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from behavexplor.data.geometry import box_corners, box_distance, project_on_polyline
from behavexplor.data.trace import Trace

Floats = NDArray[np.float64]

Fault = Literal["ego_cut_in", "npc_rear_end", "struck_stationary", "other"]
NPC_CAUSED: Final = frozenset({"npc_rear_end", "struck_stationary"})
# Verdicts of this module, and those of `behavexplor.triage.blame`, which looks for a way to avoid the collision.
AT_FAULT: Final = frozenset({"ego_cut_in", "preventable"})
NOT_AT_FAULT: Final = NPC_CAUSED | {"unpreventable"}

STATIONARY_SPEED: Final = 0.3  # an ego slower than this stands [m/s]
ALIGNED: Final = 0.8  # greatest difference of the headings in a rear-end contact [rad]
CUT_IN_TIME: Final = 3.0  # after its own lane change the ego answers for those behind it [s]
LATERAL_SPEED: Final = 0.3  # across its route an ego that moves faster than this is changing lanes [m/s]


def contact_fault(trace: Trace) -> Fault | None:
    """The verdict on the contact with which a trace ends.

    The classes are looked at in this order:

    - `ego_cut_in`: struck from behind while the ego changed lanes, or within `CUT_IN_TIME` after: the ego's fault.
    - `npc_rear_end`: struck from behind by a faster vehicle that drove the same way.
    - `struck_stationary`: the ego stood, whoever came from wherever.
    - `other`: whether it could have been prevented takes other runs to tell.

    Args:
        trace: of an episode.

    Returns:
        None if the ego touches nobody in the last frame.
    """
    npc = touched_npc(trace)
    if npc is None:
        return None
    if _struck_from_behind(trace, npc):
        return "ego_cut_in" if _changed_lanes(trace) else "npc_rear_end"
    if math.hypot(*trace.velocity[-1, 0]) < STATIONARY_SPEED:
        return "struck_stationary"
    return "other"


def touched_npc(trace: Trace) -> int | None:
    """The vehicle that the ego touches in the last frame; of several, the one whose center is nearest."""
    boxes = box_corners(trace.position[-1], trace.heading[-1], trace.size)
    touched = 1 + np.flatnonzero(box_distance(boxes[:1], boxes[1:]) == 0.0)
    if not len(touched):
        return None
    gaps = np.hypot(*(trace.position[-1, touched] - trace.position[-1, 0]).T)
    return int(touched[gaps.argmin()])


def _struck_from_behind(trace: Trace, npc: int) -> bool:
    """Whether a faster vehicle of about the same heading touches the ego from behind the ego's center."""
    heading = trace.heading[-1, 0]
    ahead = (trace.position[-1, npc] - trace.position[-1, 0]) @ (math.cos(heading), math.sin(heading))
    turned = math.remainder(trace.heading[-1, npc] - heading, 2 * math.pi)
    ego_speed, npc_speed = np.hypot(*trace.velocity[-1, [0, npc]].T)
    # One whose center is ahead of the ego's rear bumper came alongside, not from behind.
    return bool(ahead < -trace.size[0, 0] / 2 and abs(turned) < ALIGNED and npc_speed > ego_speed)


def _changed_lanes(trace: Trace) -> bool:
    """Whether the ego moved across its route in the last `CUT_IN_TIME`."""
    recent = trace.time >= trace.time[-1] - CUT_IN_TIME
    _, along = project_on_polyline(trace.position[recent, 0], trace.route)
    velocity = trace.velocity[recent, 0]
    across = velocity[:, 1] * np.cos(along) - velocity[:, 0] * np.sin(along)
    return bool((np.abs(across) > LATERAL_SPEED).any())
