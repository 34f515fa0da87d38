"""Station-time graph: how the planner expects others to move, and the stretches of the path that they then occupy."""

import math
from typing import Final, NamedTuple

import numpy as np

from behavexplor.ads.road.lane_arrays import CURVATURE, direction_on_lane
from behavexplor.ads.road.lane_arrays import LENGTH as LANE_LENGTH
from behavexplor.ads.road.path import Path, project_on_path
from behavexplor.ads.rule.control import LateralProfile
from behavexplor.ads.rule.parameters import Numbers
from behavexplor.ads.rule.prediction import Box, LaneGraph, box_on_path, find_tails, is_beside, reach
from behavexplor.ads.rule.weaknesses import R1_1, R1_2, R1_4, R1_7, R1_8, note
from behavexplor.data.array_types import Floats, Ints
from behavexplor.data.scene import ACCELERATION, EGO, HEADING, LENGTH, PRESENT, SPEED, WIDTH, X, Y
from behavexplor.jit import int64, kernel, kernel_inner

TWO_PI = 2 * math.pi

# occlusion: whether other vehicles hide a vehicle from the ego (weakness R1-1)
ROUNDING_MARGIN: Final = 1e-6  # much more than the share by which roundings change a product
# If the sines of half their angular widths are below this, vehicles more than 90 degrees apart do not overlap.
NARROW_SINE: Final = 0.7

# gates of weaknesses
MOVES: Final = 0.05  # speed above which a vehicle moves [m/s]
SUDDEN: Final = 2.0  # acceleration or braking beyond which a change of speed is sudden [m/s2]
LARGE: Final = 7.0  # length above which a vehicle is large [m]
CAR_LENGTH, CAR_WIDTH = 4.6, 1.9  # size of a large vehicle as seen at severity 1 (R1-7) [m]

# the graph
INTERVAL: Final = 0.25  # duration of one interval [s]
N_INTERVALS: Final = 32  # number of intervals, up to 8 s
TAILS_PER_NPC: Final = 8  # greatest number of ways ahead that are considered for one NPC
HARD_LOW, HARD_HIGH = 0, 1  # range of stations of the ego's center at which it touches the vehicle, or nearly [m]
SOFT_LOW, SOFT_HIGH = 2, 3  # range of stations of the ego's center too close for comfort, in time or space [m]
COST = 4  # cost of being too close [1/s]
LEADS = 5  # 1 for a vehicle ahead on the ego's path, 0 for one that crosses or merges
LEAD_SPEED = 6  # its mean speed in the interval before, by the least distance driven; at first, its present speed [m/s]
N_COLUMNS = 7
STEP = 1.0  # distance between the stations at which an NPC's box is placed on its way [m]
N_STEPS = 128  # greatest number of these stations on one way


class StationTime(NamedTuple):
    """Spans of the ego's stations that other vehicles occupy in each interval of time."""

    spans: Floats  # columns HARD_LOW to LEAD_SPEED, shape (N_INTERVALS, most, N_COLUMNS); see `counts`
    counts: Ints  # number of rows of `spans` that each interval uses, shape (N_INTERVALS,)
    reaches: Floats  # least and greatest station of the spans in each interval, shape (N_INTERVALS, 2) [m]
    occupied: Floats  # working space for one NPC's stretches along its way, shape (N_STEPS, 2) [m]
    tails: Ints  # working space for one NPC's ways, shape (TAILS_PER_NPC,)
    stations: Floats  # working space for the NPC's stations along its ways, shape (TAILS_PER_NPC,) [m]
    bits: Ints  # bits of the weaknesses reached and triggered, shape (2,), see `behavexplor.ads.rule.weaknesses`


@kernel
def empty_station_time(n_npcs: int) -> StationTime:
    """Allocate a station-time graph for scenes with a number of NPCs."""
    return StationTime(
        np.empty((N_INTERVALS, max(n_npcs, 1) * TAILS_PER_NPC, N_COLUMNS)),
        np.zeros(N_INTERVALS, np.int64),
        np.empty((N_INTERVALS, 2)),
        np.empty((N_STEPS, 2)),
        np.empty(TAILS_PER_NPC, np.int64),
        np.empty(TAILS_PER_NPC),
        np.zeros(2, np.int64),
    )


class Motion(NamedTuple):
    """Predicted motion and size of an NPC along its ways."""

    speed: float  # present speed [m/s]
    acceleration: float  # present acceleration [m/s2]
    memory: float  # time for which the acceleration may go on [s]
    limit: float  # greatest speed [m/s]
    length: float  # length of the box [m]
    width: float  # width of the box [m]
    turning_length: float  # length of the box on curves [m]
    turning_width: float  # width of the box on curves [m]


