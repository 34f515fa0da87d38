"""Words and marks of an execution: its outcome in words, the place of a violation, the decisions, and the colors."""

import re
from collections.abc import Mapping, Sequence
from functools import cache
from types import MappingProxyType
from typing import Final

import numpy as np

from behavexplor.data.array_types import Floats
from behavexplor.data.conventions import VEHICLE_SIZES
from behavexplor.data.geometry import box_corners
from behavexplor.data.scenario import Scenario
from behavexplor.data.trace import Trace
from behavexplor.judge.events import R1, R2, ViolationEvent
from behavexplor.report.rendering import source

_ENDED_BY: Final[Mapping[str, str]] = MappingProxyType(
    {
        "collision": "a collision",
        "arrived": "its arrival",
        "passed": "passing its destination",
        "standstill": "standing still",
        "timeout": "the time limit",
        "off-road": "leaving the road",
        "ended": "the environment",
        "error": "a failure of the ADS",
    }
)
Color = tuple[int, int, int]
_VARIABLE = re.compile(r"--(\w+): (?:light-dark\()?#([0-9a-f]{6})")  # of page.css, and its color on light pages


def violation_place(trace: Trace, event: ViolationEvent) -> tuple[float, float]:
    """Return the place of a violation [m]."""
    ego = trace.position[event.frame, 0]
    if event.spec == R2 and event.partner < 0:  # it left the road of a highway-env environment
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


def outcome(violated: Sequence[str], end: str) -> str:
    """Describe an outcome, to follow the number of an execution; `end` is one of `behavexplor.data.trace.ENDS`."""
    verdict = f"failed ({' and '.join(violated)})" if violated else "passed"
    return f"{verdict}, ended by {_ENDED_BY[end]}"


def decisions(trace: Trace, scenario: Scenario) -> list[tuple[int, str]]:
    """Return the meta-actions that the driver chose, each with its frame; nothing if it does not drive by them."""
    names = scenario.meta_actions
    if not names:
        return []
    chosen = trace.actions[:, 0].astype(int).tolist()
    return [(frame, names[action]) for frame, action in zip(trace.action_frame.tolist(), chosen, strict=True)]


@cache
def page_colors() -> Mapping[str, Color]:
    """Return the colors of the style sheet's variables, as they are on light pages."""
    return {name: _rgb(value) for name, value in _VARIABLE.findall(source("page.css"))}


def type_color(name: str) -> int:
    """Return the number of a vehicle type's color, v0 to v5; the last one is that of all other types."""
    return list(VEHICLE_SIZES).index(name) if name in VEHICLE_SIZES else len(VEHICLE_SIZES)


def _rgb(value: str) -> Color:
    red, green, blue = bytes.fromhex(value)
    return red, green, blue
