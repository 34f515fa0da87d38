"""Near misses: the violations that almost happened in an execution, with the classes that they would have had."""

from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from behavexplor.data.array_types import Floats
from behavexplor.data.conventions import EPISODE_TIME, STANDING_SPEED, STANDSTILL_TIME
from behavexplor.data.geometry import distances_from_first, distances_from_segments, point_segment_distances
from behavexplor.data.trace import Trace
from behavexplor.fuzz.aiming import Drive
from behavexplor.judge.classes import ViolationClass, event_class
from behavexplor.judge.events import R1, R2, R3, REQUIREMENTS, ViolationEvent, violation_event
from behavexplor.judge.fault import NPC_CAUSED, contact_fault
from behavexplor.judge.situation import DRIFT, HALF_LANE, motion_of, route_offsets
from behavexplor.judge.specs import Verdict

SHORT_STAND: Final = 2.0  # a shorter stand is not a near miss [s]
LINE_WEIGHT: Final = 10.0  # a meter to a line counts as this many meters to a vehicle: an ego is always near lines
FAR: Final = 200.0  # distance from the destination at which a return to the lane has a degree of 1 [m]
LEAST: Final = 0.01  # least degree of a near miss, so that 0 means a violation
_CLOSEST_FRAMES: Final = 8  # frames with the nearest centers, in which the distance between the boxes is computed


class NearMiss(NamedTuple):
    """A violation, or one that almost happened.

    Attributes:
        spec: the spec's short name: "R1", "R2", "R3", or a user's.
        niche: id of the class that the violation has or would have; for a collision, with the NPC's motion.
        degree: distance from the violation; 0 for a violation.
        partner: index of the NPC that took part or was nearest; -1 without NPCs.
    """

    spec: str
    niche: str
    degree: float
    partner: int


def near_misses(trace: Trace, verdict: Verdict, drive: Drive, reach: float) -> list[NearMiss]:
    """Return the violation of a failed execution, or the near misses of one that passed.

    A collision that an NPC caused teaches nothing about the ego, so it is left out. An execution in which the driving
    system failed is left out, too.

    Args:
        trace: the trace.
        verdict: its verdict.
        drive: the ego's drive in the trace.
        reach: greatest distance between the ego and a vehicle that is a near miss [m].
    """
    if not verdict.failed:
        ends = _near_ends(trace, drive)
        return [*_near_vehicles(trace, drive, reach), *_near_lines(trace, drive), *ends, *_near_specs(trace, verdict)]
    event = violation_event(trace, verdict.violated)
    if event is None or (event.spec == R1 and contact_fault(trace) in NPC_CAUSED):
        return []
    return [_miss(trace, event, 0.0)]


def _near_vehicles(trace: Trace, drive: Drive, reach: float) -> Iterator[NearMiss]:
    """Yield the closest approach of each NPC, unless the ego stood, or kept its lane and the NPC was behind it."""
    frames = drive.frame
    centers = trace.position[frames, 1:] - trace.position[frames, :1]
    gaps = np.hypot(centers[..., 0], centers[..., 1])
    for npc in range(1, len(trace.size)):
        closest = np.sort(np.argsort(gaps[:, npc - 1], kind="stable")[:_CLOSEST_FRAMES])
        at = frames[closest]
        distance = distances_from_first(trace.position, trace.heading, trace.size, at, np.full(len(at), npc))
        nearest = int(distance.argmin())
        if distance[nearest] > reach or drive.speed[closest[nearest]] < STANDING_SPEED:
            continue
        event = ViolationEvent(R1, int(at[nearest]), npc)
        kind = event_class(trace, event)
        if not kind.conflict.startswith("from-behind") or kind.maneuver.startswith("changing"):
            yield _miss(trace, event, LEAST + float(distance[nearest]), kind)