class Projection(NamedTuple):
    """What the projection of an NPC onto the ego's path needs, apart from the NPC."""

    path: Path  # path of the ego
    profile: LateralProfile  # planned offset from that path
    ways: LaneGraph  # lanes of the map, and the ways on along them
    scene: Floats  # scene, shape (1 + n, 8), see `behavexplor.data.scene`
    station: float  # station of the ego [m]
    p: Numbers  # parameters of the planner
    graph: StationTime  # the station-time graph, which is filled


@kernel_inner
def project_obstacles(
    path: Path,
    profile: LateralProfile,
    ways: LaneGraph,
    scene: Floats,
    station: float,
    blind: float,
    p: Numbers,
    graph: StationTime,
) -> None:
    """Fill the station-time graph with every NPC's predicted motion along every way it has.

    `blind` is the distance ahead of the ego below which the centers of vehicles in the target lane are ignored [m],
    minus infinity for none. Bits are added to `graph.bits`, and never cleared. For the rest, see `Projection`.
    """
    graph.counts[:] = 0
    graph.reaches[:, 0], graph.reaches[:, 1] = math.inf, -math.inf
    view = Projection(path, profile, ways, scene, station, p, graph)
    for row in range(EGO + 1, len(scene)):
        if scene[row, PRESENT] == 0.0 or _ignored(view, row, blind):
            continue
        true = true_motion(path, scene, row, p)
        weak = weaknesses_of_motion(scene, row, true, p)
        motion = false_motion(true, weak, p)
        x, y, heading = scene[row, X], scene[row, Y], scene[row, HEADING]
        found, overlooked = find_tails(ways, x, y, heading, true.speed, p, graph.tails, graph.stations)
        for way in range(found):
            seen = way < found - overlooked
            touched = _project(view, way, motion, seen)
            if not seen:
                note(graph.bits, R1_8, touched)
            elif weak:  # triggered if the false or the true motion meets the ego's path
                note(graph.bits, weak, touched or _occupy(view, way, true)[0] >= 0)


@kernel_inner
def _ignored(view: Projection, row: int, blind: float) -> bool:
    """Return whether an NPC beside or behind the ego in the target lane is ignored (weaknesses R1-5 and R1-6)."""
    if blind == -math.inf or view.profile.length == 0.0:
        return False
    station, offset = project_on_path(view.path, view.scene[row, X], view.scene[row, Y])
    return bool(abs(offset - view.profile.last) < view.path.lane_width / 2 and station - view.station < blind)


@kernel_inner
def _steps(motion: Motion, p: Numbers) -> int:
    """Return the number of steps that an NPC can drive along its way within the horizon."""
    horizon = N_INTERVALS * INTERVAL
    longest_margin = max(p.following_time, p.crossing_time + p.crossing_time_growth * horizon)
    _, farthest = reach(motion.speed, motion.acceleration, motion.memory, motion.limit, 0.0, horizon + longest_margin)
    return min(int(farthest / STEP) + 2, N_STEPS)


@kernel_inner
def _project(view: Projection, way: int, motion: Motion, seen: bool) -> bool:
    """Add one NPC's motion along one way, if it is seen, and return whether it meets the ego's path.

    An NPC that follows the ego on its path is left out.
    """
    p, graph = view.p, view.graph
    occupied, spans = graph.occupied, graph.spans
    first, last = _occupy(view, way, motion)
    if first < 0:
        return False
    ahead = first == 0  # it is on the ego's path already
    if ahead and occupied[0, 0] + occupied[0, 1] < 2 * view.station:  # the middle of its box is behind the ego
        return False
    if not seen:
        return True
    half_length = view.scene[EGO, LENGTH] / 2
    speed, acceleration, memory, limit = motion.speed, motion.acceleration, motion.memory, motion.limit
    before = 0.0
    for k in range(N_INTERVALS):
        time = k * INTERVAL
        least_driven, most_driven = reach(speed, acceleration, memory, limit, time, time + INTERVAL)
        lead_speed = (least_driven - before) / INTERVAL if k > 0 else speed
        before = least_driven
        margin = p.following_time if ahead else p.crossing_time + p.crossing_time_growth * time
        soft_least, soft_greatest = reach(
            speed, acceleration, memory, limit, max(time - margin, 0.0), time + INTERVAL + margin
        )
        soft_low, soft_high = _stretch(occupied, first, last, soft_least, soft_greatest)
        if soft_low > soft_high:
            continue
        low, high = _stretch(occupied, first, last, least_driven, most_driven)
        i = graph.counts[k]
        spans[k, i, HARD_LOW] = low - half_length - p.bumper_gap
        spans[k, i, HARD_HIGH] = high + half_length + p.bumper_gap
        spans[k, i, SOFT_LOW] = soft_low - half_length - p.stop_gap
        spans[k, i, SOFT_HIGH] = soft_high + half_length + p.stop_gap
        spans[k, i, COST] = p.following_cost if ahead else p.crossing_cost
        spans[k, i, LEADS] = 1.0 if ahead else 0.0
        spans[k, i, LEAD_SPEED] = lead_speed
        graph.counts[k] += 1
        graph.reaches[k, 0] = min(graph.reaches[k, 0], spans[k, i, HARD_LOW], spans[k, i, SOFT_LOW])
        graph.reaches[k, 1] = max(graph.reaches[k, 1], spans[k, i, HARD_HIGH], spans[k, i, SOFT_HIGH])
    return True


