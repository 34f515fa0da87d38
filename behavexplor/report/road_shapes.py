"""The road under the replays and in pictures."""

from pathlib import Path
from typing import Any, Final

import gymnasium
import numpy as np

from behavexplor import FUNCTIONAL_SCENARIOS, NAMESPACE
from behavexplor.data.array_types import Floats
from behavexplor.data.road_shape import ROAD_FILE, RoadShape
from behavexplor.data.roadmap import CURB, Lane, RoadMap, Route
from behavexplor.data.trace import Trace
from behavexplor.data.untrusted import read_file

_CURVE_POINTS: Final = 13  # points along a curved lane
_MARGIN: Final = 60.0  # distance from the egos' drives within which the dashes between lanes are shown [m]


def known_road(env: str, run: Path) -> RoadShape:
    """Return the road of a run: the one in its folder, or else that of the functional scenario `env`.

    A road that is not known has no surfaces. No environment of another package is made, since a report must not import
    third-party code that a run folder names.

    Raises:
        InputError: if the file of the road is damaged.
    """
    stored = run / ROAD_FILE
    if stored.is_file():
        return RoadShape.from_json(read_file(stored).decode(errors="replace"))
    name = env.removeprefix(f"{NAMESPACE}/").removesuffix("-v0") if env.startswith(f"{NAMESPACE}/") else env
    if name not in FUNCTIONAL_SCENARIOS:
        return RoadShape(())
    env_made = gymnasium.make(f"{NAMESPACE}/{name}-v0", disable_env_checker=True)
    roadmap: RoadMap = env_made.unwrapped.logical.roadmap  # type: ignore[attr-defined]
    env_made.close()
    return shape_of(roadmap)


def shape_of(roadmap: RoadMap) -> RoadShape:
    """Return the shape of a road of this package."""
    return RoadShape(
        surfaces=tuple(_surface(lane) for lane in roadmap.lanes),
        striped=_dividers(roadmap),
        line_kinds=tuple(roadmap.line_kinds),
        routes={route.name: _center(route) for route in roadmap.npc_routes},
    )


def line_kinds(shape: RoadShape, trace: Trace) -> tuple[str, ...]:
    """Return the kinds of a trace's illegal lines; they count as curbs if the road does not name them."""
    known = len(shape.line_kinds) == len(trace.illegal_lines)
    return shape.line_kinds if known else (CURB,) * len(trace.illegal_lines)


def road_values(shape: RoadShape, traces: list[Trace]) -> dict[str, Any]:
    """Return the road under traces as JSON values, with lengths in meters.

    All executions have the same illegal lines. They, the ego's route and its destination are those of the first trace.
    """
    trace, drives = traces[0], np.concatenate([one.position[:, 0] for one in traces])
    low, high = drives.min(0) - _MARGIN, drives.max(0) + _MARGIN
    kinds = line_kinds(shape, trace)
    lines = [{"kind": kind, "ends": _points(line)} for kind, line in zip(kinds, trace.illegal_lines, strict=True)]
    lines += [{"kind": CURB, "ends": _points(line)} for line in shape.borders]
    return {
        "lanes": [_points(surface) for surface in shape.surfaces],
        "dashes": [_points(dash) for dash in shape.dashes(low, high)],
        "lines": lines,
        "routes": {name: _points(route) for name, route in shape.routes.items()},
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


def _dividers(roadmap: RoadMap) -> tuple[Floats, ...]:
    """Return the lines between parallel lanes outside junctions."""
    pairs = zip(roadmap.lanes[:-1], roadmap.lanes[1:], strict=True)
    return tuple(
        _beside(lane, _stations(lane), lane.width / 2)
        for lane, beside in pairs
        if not lane.junction and (lane.origin, lane.target) == (beside.origin, beside.target)
    )