def _near_lines(trace: Trace, drive: Drive) -> Iterator[NearMiss]:
    """Yield the ego's least distance from an illegal line on each side, in its lane and while it changes lanes."""
    lines = trace.illegal_lines
    if not len(lines):
        return
    gap = point_segment_distances(drive.pose[:, :2], lines)
    to_right = _is_right_of(drive.pose, lines)
    for phase in (np.abs(drive.drift) <= DRIFT, drive.drift > DRIFT, drive.drift < -DRIFT):
        for side in (to_right, ~to_right):
            considered = np.where(phase[:, None] & side, gap, np.inf)
            row, line = np.unravel_index(int(considered.argmin()), gap.shape)
            if np.isinf(considered[row, line]):
                continue
            frame = drive.frame[[row]]
            ego = trace.position[frame, 0], trace.heading[frame, 0], trace.size[0]
            distance = float(distances_from_segments(*ego, lines, np.array([line]))[0])
            yield _miss(trace, ViolationEvent(R2, int(frame[0]), int(line)), LEAST + LINE_WEIGHT * distance)


def _is_right_of(pose: Floats, lines: Floats) -> NDArray[np.bool_]:
    """Return whether the nearest point of each line is to the right of each pose, shape (F, L)."""
    start, along = lines[:, 0], lines[:, 1] - lines[:, 0]
    offset = pose[:, None, :2] - start
    share = np.clip((offset * along).sum(-1) / (along**2).sum(-1), 0.0, 1.0)
    x, y = np.moveaxis(start + share[..., None] * along - pose[:, None, :2], -1, 0)
    cos, sin = np.cos(pose[:, 2:]), np.sin(pose[:, 2:])
    return np.asarray(y * cos - x * sin > 0)


def _near_ends(trace: Trace, drive: Drive) -> Iterator[NearMiss]:
    """Yield how the ego almost missed its destination: by a long stand, a long drive or a late return to its lane."""
    steps = np.arange(1, len(drive.time) + 1)
    stand = steps - np.maximum.accumulate(np.where(drive.speed < STANDING_SPEED, 0, steps))
    row = int(stand.argmax())
    seconds = float(drive.time[row] - drive.time[row - stand[row]]) if stand[row] else 0.0
    if seconds > SHORT_STAND:
        event = ViolationEvent(R3, int(drive.frame[row]))
        yield _miss(trace, event, LEAST + max(1 - seconds / STANDSTILL_TIME, 0.0), end="standstill")
    if trace.duration > EPISODE_TIME / 5:
        event = ViolationEvent(R3, int(drive.frame[len(drive.frame) // 2]))
        yield _miss(trace, event, LEAST + max(1 - trace.duration / EPISODE_TIME, 0.0), end="timeout")
    aside = np.flatnonzero(np.abs(route_offsets(trace)) > HALF_LANE)
    if len(aside):
        frame = int(aside[-1])
        left = float(np.hypot(*(trace.position[frame, 0] - trace.destination)))
        yield _miss(trace, ViolationEvent(R3, frame), LEAST + left / FAR, end="passed")


def _near_specs(trace: Trace, verdict: Verdict) -> Iterator[NearMiss]:
    """Yield the degrees of the user's own specs."""
    for name, degree in verdict.degrees.items():
        if name not in REQUIREMENTS:
            yield _miss(trace, ViolationEvent(name, len(trace.time) - 1), LEAST + max(degree, 0.0))


def _miss(
    trace: Trace, event: ViolationEvent, degree: float, kind: ViolationClass | None = None, end: str | None = None
) -> NearMiss:
    kind = kind or event_class(trace, event, end)
    motion = [motion_of(trace, event.frame, event.partner) or "moving"] if event.spec == R1 else []
    return NearMiss(event.spec, "/".join([kind.id, *motion]), degree, _partner(trace, event))


def _partner(trace: Trace, event: ViolationEvent) -> int:
    if event.spec == R1:
        return event.partner - 1
    gap = trace.position[event.frame, 1:] - trace.position[event.frame, 0]
    return int(np.hypot(gap[:, 0], gap[:, 1]).argmin()) if len(gap) else -1
