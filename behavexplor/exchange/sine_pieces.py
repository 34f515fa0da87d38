"""A sine as pieces of cubic polynomials, since OpenDRIVE has no sines."""

import math
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from behavexplor.data.array_types import Floats
from behavexplor.data.road_plan import SineLane

MAX_ERROR: Final = 0.001  # greatest distance of a piece from the sine [m]


class Piece(NamedTuple):
    """A parametric cubic curve in the frame of its start, with a parameter p from 0 to 1.

    Attributes:
        pose: x [m], y [m] and heading [rad] of the start, shape (3,).
        u: coefficients of 1, p, p^2 and p^3 along the heading [m], shape (4,).
        v: coefficients perpendicular to it, in the direction in which headings grow [m], shape (4,).
    """

    pose: Floats
    u: Floats
    v: Floats


def sine_pieces(lane: SineLane) -> list[Piece]:
    """Return the center line of a sine lane as pieces, none farther than `MAX_ERROR` from the sine.

    Each piece is linear along the axis of the sine and a cubic Hermite interpolation across it. Its error is at most
    h^4 / 384 times the greatest fourth derivative, where h is the length of the piece along the axis.
    """
    steepest = abs(lane.amplitude) * lane.pulsation**4
    longest = (384 * MAX_ERROR / steepest) ** 0.25 if steepest > 0 else math.inf
    ends = np.linspace(0.0, lane.length, max(math.ceil(lane.length / longest), 1) + 1)
    return [_piece(lane, begin, end - begin) for begin, end in pairwise(ends.tolist())]


def _piece(lane: SineLane, begin: float, step: float) -> Piece:
    angle = lane.pulsation * np.array([begin, begin + step]) + lane.phase
    rise = lane.amplitude * (np.sin(angle[1]) - np.sin(angle[0]))
    first, last = step * lane.amplitude * lane.pulsation * np.cos(angle)
    along = np.array([0.0, step, 0.0, 0.0])
    across = np.array([0.0, first, 3 * rise - 2 * first - last, first + last - 2 * rise])
    pose = lane.pose(begin)
    turn = float(pose[2] - lane.heading)
    cos, sin = math.cos(turn), math.sin(turn)
    return Piece(pose, along * cos + across * sin, across * cos - along * sin)
