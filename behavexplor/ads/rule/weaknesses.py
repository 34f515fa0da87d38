"""The sixteen weaknesses that the paper found in Apollo 6.0, as switches of this planner.

Each weakness has a severity, which is one number in `Parameters`: 0 turns it off, and greater is worse. No weakness
depends on chance, so that a search can tell when it comes nearer to a violation. Each has a gate, the situation in
which it can matter at all. Each has two bits in the decision log: *reached* when its gate is open, and *triggered* when
it changed the output of its module. Source of all: paper section 4.1.2, the paragraph of the same name.
"""

from dataclasses import dataclass
from types import MappingProxyType

from behavexplor.data.array_types import Ints
from behavexplor.data.trace import bit_of
from behavexplor.jit import int64, kernel_inner

REACHED, TRIGGERED = 0, 1  # indices of `bits`
(R1_1, R1_2, R1_3, R1_4, R1_5, R1_6, R1_7, R1_8) = (int64(bit_of(f"R1-{i}")) for i in range(1, 9))
(R2_1, R2_2, R2_3, R2_4) = (int64(bit_of(f"R2-{i}")) for i in range(1, 5))
(R3_1, R3_2, R3_3, R3_4) = (int64(bit_of(f"R3-{i}")) for i in range(1, 5))


@dataclass(frozen=True)
class Weakness:
    """A weakness of the planner."""

    parameter: str  # field of `Parameters` that holds the severity
    module: str  # module of the planner that has the weakness
    description: str  # behavior of the planner, and of a careful planner instead
    gate: str  # situation in which the weakness can matter
    shows: str  # appearance of the violation


WEAKNESSES = MappingProxyType(
    {
        "R1-1": Weakness(
            "occlusion",
            "prediction",
            "A vehicle partly hidden by another vehicle is taken for a standing one, instead of predicted normally.",
            "the hidden share of a moving vehicle's width, seen from the ego's center, exceeds 1 - severity",
            "collision with the hidden vehicle",
        ),
        "R1-2": Weakness(
            "static_speed",
            "prediction",
            "Vehicles slower than the severity [m/s] are taken for standing ones, instead of predicted at their speed.",
            "a vehicle moves, but more slowly than the severity",
            "collision with a creeping vehicle",
        ),
        "R1-3": Weakness(
            "restart",
            "decision",
            "After a short stop before a conflict, the planner decides to go first, and for the severity [s] "
            "ignores conflicts more than 1 s away, instead of yielding until the conflict is clear.",
            "the ego has stood and yielded for 0.5 s",
            "collision in the junction after a stop",
        ),
        "R1-4": Weakness(
            "weak_braking",
            "speed",
            "When another vehicle suddenly changes its speed, that change is not predicted, and for 3 s braking stays "
            "the severity [m/s2] below full braking.",
            "a vehicle brakes or accelerates by more than 2 m/s2",
            "collision with a vehicle that sped up or braked hard",
        ),
        "R1-5": Weakness(
            "cut_in",
            "decision",
            "The planner changes lanes into gaps smaller by this share, and does not slow down for vehicles beside and "
            "behind it there, instead of accepting gaps by distance and closing speed.",
            "a lane change is wanted or under way, and a vehicle is close in the target lane",
            "collision with the side or corner of a vehicle in the target lane",
        ),
        "R1-6": Weakness(
            "no_abort",
            "decision",
            "The planner goes on changing lanes when a vehicle comes close in the target lane, and does not adapt its "
            "speed, instead of returning; the severity is the share of the least gap that may be lost.",
            "the gap has become too small during a lane change that can still be aborted",
            "collision with a vehicle that comes from behind in the target lane",
        ),
        "R1-7": Weakness(
            "narrow_bus",
            "prediction",
            "A turning large vehicle is taken for a car; the severity is the share of its excess size that is lost.",
            "a vehicle longer than 7 m is, or will be, on a curve",
            "collision with the rear or flank of a turning bus",
        ),
        "R1-8": Weakness(
            "branch_turn",
            "prediction",
            "At a junction only the way straight on is predicted until the vehicle has turned by the severity [rad], "
            "instead of all its ways.",
            "a vehicle can turn off, and has not clearly turned yet",
            "collision with a vehicle that turned",
        ),
        "R2-1": Weakness(
            "slow_recovery",
            "control",
            "After steering out for a lane change, this share of the steering back is missing.",
            "the ego overtakes or returns from it, faster than 4 m/s, and steers back",
            "runs along, and onto, the line beyond the target lane",
        ),
        "R2-2": Weakness(
            "short_change",
            "path",
            "At low speed a lane change is shorter by this share and driven with strong acceleration, instead of "
            "having a least length.",
            "a lane change begins below 6 m/s",
            "overshoots onto the line beyond the target lane",
        ),
        "R2-3": Weakness(
            "wrong_side",
            "decision",
            "A leader slower than the severity [m/s] is overtaken in the oncoming lane, even when a lane in the ego's "
            "direction is free.",
            "the ego is slower than 5 m/s close behind such a leader, in the lane next to the oncoming lane",
            "crosses the double yellow line",
        ),
        "R2-4": Weakness(
            "held_steering",
            "control",
            "A large steering angle in a slow left turn is held for the severity [s], instead of tracking the path.",
            "the ego was slower than 4 m/s in a left turn with more than 0.2 rad of steering, and still steers so",
            "touches the double yellow line after the turn",
        ),
        "R3-1": Weakness(
            "no_overtaking",
            "decision",
            "Moving leaders slower than the severity [m/s] are never overtaken, unlike standing leaders and leaders "
            "fast enough for a lane change at speed.",
            "overtaking a leader that moves is better than following it",
            "does not reach the destination in time",
        ),
        "R3-2": Weakness(
            "no_room",
            "decision",
            "The planner overtakes without this share of the room to return before the destination, and does not wait "
            "for a chance to return.",
            "overtaking is better than following, but there is no room to return",
            "passes the destination beside its lane",
        ),
        "R3-3": Weakness(
            "late_change",
            "decision",
            "A needed lane change begins only after this share of the way; until then the planner follows a slow "
            "leader, and does not wait for a gap before the destination.",
            "a lane change is needed, and the leader is slower than 6 m/s",
            "passes the destination beside its lane",
        ),
        "R3-4": Weakness(
            "deadlock",
            "decision",
            "The planner waits as long as a vehicle slower than the severity [m/s] crosses its way or is about to, "
            "and does not creep on, instead of going before or after that vehicle.",
            "the ego stands and yields, or has stood for a while, and such a vehicle is on its way",
            "stands until the end",
        ),
    }
)


@kernel_inner
def note(bits: Ints, weakness: int, triggered: bool) -> None:
    """Record that a weakness is reached, and whether it is triggered, in bits of shape (2,)."""
    bits[REACHED] |= weakness
    if triggered:
        bits[TRIGGERED] |= weakness
