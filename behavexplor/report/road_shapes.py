"""The road under the replays, as polygons and lines."""

from typing import Any, Final

import gymnasium
import numpy as np
from numpy.typing import NDArray

from behavexplor import FUNCTIONAL_SCENARIOS, NAMESPACE
from behavexplor.data.roadmap import CURB, Lane, RoadMap, Route
from behavexplor.data.trace import Trace

Floats = NDArray[np.float64]

_DASH, _GAP = 3.0, 6.0  # length of a dash between lanes, and distance between two [m]
_CURVE_POINTS: Final = 13  # points along a curved lane


def known_road(env: str) -> RoadMap | None:
    """Return the road of an environment of this package.

    No other environment is made, since a report must not import third-party code that a run folder names.

    Args:
        env: name of the environment in the run's configuration.

    Returns:
        The road, or None for an environment of another package.
    """
    name = env.removeprefix(f"{NAMESPACE}/").removesuffix("-v0") if env.startswith(f"{NAMESPACE}/") else env
    if name not in FUNCTIONAL_SCENARIOS:
        return None
    env_made = gymnasium.make(f"{NAMESPACE}/{name}-v0", disable_env_checker=True)
    roadmap: RoadMap = env_made.unwrapped.logical.roadmap  # type: ignore[attr-defined]
    env_made.close()
    return roadmap


def road_values(roadmap: RoadMap | None, trace: Trace) -> dict[str, Any]:
    """Return the road as JSON values, with lengths in meters.

    Args:
        roadmap: the road; None if only the lines and the route in the trace are known.
        trace: trace of any execution. All executions have the same illegal lines and route.
    """
    kinds: tuple[str, ...] = (CURB,) * len(trace.illegal_lines)
    if roadmap is not None and np.array_equal(roadmap.illegal_lines, trace.illegal_lines):
        kinds = roadmap.line_kinds
    return {
        "lanes": [] if roadmap is None else [_points(_surface(lane)) for lane in roadmap.lanes],
        "dashes": [] if roadmap is None else [_points(ends) for ends in _dashes(roadmap)],
        "lines": [{"kind": kind, "ends": _points(line)} for kind, line in zip(kinds, trace.illegal_lines, strict=True)],
        "routes": {} if roadmap is None else {route.name: _points(_center(route)) for route in roadmap.npc_routes},
        "ego": _points(trace.route[:: max(1, len(trace.route) // 120)]),
        "destination": [round(float(value), 2) for value in trace.destination],
    }


def _points(points: Floats) -> list[list[float]]:
    return [[round(float(x), 2), round(float(y), 2)] for x, y in points]


def _beside(lane: Lane, stations: Floats, offset: float) -> Floats:
    """Return points beside the center line of a lane, shape (n, 2) [m]; positive offsets are to its right."""
    x, y, heading = lane.pose(stations).T
    return np.stack([x - offset * np.sin(heading), y + offset * np.cos(heading)], axis=-1)


def _stations(lane: Lane) -> Floats:
    return np.linspace(0, lane.length, 2 if lane.curvature == 0 else _CURVE_POINTS)


def _surface(lane: Lane) -> Floats:
    left, right = (_beside(lane, _stations(lane), side * lane.width / 2) for side in (-1, 1))
    return np.concatenate([left, right[::-1]])


def _center(route: Route) -> Floats:
    return np.concatenate([_beside(lane, _stations(lane), 0.0) for lane in route.lanes])


def _dashes(roadmap: RoadMap) -> list[Floats]:
    """Return the dashes between parallel lanes outside junctions."""
    dashes = []
    for lane, beside in zip(roadmap.lanes[:-1], roadmap.lanes[1:], strict=True):
        if lane.junction or (lane.origin, lane.target) != (beside.origin, beside.target):
            continue
        starts = np.arange(0.0, lane.length, _GAP)
        ends = np.stack([starts, np.minimum(starts + _DASH, lane.length)], axis=1)
        dashes += [_beside(lane, stations, lane.width / 2) for stations in ends]
    return dashes
