"""Traffic: positions of other vehicles relative to the ego's route, and the nearest vehicles in a lane."""

import math
from typing import Final, NamedTuple

from behavexplor.ads.road.path import Path, pose_on_path, project_on_path
from behavexplor.data.array_types import Floats
from behavexplor.data.scene import EGO, HEADING, LENGTH, PRESENT, SPEED, WIDTH, X, Y
from behavexplor.jit import kernel_inner

STATION, OFFSET, TURNED, HALF_ALONG, HALF_ACROSS, ALONG_SPEED = range(6)  # columns of the table of other vehicles
N_OTHER_COLUMNS: Final = 6
TWO_PI: Final = 2 * math.pi
SAME_WAY: Final = 0.5  # greatest angle to the route of a vehicle that drives along it [rad]
TOUCHING: Final = 0.2  # lateral gap below which a vehicle is in the same lane [m]
NO_VEHICLE: Final = -1


class Neighbors(NamedTuple):
    """The nearest vehicles ahead of and behind the ego's station in a lane."""

    ahead: int  # row of the nearest vehicle ahead in the table of other vehicles, `NO_VEHICLE` for none
    gap_ahead: float  # gap to the vehicle ahead between bumpers [m], negative beside the ego, infinite for none
    speed_ahead: float  # speed of the vehicle ahead [m/s], infinite for none
    behind: int  # row of the nearest vehicle behind, `NO_VEHICLE` for none
    gap_behind: float  # gap to the vehicle behind between bumpers [m], negative beside the ego, infinite for none
    speed_behind: float  # speed of the vehicle behind [m/s], 0 for none


@kernel_inner
def locate(path: Path, scene: Floats, others: Floats) -> None:
    """Fill the table of other vehicles, shape (n, 6).

    The columns are station [m], offset [m], angle to the route [rad], half extents along and across the route [m], and
    speed along the route [m/s]. Rows of absent vehicles have an infinite station.
    """
    for row in range(EGO + 1, len(scene)):
        other = others[row - 1]
        if scene[row, PRESENT] == 0.0:
            other[STATION] = math.inf
            continue
        station, offset = project_on_path(path, scene[row, X], scene[row, Y])
        _, _, along = pose_on_path(path, station)
        turned = (scene[row, HEADING] - along + math.pi) % TWO_PI - math.pi
        cos, sin = abs(math.cos(turned)), abs(math.sin(turned))
        other[STATION], other[OFFSET], other[TURNED] = station, offset, turned
        other[HALF_ALONG] = 0.5 * (scene[row, LENGTH] * cos + scene[row, WIDTH] * sin)
        other[HALF_ACROSS] = 0.5 * (scene[row, LENGTH] * sin + scene[row, WIDTH] * cos)
        other[ALONG_SPEED] = scene[row, SPEED] * math.cos(turned)


@kernel_inner
def in_lane(other: Floats, offset: float, half_width: float) -> bool:
    """Return whether a vehicle drives along the lane centered at an offset, or reaches into an ego's way there."""
    if other[STATION] == math.inf or abs(other[TURNED]) > SAME_WAY:
        return False
    return bool(abs(other[OFFSET] - offset) < other[HALF_ACROSS] + half_width + TOUCHING)


@kernel_inner
def neighbors(others: Floats, station: float, offset: float, half_length: float, half_width: float) -> Neighbors:
    """Find the nearest vehicles ahead and behind in the lane at an offset."""
    ahead, behind = NO_VEHICLE, NO_VEHICLE
    gap_ahead, gap_behind = math.inf, math.inf
    for i in range(len(others)):
        if not in_lane(others[i], offset, half_width):
            continue
        away = others[i, STATION] - station
        gap = abs(away) - others[i, HALF_ALONG] - half_length
        if away >= 0.0 and gap < gap_ahead:
            ahead, gap_ahead = i, gap
        elif away < 0.0 and gap < gap_behind:
            behind, gap_behind = i, gap
    speed_ahead = others[ahead, ALONG_SPEED] if ahead >= 0 else math.inf
    speed_behind = others[behind, ALONG_SPEED] if behind >= 0 else 0.0
    return Neighbors(ahead, gap_ahead, speed_ahead, behind, gap_behind, speed_behind)