@kernel_inner
def _occupy(view: Projection, way: int, motion: Motion) -> tuple[int, int]:
    """Compute the stretch of the ego's path that an NPC's box occupies at each step along its way.

    Returned are the first and the last step at which the box is on the path, -1 for none.
    """
    ways, graph = view.ways, view.graph
    tail, start = ways.tails[graph.tails[way]], graph.stations[way]
    steps = _steps(motion, view.p)
    first, last, step = -1, -1, int64(0)  # int64: for Python's int, numba would compile `_occupy_lane` again
    for depth in range(len(tail)):
        if tail[depth] < 0:
            break
        is_last = depth + 1 == len(tail) or tail[depth + 1] < 0
        begin, end, step = _occupy_lane(view, tail[depth], start, step, steps, is_last, motion)
        first, last = (first if first >= 0 else begin), max(last, end)
        start -= ways.lanes[tail[depth], LANE_LENGTH]
    return first, last


@kernel_inner
def _occupy_lane(
    view: Projection, lane: int, start: float, step: int, steps: int, is_last: bool, motion: Motion
) -> tuple[int, int, int]:
    """Compute the stretches that an NPC's box occupies at its steps on one lane of its way.

    `start` is the station at step 0, relative to the start of the lane [m], and `step` the first step on the lane. With
    `is_last`, the way goes straight on beyond the end of the lane. Returned are the first and the last step at which
    the box is on the path, -1 for none, and the first step beyond the lane.
    """
    lanes, places, occupied = view.ways.lanes, view.ways.beside[lane], view.graph.occupied
    straight = lanes[lane, CURVATURE] == 0.0
    length = motion.length if straight else motion.turning_length
    width = motion.width if straight else motion.turning_width
    half_strip = view.scene[EGO, WIDTH] / 2 + view.p.side_gap
    end = math.inf if is_last else lanes[lane, LANE_LENGTH]
    first, last = -1, -1
    while step < steps and start + step * STEP <= end:
        station, low, high = start + step * STEP, math.inf, -math.inf
        if not is_beside(places[int(station)], view.profile, length, width, half_strip):
            x, y, cos, sin = direction_on_lane(lanes, lane, station)
            low, high = box_on_path(view.path, view.profile, Box(x, y, cos, sin, length, width), half_strip)
        occupied[step, 0], occupied[step, 1] = low, high
        if low <= high:
            first, last = (step if first < 0 else first), step
        step += 1
    return first, last, step


@kernel_inner
def _stretch(occupied: Floats, first: int, last: int, near: float, far: float) -> tuple[float, float]:
    """Return the stretch of the ego's path that is occupied while an NPC is between two distances along its way."""
    low, high = math.inf, -math.inf
    for i in range(max(int(near / STEP), first), min(int(far / STEP) + 1, last) + 1):
        low = min(low, occupied[i, 0])
        high = max(high, occupied[i, 1])
    return low, high


@kernel_inner
def true_motion(path: Path, scene: Floats, row: int, p: Numbers) -> Motion:
    """Return an NPC's motion as a careful planner predicts it."""
    speed = max(scene[row, SPEED], 0.0)
    length, width = scene[row, LENGTH], scene[row, WIDTH]
    limit = max(path.speed_limit, speed)
    return Motion(speed, scene[row, ACCELERATION], p.acceleration_memory, limit, length, width, length, width)


@kernel_inner
def weaknesses_of_motion(scene: Floats, row: int, true: Motion, p: Numbers) -> int:
    """Return the bits of the weaknesses of prediction whose gates an NPC opens: R1-1, R1-2, R1-4 and R1-7."""
    bits = 0
    if true.speed > MOVES:
        if p.occlusion > 0.0 and _is_hidden(scene, row, p):
            bits |= R1_1
        if true.speed < p.static_speed:
            bits |= R1_2
    if p.weak_braking > 0.0 and abs(true.acceleration) > SUDDEN:
        bits |= R1_4
    if p.narrow_bus > 0.0 and true.length > LARGE:
        bits |= R1_7
    return bits


