"""The lanes of a highway-env road network as a plan, from which other tools can build the road."""

from typing import Final

import numpy as np
from highway_env.road.lane import AbstractLane, CircularLane, LineType, StraightLane
from highway_env.road.lane import SineLane as HighwaySineLane
from highway_env.road.road import LaneIndex, RoadNetwork

from behavexplor.data.road_plan import BROKEN, NO_LINE, SOLID, PlannedLane, RoadPlan, SineLane
from behavexplor.data.roadmap import Lane
from behavexplor.errors import InputError

_MARKINGS: Final = {
    LineType.NONE: NO_LINE,
    LineType.STRIPED: BROKEN,
    LineType.CONTINUOUS: SOLID,
    LineType.CONTINUOUS_LINE: SOLID,
}
_COMPARED: Final = 9  # points of a lane at which the plan is compared with the network
_TOLERANCE: Final = 1e-6  # [m]


def road_plan(network: RoadNetwork) -> RoadPlan:
    """Return the lanes of a network, road by road in highway-env's order.

    Raises:
        InputError: if a lane is neither straight nor circular nor a sine, or has a varying width.
    """
    return tuple(_planned(lane, index) for index, lane in network.lanes_dict().items())


def _planned(lane: AbstractLane, index: LaneIndex) -> PlannedLane:
    plain = _plain(lane, index)
    stations = np.linspace(0.0, lane.length, _COMPARED)
    points = [lane.position(station, 0.0) for station in stations] if plain is not None else []
    if plain is None or np.abs(np.array(points) - plain.pose(stations)[:, :2]).max() > _TOLERANCE:
        raise InputError(
            f"The lane {index} is a {type(lane).__name__}, and only straight, sine and circular lanes can be exported"
        )
    if any(abs(lane.width_at(station) - plain.width) > _TOLERANCE for station in stations):
        raise InputError(f"The lane {index} has a varying width, and only constant widths can be exported")
    left, right = (_MARKINGS[kind] for kind in lane.line_types)
    return PlannedLane(plain, left, right, None if lane.speed_limit is None else float(lane.speed_limit))


def _plain(lane: AbstractLane, index: LaneIndex) -> Lane | None:
    """Return a lane of highway-env as plain data; None if its kind is not known."""
    origin, target, number = index
    ends = (f"{origin}>{target}/{number}", str(origin), str(target))
    length, width = float(lane.length), float(lane.width)
    if isinstance(lane, CircularLane):
        x, y = map(float, lane.position(0.0, 0.0))
        heading = float(lane.heading_at(0.0))
        return Lane(*ends, x, y, heading, length, width, curvature=float(lane.direction / lane.radius))
    if not isinstance(lane, StraightLane):
        return None
    x, y = map(float, lane.start)
    axis = (*ends, x, y, float(lane.heading), length, width)
    if isinstance(lane, HighwaySineLane):
        wave = (float(lane.amplitude), float(lane.pulsation), float(lane.phase))
        return SineLane(*axis, amplitude=wave[0], pulsation=wave[1], phase=wave[2])
    return Lane(*axis)
