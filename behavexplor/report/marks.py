"""The place at which a trace violates a requirement, which replays and pictures mark with a circle."""

import numpy as np

from behavexplor.data.array_types import Floats
from behavexplor.data.geometry import box_corners
from behavexplor.data.trace import Trace
from behavexplor.judge.events import R1, R2, ViolationEvent


def violation_place(trace: Trace, event: ViolationEvent) -> tuple[float, float]:
    """Return the place of a violation [m]."""
    ego = trace.position[event.frame, 0]
    if event.spec == R2 and event.partner < 0:  # it left the road of a stock environment
        place = ego
    elif event.spec == R2:
        start, end = trace.illegal_lines[event.partner]
        along = end - start
        place = start + np.clip((ego - start) @ along / max(along @ along, 1e-12), 0.0, 1.0) * along
    elif event.spec == R1:
        place = ego
        for _ in range(20):  # alternating projections converge to a point of both boxes
            place = _into_box(place, trace, event.frame, event.partner)
            place = _into_box(place, trace, event.frame, 0)
    else:
        place = trace.destination
    return float(place[0]), float(place[1])


def _into_box(point: Floats, trace: Trace, frame: int, vehicle: int) -> Floats:
    """Return the point of a vehicle's box nearest to a given point."""
    front_right, front_left, _, back_right = box_corners(
        trace.position[frame, vehicle], trace.heading[frame, vehicle], trace.size[vehicle]
    )
    place = front_right.copy()
    for edge in (front_left - front_right, back_right - front_right):
        place += np.clip((point - front_right) @ edge / (edge @ edge), 0.0, 1.0) * edge
    return np.asarray(place)
