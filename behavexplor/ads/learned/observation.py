"""Features that a learned policy sees: which vehicles will be where on the ego's path, and when."""

import math
from typing import Final

from behavexplor.ads.learned.route_table import END, IN, OUT, START, Course
from behavexplor.ads.road.lane_arrays import CURVATURE as LANE_CURVATURE
from behavexplor.ads.road.lane_arrays import HEADING as LANE_HEADING
from behavexplor.ads.road.lane_arrays import LENGTH as LANE_LENGTH
from behavexplor.ads.road.lane_arrays import is_near_center_line, project_on_lane
from behavexplor.ads.road.path import SPACING, pose_on_path, project_on_path, row_at
from behavexplor.data.array_types import Floats
from behavexplor.data.scene import ACCELERATION, EGO, HEADING, LENGTH, PRESENT, SPEED, WIDTH, X, Y
from behavexplor.jit import kernel_inner

HORIZON: Final = 8.0  # longest time to a conflict [s]
RANGE: Final = 50.0  # distance that is scaled to 1 [m]
N_CONFLICTS: Final = 6
ON_LANE: Final = 1.8  # greatest offset of a vehicle from the center line of its lane [m]
ALONG: Final = 0.6  # greatest angle between a vehicle and its lane [rad]
SLOWEST: Final = 0.5  # speed below which a vehicle counts as standing [m/s]
STRONG: Final = 4.0  # acceleration that is scaled to 1 [m/s2]
AHEAD: Final = (5.0, 15.0)  # distances ahead at which the curvature is given [m]

N_EGO: Final = 14
N_LANE: Final = 6  # numbers for each of three lanes
N_CONFLICT: Final = 7  # numbers for each conflict
N_FEATURES: Final = N_EGO + 3 * N_LANE + N_CONFLICTS * N_CONFLICT


@kernel_inner
def see(course: Course, scene: Floats, wanted: float, out: Floats) -> None:
    """Fill in the features of one scene, each scaled to a size of about 1.

    Ego: speed; offset from the route, in lanes; offset from the wanted lane, in lanes; heading relative to the route;
    existence of a lane to the left and to the right; distance to the destination (near and far), to the junction's
    start, to its end, and to the end of the lanes beside; presence inside the junction; curvature at `AHEAD`.

    Left lane, own lane and right lane: existence; gap and speed of the vehicle ahead; gap and speed of the vehicle
    behind; acceleration of the vehicle ahead.

    Next conflicts, ordered by the time at which they begin: begin and end of the other vehicle's stay on the ego's path
    as times, and as distances; speed of the other vehicle; time of the ego to the conflict; acceleration of the other
    vehicle.

    The scene has the shape (1 + n, 8), see `behavexplor.data.scene`. The ego's wanted lane is at the offset `wanted`
    from the route [m], positive to the right. `out` has the shape (N_FEATURES,).
    """
    station, offset = project_on_path(course.path, scene[EGO, X], scene[EGO, Y])
    out[:] = 0.0
    _see_ego(course, scene, station, offset, wanted, out)
    _see_lanes(course, scene, station, offset, out[N_EGO : N_EGO + 3 * N_LANE])
    _see_conflicts(course, scene, station, out[N_EGO + 3 * N_LANE :])


@kernel_inner
def lanes_beside(course: Course, row: int, offset: float) -> tuple[int, int]:
    """Count the lanes left and right of the lane at an offset from the route; a junction has only the route's lane."""
    path = course.path
    lane = round(offset / path.lane_width)
    inside = path.junction_start <= row * SPACING < path.junction_end
    left, right = (0, 0) if inside else (int(path.left[row]), int(path.right[row]))
    return max(left + lane, 0), max(right - lane, 0)


@kernel_inner
def _near(distance: float) -> float:
    return min(max(distance / RANGE, -1.0), 1.0)


@kernel_inner
def _see_ego(course: Course, scene: Floats, station: float, offset: float, wanted: float, out: Floats) -> None:
    row = row_at(course.path, station)
    along = pose_on_path(course.path, station)[2]
    left, right = lanes_beside(course, row, offset)
    out[0] = scene[EGO, SPEED] / course.path.speed_limit
    out[1] = offset / course.path.lane_width
    out[2] = (offset - wanted) / course.path.lane_width
    out[3] = (scene[EGO, HEADING] - along + math.pi) % (2 * math.pi) - math.pi
    out[4], out[5] = min(left, 1), min(right, 1)
    out[6] = _near(course.path.destination - station)
    out[7] = (course.path.destination - station) / 200.0
    out[8] = _near(course.path.junction_start - station)
    out[9] = _near(course.path.junction_end - station)
    out[10] = _near(course.side_by_side[row])
    out[11] = 1.0 if course.path.junction_start < station < course.path.junction_end else 0.0
    for i in range(2):
        out[12 + i] = 10.0 * course.curvature[row_at(course.path, station + AHEAD[i])]


