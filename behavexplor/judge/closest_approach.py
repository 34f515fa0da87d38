"""The moment at which an ego came nearest to a collision, and the kind of situation that it was in.

The measure is the time to collision: the time until two vehicles touch if both keep their velocities.
"""

import math
from dataclasses import dataclass
from typing import Any, Final, NamedTuple, Self

import numpy as np

from behavexplor.data.array_types import Floats
from behavexplor.data.trace import Trace
from behavexplor.jit import kernel_in_place
from behavexplor.judge.classes import violation_class
from behavexplor.judge.fault import touched_npc
from behavexplor.judge.situation import bearing_of, maneuver_of
from behavexplor.judge.specs import Verdict

LONGEST: Final = 5.0  # greater times to collision tell nothing [s]
BEFORE: Final = 1.0  # time between the situation that leads to a collision and the contact [s]
_REACH: Final = 80.0  # vehicles farther away are not looked at [m]
_SECTORS: Final = 8
_RELATIVE_SPEEDS: Final = (4.0, 10.0)  # edges between kinds of relative speeds [m/s]
_SPEEDS: Final = (6.0, 14.0, 22.0)  # edges between kinds of the ego's speeds [m/s]
_DISC_PLACE: Final = 0.34  # of the outer two of a vehicle's three discs, as a share of its length
_DISC_RADIUS: Final = 0.55  # as a share of its width

_KNOWN: Final = "_nearness"  # attribute of a trace

Niche = tuple[str | int, ...]


@dataclass(frozen=True)
class ClosestApproach:
    """The moment of a trace at which the ego was nearest to a collision."""

    time_left: float  # least time to collision, 0 for a collision [s]
    frame: int  # in which it was least; the one `BEFORE` the contact in a collision
    npc: int  # the other vehicle, an index of `Trace.size`

    @classmethod
    def of(cls, trace: Trace) -> Self | None:
        """Return the closest approach in a trace; None if no vehicle was closer than `LONGEST`."""
        partner = touched_npc(trace) if trace.end == "collision" else None
        if partner is not None:
            return cls(0.0, _before_contact(trace, partner), partner)
        found = np.array([LONGEST, 0.0, 0.0])
        fill_nearest(trace.position, trace.heading, trace.velocity, trace.size, found)
        time_left, frame, npc = found.tolist()
        return cls(time_left, int(frame), int(npc)) if npc else None

    def niche(self, trace: Trace) -> Niche:
        """Return the kind of situation.

        It is the ego's maneuver and where the other vehicle was or came from, in words, as classes have them; then the
        other's sector and relative speed, and the ego's speed and latest command. A command is rounded. So each
        meta-action is a kind of its own, and a continuous command is less than, about or more than zero.
        """
        heading = trace.heading[self.frame, 0]
        x, y = trace.position[self.frame, self.npc] - trace.position[self.frame, 0]
        sector = round((math.atan2(y, x) - heading) / (2 * math.pi / _SECTORS)) % _SECTORS
        relative = math.hypot(*(trace.velocity[self.frame, self.npc] - trace.velocity[self.frame, 0]))
        speed = math.hypot(*trace.velocity[self.frame, 0])
        latest = int(np.searchsorted(trace.action_frame, self.frame, side="right")) - 1
        command = np.rint(trace.actions[latest]).astype(int).tolist() if latest >= 0 else []
        words = maneuver_of(trace, self.frame), bearing_of(trace, self.frame, self.npc)
        return *words, sector, int(np.digitize(relative, _RELATIVE_SPEEDS)), int(np.digitize(speed, _SPEEDS)), *command


class Nearness(NamedTuple):
    """How near an execution came to a failure, and in what kind of situation."""

    time_left: float  # least time to collision, `LONGEST` at most [s]
    niche: Niche | None  # situation of a collision or near miss, or class of another failure; None if there is none

    @classmethod
    def of(cls, trace: Trace, verdict: Verdict) -> Self:
        """Return the nearness of an execution, or what another process has computed of it before."""
        known: Self | None = vars(trace).get(_KNOWN)
        if known is not None:
            return known
        nearest = ClosestApproach.of(trace)
        time_left = nearest.time_left if nearest else LONGEST
        if verdict.violated and trace.end != "collision":
            kind = violation_class(trace, verdict.violated)
            return cls(time_left, (kind.id if kind else verdict.violated[0],))
        return cls(time_left, nearest.niche(trace) if nearest else None)


def known_nearness(time_left: float, niche: list[str | int] | None) -> dict[str, Any]:
    """Return what another process has computed, as an argument of `Trace.of_packed`."""
    return {_KNOWN: Nearness(time_left, None if niche is None else tuple(niche))}


def _before_contact(trace: Trace, partner: int) -> int:
    """Return the frame `BEFORE` the end, or the first one later in which the partner is there."""
    first = int(trace.recent(len(trace.time) - 1, BEFORE)[0])
    if not trace.present.size:
        return first
    return first + int(trace.present[first:, partner].argmax())


@kernel_in_place
def fill_nearest(position: Floats, heading: Floats, velocity: Floats, size: Floats, found: Floats) -> None:
    """Find the least time to collision of the ego, the first vehicle, with any other vehicle.

    A vehicle is three discs in a row. Pairs slower than 0.1 m/s relative to each other are passed over. Centers have
    the shape (T, N, 2) [m], headings (T, N) [rad], velocities (T, N, 2) [m/s], and lengths and widths (N, 2) [m].
    `found`, shape (3,), is the greatest time that counts, and two zeros; afterwards the least time, its frame and its
    vehicle if there is one.
    """
    for t in range(len(position)):
        ego_x, ego_y = math.cos(heading[t, 0]) * size[0, 0], math.sin(heading[t, 0]) * size[0, 0]
        for i in range(1, position.shape[1]):
            dx, dy = position[t, i, 0] - position[t, 0, 0], position[t, i, 1] - position[t, 0, 1]
            vx, vy = velocity[t, i, 0] - velocity[t, 0, 0], velocity[t, i, 1] - velocity[t, 0, 1]
            speed2 = vx * vx + vy * vy
            if dx * dx + dy * dy > _REACH * _REACH or speed2 < 0.01:
                continue
            npc_x, npc_y = math.cos(heading[t, i]) * size[i, 0], math.sin(heading[t, i]) * size[i, 0]
            radius = _DISC_RADIUS * (size[0, 1] + size[i, 1])
            for pair in range(9):
                own, other = _DISC_PLACE * (pair // 3 - 1), _DISC_PLACE * (pair % 3 - 1)
                x, y = dx + other * npc_x - own * ego_x, dy + other * npc_y - own * ego_y
                apart, beyond = x * vx + y * vy, x * x + y * y - radius * radius
                root = apart * apart - speed2 * beyond
                if beyond > 0.0 and (apart >= 0.0 or root < 0.0):
                    continue
                left = max(-apart - math.sqrt(root), 0.0) / speed2 if beyond > 0.0 else 0.0
                if left < found[0]:
                    found[0], found[1], found[2] = left, t, i
