"""Coordinates of exchanged files: the one place where they are converted.

This package has y down and headings from x toward y, as highway-env does. The exchanged files have y up and headings
counterclockwise, as ASAM's standards do. The conversion is a mirror, so it is its own inverse.

The reference point of a vehicle is its center here, and the middle of its rear axle in OpenSCENARIO.
"""

from dataclasses import replace
from typing import Final

import numpy as np

from behavexplor.data.array_types import Floats
from behavexplor.data.road_plan import SineLane
from behavexplor.data.roadmap import Lane

REAR_AXLE: Final = 0.3  # distance of the rear axle behind the center of a written vehicle, as a share of its length
DIGITS: Final = 9  # decimals of written positions and headings, the resolution of a trace

_MIRROR: Final = np.array([1.0, -1.0, -1.0])


def mirrored(pose: Floats) -> Floats:
    """Return poses in the other frame: x [m], y [m] and heading [rad], shape (..., 3)."""
    return np.asarray(pose * _MIRROR)


def mirrored_points(points: Floats) -> Floats:
    """Return points, or vectors, in the other frame, shape (..., 2)."""
    return np.asarray(points * _MIRROR[:2])


def mirrored_lane(lane: Lane) -> Lane:
    """Return a lane in the other frame."""
    other = replace(lane, y=-lane.y, heading=-lane.heading, curvature=-lane.curvature)
    return replace(other, amplitude=-other.amplitude) if isinstance(other, SineLane) else other


def shifted(pose: Floats, ahead: float) -> Floats:
    """Return poses that are moved along their headings by a distance [m].

    A pose is x [m], y [m] and heading [rad] in either frame, shape (..., 3).
    """
    heading = pose[..., 2]
    moved = pose[..., :2] + ahead * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    return np.concatenate([moved, heading[..., None]], axis=-1)