@kernel_inner
def _see_lanes(course: Course, scene: Floats, station: float, offset: float, out: Floats) -> None:
    """Fill in the vehicles ahead and behind on three lanes.

    Without a vehicle ahead, the gap is `RANGE` and the speed is the limit; without one behind, the gap is `RANGE` and
    the speed 0.
    """
    row = row_at(course.path, station)
    left, right = lanes_beside(course, row, offset)
    center = course.path.lane_width * round(offset / course.path.lane_width)
    for i in range(3):
        out[N_LANE * i] = 1.0 if (i == 0 and left > 0) or i == 1 or (i == 2 and right > 0) else 0.0
        out[N_LANE * i + 1] = out[N_LANE * i + 2] = out[N_LANE * i + 3] = 1.0
    for other in range(EGO + 1, len(scene)):
        if scene[other, PRESENT] == 0.0:
            continue
        there, aside = project_on_path(course.path, scene[other, X], scene[other, Y])
        turned = scene[other, HEADING] - pose_on_path(course.path, there)[2]
        cos, sin = math.cos(turned), abs(math.sin(turned))
        if cos < 0.5 or abs(there - station) > 2 * RANGE:
            continue
        half_width = (cos * scene[other, WIDTH] + sin * scene[other, LENGTH]) / 2
        gap = abs(there - station) - (scene[other, LENGTH] + scene[EGO, LENGTH]) / 2
        for i in range(3):
            if abs(aside - center - (i - 1) * course.path.lane_width) > half_width + 0.3 * course.path.lane_width:
                continue
            column = N_LANE * i + (1 if there >= station else 3)
            if gap / RANGE < out[column]:
                out[column] = max(gap / RANGE, -0.2)
                out[column + 1] = scene[other, SPEED] / course.path.speed_limit
                if there >= station:
                    out[N_LANE * i + 5] = scene[other, ACCELERATION] / STRONG


@kernel_inner
def _see_conflicts(course: Course, scene: Floats, station: float, out: Floats) -> None:
    """Fill in the next stays of other vehicles on the ego's path, sorted by the time at which they begin."""
    for i in range(N_CONFLICTS):
        out[N_CONFLICT * i : N_CONFLICT * i + 4] = 1.0  # far away, if there is no conflict
    count = 0
    for other in range(EGO + 1, len(scene)):
        if scene[other, PRESENT] == 0.0:
            continue
        for lane in range(len(course.lanes)):
            x, y = scene[other, X], scene[other, Y]
            if course.own[lane] or not is_near_center_line(course.lanes, lane, x, y, ON_LANE):
                continue
            there, _ = project_on_lane(course.lanes, lane, x, y)
            along = course.lanes[lane, LANE_HEADING] + course.lanes[lane, LANE_CURVATURE] * there
            turned = abs((scene[other, HEADING] - along + math.pi) % (2 * math.pi) - math.pi)
            if turned > ALONG or not 0.0 <= there <= course.lanes[lane, LANE_LENGTH]:
                continue
            for zone in range(course.tails[lane], course.tails[lane + 1]):
                count = _add_conflict(course, scene, station, other, there, zone, out, count)


@kernel_inner
def _add_conflict(
    course: Course, scene: Floats, station: float, other: int, there: float, zone: int, out: Floats, count: int
) -> int:
    """Insert one stay among those found, unless it is behind the ego or far in the future; return their number."""
    speed, half = scene[other, SPEED], scene[other, LENGTH] / 2
    enters, leaves = course.zones[zone, IN] - there, course.zones[zone, OUT] - there
    if math.isinf(enters) or leaves < 0.0 or course.zones[zone, END] < station - scene[EGO, LENGTH] / 2:
        return count
    extra = max(half - 2.3, 0.0)  # longer vehicles come earlier and go later
    begins = max(enters - extra, 0.0) / speed if speed > SLOWEST else (0.0 if enters <= extra else math.inf)
    ends = min((leaves + extra) / speed, HORIZON) if speed > SLOWEST else HORIZON
    if begins >= HORIZON:
        return count
    place = count
    while place > 0 and out[N_CONFLICT * (place - 1)] > begins / HORIZON:
        place -= 1
    if place >= N_CONFLICTS:
        return count
    for i in range(min(count, N_CONFLICTS - 1), place, -1):
        for column in range(N_CONFLICT * i, N_CONFLICT * (i + 1)):
            out[column] = out[column - N_CONFLICT]
    column = N_CONFLICT * place
    out[column] = begins / HORIZON
    out[column + 1] = ends / HORIZON
    out[column + 2] = _near(course.zones[zone, START] - station)
    out[column + 3] = _near(course.zones[zone, END] - station)
    out[column + 4] = speed / course.path.speed_limit
    out[column + 6] = scene[other, ACCELERATION] / STRONG
    until = max(course.zones[zone, START] - station - scene[EGO, LENGTH] / 2, 0.0)
    out[column + 5] = min(until / max(scene[EGO, SPEED], 1.0), HORIZON) / HORIZON
    return min(count + 1, N_CONFLICTS)
