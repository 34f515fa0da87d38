"""The shape of a highway-env road for pictures, read from its network."""

from typing import Final

import numpy as np
from highway_env.road.lane import AbstractLane, LineType, StraightLane
from highway_env.road.road import RoadNetwork
from numpy.typing import NDArray

from behavexplor.data.road_shape import RoadShape

Floats = NDArray[np.float64]

_STEP: Final = 2.0  # greatest distance of two points of a curved line [m]
_MOST_POINTS: Final = 400  # of one line
_LEFT, _RIGHT = 0, 1  # places of a lane's line types


def road_shape(network: RoadNetwork) -> RoadShape:
    """Return the shape of a road of straight, sine, circular or other lanes."""
    surfaces, striped, borders = [], [], []
    for lane in network.lanes_list():
        left, right = _side(lane, -0.5), _side(lane, 0.5)
        surfaces.append(np.concatenate([left, right[::-1]]))
        for line, kind in ((left, lane.line_types[_LEFT]), (right, lane.line_types[_RIGHT])):
            if kind == LineType.STRIPED:
                striped.append(line)
            elif kind != LineType.NONE:
                borders.append(line)
    return RoadShape(tuple(surfaces), tuple(striped), tuple(borders))


def _side(lane: AbstractLane, share: float) -> Floats:
    """Return a line along a lane, at a share of its width to the right of the center, shape (n, 2)."""
    is_straight = type(lane) is StraightLane
    count = 2 if is_straight else int(min(max(lane.length / _STEP, 2), _MOST_POINTS)) + 1
    stations = np.linspace(0.0, lane.length, count)
    return np.array([lane.position(station, share * lane.width_at(station)) for station in stations])