@kernel_inner
def false_motion(true: Motion, weak: int, p: Numbers) -> Motion:
    """Return an NPC's motion as a planner with weaknesses predicts it; a careful one predicts the `true` motion.

    `weak` has the bits of the weaknesses with open gates.
    """
    if weak == 0:
        return true
    speed, acceleration, memory = true.speed, true.acceleration, true.memory
    length, width = true.length, true.width
    if weak & (R1_1 | R1_2):
        speed = acceleration = 0.0
    if weak & R1_4:
        memory = 0.0
    if weak & R1_7:
        length -= p.narrow_bus * (length - CAR_LENGTH)
        width -= p.narrow_bus * (width - CAR_WIDTH)
    return Motion(speed, acceleration, memory, true.limit, true.length, true.width, length, width)


@kernel_inner
def _is_hidden(scene: Floats, row: int, p: Numbers) -> bool:
    """Return whether a vehicle counts as hidden (weakness R1-1)."""
    if _distance(scene, row) < p.occlusion_beyond:
        return False
    return bool(hidden_share(scene, row) > 1.0 - p.occlusion)


@kernel_inner
def hidden_share(scene: Floats, row: int) -> float:
    """Return the hidden share of a vehicle's angular width, as seen from the ego's center.

    It is the largest share that a single nearer vehicle covers.
    """
    most, distance = 0.0, _distance(scene, row)
    for other in range(EGO + 1, len(scene)):
        if other == row or scene[other, PRESENT] == 0.0 or _is_apart(scene, row, other):
            continue
        if _distance(scene, other) < distance:
            most = max(most, _covered_share(scene, row, other))
    return most


@kernel_inner
def _distance(scene: Floats, row: int) -> float:
    return math.hypot(scene[row, X] - scene[EGO, X], scene[row, Y] - scene[EGO, Y])


@kernel_inner
def _is_apart(scene: Floats, row: int, other: int) -> bool:
    """Return whether two vehicles are surely in different directions from the ego, by a test without trigonometry."""
    x, y = scene[row, X] - scene[EGO, X], scene[row, Y] - scene[EGO, Y]
    other_x, other_y = scene[other, X] - scene[EGO, X], scene[other, Y] - scene[EGO, Y]
    radius = (scene[row, LENGTH] + scene[row, WIDTH]) / 2  # an upper bound of half the diagonal
    other_radius = (scene[other, LENGTH] + scene[other, WIDTH]) / 2
    widths = radius * (abs(other_x) + abs(other_y)) + other_radius * (abs(x) + abs(y))
    # the sine of the angle between them exceeds the sum of the sines of half their widths
    if abs(x * other_y - y * other_x) > (1.0 + ROUNDING_MARGIN) * widths:
        return True
    if x * other_x + y * other_y >= 0.0:
        return False
    widest = max(
        radius * radius / (x * x + y * y), other_radius * other_radius / (other_x * other_x + other_y * other_y)
    )
    return bool(widest < NARROW_SINE * NARROW_SINE)


@kernel_inner
def _covered_share(scene: Floats, row: int, other: int) -> float:
    """Return the share of a vehicle's angular width that another one covers, negative with a gap between them."""
    bearing, low, high = bearings(scene, row)
    other_bearing, other_low, other_high = bearings(scene, other)
    away = (other_bearing - bearing + math.pi) % TWO_PI - math.pi
    covered = min(high, away + other_high) - max(low, away + other_low)
    return covered / (high - low)


@kernel_inner
def bearings(scene: Floats, row: int) -> tuple[float, float, float]:
    """Return the bearing of a vehicle's center from the ego's center [rad], and the range of its corners' bearings.

    The range is the least and the greatest bearing of a corner relative to that of the center [rad].
    """
    dx, dy = scene[row, X] - scene[EGO, X], scene[row, Y] - scene[EGO, Y]
    bearing = math.atan2(dy, dx)
    cos, sin = math.cos(scene[row, HEADING]), math.sin(scene[row, HEADING])
    low, high = math.inf, -math.inf
    for along in (-0.5 * scene[row, LENGTH], 0.5 * scene[row, LENGTH]):
        for across in (-0.5 * scene[row, WIDTH], 0.5 * scene[row, WIDTH]):
            corner = math.atan2(dy + along * sin + across * cos, dx + along * cos - across * sin)
            away = (corner - bearing + math.pi) % TWO_PI - math.pi
            low, high = min(low, away), max(high, away)
    return bearing, low, high
