"""Station-time graph: which stretch of the ego's path the others take up, and when."""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from behavexplor.ads.rule.lanes import COS, CURVATURE, SIN, direction_on_lane
from behavexplor.ads.rule.lanes import LENGTH as LANE_LENGTH
from behavexplor.ads.rule.lateral import Profile, offset_at
from behavexplor.ads.rule.occlusion import hidden_share
from behavexplor.ads.rule.parameters import Numbers
from behavexplor.ads.rule.path import Path, is_straight, locate_on_path, project_on_path
from behavexplor.ads.rule.prediction import LaneGraph, find_tails, reach
from behavexplor.ads.rule.weaknesses import R1_1, R1_2, R1_4, R1_7, R1_8, note
from behavexplor.compiled import kernel
from behavexplor.scene import ACCELERATION, EGO, HEADING, LENGTH, PRESENT, SPEED, WIDTH, X, Y

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

INTERVAL: Final = 0.25  # of time [s]
N_INTERVALS: Final = 32  # up to 8 s
TAILS_PER_NPC: Final = 8  # the most ways on that are followed up

HARD_LOW, HARD_HIGH = 0, 1  # where the ego's centre would touch, or nearly so [m]
SOFT_LOW, SOFT_HIGH = 2, 3  # where it would be too close for comfort, in time or space [m]
COST = 4  # of being there [1/s]
LEADS = 5  # 1 for those ahead on the ego's path, 0 for those who cross or merge
LEAD_SPEED = 6  # and their speed, at least [m/s]
N_COLUMNS = 7

MOVES = 0.05  # faster than this a vehicle does not stand [m/s]
SUDDEN = 2.0  # a change of speed beyond this is a sudden one [m/s2]
LARGE = 7.0  # vehicles longer than this are large [m]
CAR_LENGTH, CAR_WIDTH = 4.6, 1.9  # what they are taken for [m]
PARALLEL = 1e-6  # sine of an angle to the route below which a box is along it
SLACK = 1.0  # by which a profile may overshoot its ends [m]

STEP = 1.0  # of the stations at which an NPC's box is placed on its way [m]
N_STEPS = 128


class StationTime(NamedTuple):
    """Spans of the ego's stations taken up in each interval of time.

    Attributes:
        spans: shape (N_INTERVALS, most, 7), columns as above.
        counts: how many spans there are in each interval, shape (N_INTERVALS,).
        occupied: room for one NPC's stretches along its way, shape (N_STEPS, 2) [m].
        tails: room for one NPC's ways, shape (TAILS_PER_NPC,).
        stations: room for its stations along them, shape (TAILS_PER_NPC,) [m].
        bits: of the weaknesses reached and triggered, shape (2,), see `behavexplor.ads.rule.weaknesses`.
    """

    spans: Floats
    counts: Ints
    occupied: Floats
    tails: Ints
    stations: Floats
    bits: Ints


@kernel
def empty_station_time(n_npcs: int) -> StationTime:
    """Room for the graphs of scenes with so many NPCs."""
    return StationTime(
        np.empty((N_INTERVALS, max(n_npcs, 1) * TAILS_PER_NPC, N_COLUMNS)),
        np.zeros(N_INTERVALS, np.int64),
        np.empty((N_STEPS, 2)),
        np.empty(TAILS_PER_NPC, np.int64),
        np.empty(TAILS_PER_NPC),
        np.zeros(2, np.int64),
    )


class Motion(NamedTuple):
    """What an NPC is predicted to do along its ways, and with which size.

    Attributes:
        speed: [m/s].
        acceleration: [m/s2].
        memory: how long the acceleration may go on [s].
        limit: of the speed [m/s].
        length: of its box [m].
        width: [m].
        turning_length: of its box on curves [m].
        turning_width: [m].
    """

    speed: float
    acceleration: float
    memory: float
    limit: float
    length: float
    width: float
    turning_length: float
    turning_width: float


@kernel
def project_obstacles(
    path: Path,
    profile: Profile,
    graph: LaneGraph,
    scene: Floats,
    station: float,
    blind: float,
    p: Numbers,
    room: StationTime,
) -> None:
    """Fill the station-time graph with every NPC's predicted motion along every way it has.

    Args:
        path: the ego's route.
        profile: its offset from that.
        graph: the map.
        scene: shape (1 + n, 8), see `behavexplor.scene`.
        station: the ego's [m].
        blind: vehicles in the lane changed to whose centres are less far ahead than this are ignored [m].
        p: the parameters.
        room: filled; bits are added to.
    """
    room.counts[:] = 0
    for row in range(EGO + 1, len(scene)):
        if scene[row, PRESENT] == 0.0 or _ignored(path, profile, scene, row, station, blind):
            continue
        true = true_motion(path, scene, row, p)
        motion = predicted_motion(scene, row, true, p)
        x, y, heading = scene[row, X], scene[row, Y], scene[row, HEADING]
        found, overlooked = find_tails(graph, x, y, heading, p, room.tails, room.stations)
        weak = false_motion(scene, row, true, p)
        for way in range(found):
            seen = way < found - overlooked
            touched = _project(path, profile, graph, scene, row, way, station, motion, seen, p, room)
            if not seen:
                note(room.bits, R1_8, touched)
            elif weak:
                note(room.bits, weak, touched or _touches(path, profile, graph, scene, way, true, p, room))


@kernel
def _ignored(path: Path, profile: Profile, scene: Floats, row: int, station: float, blind: float) -> bool:
    """Whether an NPC in the lane changed to is too far behind to be looked at (weaknesses R1-5 and R1-6)."""
    if blind == -math.inf or profile.length == 0.0:
        return False
    at, aside = project_on_path(path, scene[row, X], scene[row, Y])
    return bool(abs(aside - profile.last) < path.lane_width / 2 and at - station < blind)


@kernel
def true_motion(path: Path, scene: Floats, row: int, p: Numbers) -> Motion:
    """An NPC's motion as a careful planner predicts it."""
    speed = max(scene[row, SPEED], 0.0)
    length, width = scene[row, LENGTH], scene[row, WIDTH]
    limit = max(path.speed_limit, speed)
    return Motion(speed, scene[row, ACCELERATION], p.acceleration_memory, limit, length, width, length, width)


@kernel
def false_motion(scene: Floats, row: int, true: Motion, p: Numbers) -> int:
    """Bits of the weaknesses of prediction whose gates an NPC opens: R1-1, R1-2, R1-4 and R1-7."""
    bits = 0
    if true.speed > MOVES:
        if p.occlusion > 0.0 and hidden_share(scene, row) > 1.0 - p.occlusion:
            bits |= R1_1
        if true.speed < p.static_speed:
            bits |= R1_2
    if p.weak_braking > 0.0 and abs(true.acceleration) > SUDDEN:
        bits |= R1_4
    if p.narrow_bus > 0.0 and true.length > LARGE:
        bits |= R1_7
    return bits


@kernel
def predicted_motion(scene: Floats, row: int, true: Motion, p: Numbers) -> Motion:
    """An NPC's motion as this planner predicts it."""
    bits = false_motion(scene, row, true, p)
    if bits == 0:
        return true
    speed, acceleration, memory = true.speed, true.acceleration, true.memory
    length, width = true.length, true.width
    if bits & (R1_1 | R1_2):
        speed = acceleration = 0.0
    if bits & R1_4:
        memory = 0.0
    if bits & R1_7:
        length -= p.narrow_bus * (length - CAR_LENGTH)
        width -= p.narrow_bus * (width - CAR_WIDTH)
    return Motion(speed, acceleration, memory, true.limit, true.length, true.width, length, width)


@kernel
def _steps(motion: Motion, p: Numbers) -> int:
    """How many steps along its way an NPC can come within the horizon."""
    horizon = N_INTERVALS * INTERVAL
    longest = max(p.following_time, p.crossing_time + p.crossing_time_growth * horizon)
    _, farthest = reach(motion.speed, motion.acceleration, motion.memory, motion.limit, 0.0, horizon + longest)
    return min(int(farthest / STEP) + 2, N_STEPS)


@kernel
def _touches(
    path: Path,
    profile: Profile,
    graph: LaneGraph,
    scene: Floats,
    way: int,
    motion: Motion,
    p: Numbers,
    room: StationTime,
) -> bool:
    """Whether an NPC's motion along a way meets the ego's path."""
    strip = scene[EGO, WIDTH] / 2 + p.side_gap
    first, _ = _occupy(path, profile, graph, way, motion, strip, _steps(motion, p), room)
    return bool(first >= 0)


@kernel
def _project(
    path: Path,
    profile: Profile,
    graph: LaneGraph,
    scene: Floats,
    row: int,
    way: int,
    station: float,
    motion: Motion,
    seen: bool,
    p: Numbers,
    room: StationTime,
) -> bool:
    """Add one NPC's motion along one way, if it is seen; one that follows the ego on its own path is left out.

    Returns:
        Whether it meets the ego's path.
    """
    steps = _steps(motion, p)
    strip = scene[EGO, WIDTH] / 2 + p.side_gap
    occupied, spans = room.occupied, room.spans
    first, last = _occupy(path, profile, graph, way, motion, strip, steps, room)
    if first < 0:
        return False
    ahead = first == 0
    if ahead and occupied[0, 0] + occupied[0, 1] < 2 * station:
        return False
    if not seen:
        return True
    half_length = scene[EGO, LENGTH] / 2
    speed, acceleration, memory, limit = motion.speed, motion.acceleration, motion.memory, motion.limit
    before = 0.0
    for k in range(N_INTERVALS):
        time = k * INTERVAL
        driven, until = reach(speed, acceleration, memory, limit, time, time + INTERVAL)
        lead_speed = (driven - before) / INTERVAL if k > 0 else speed
        before = driven
        margin = p.following_time if ahead else p.crossing_time + p.crossing_time_growth * time
        near, far = reach(speed, acceleration, memory, limit, max(time - margin, 0.0), time + INTERVAL + margin)
        soft_low, soft_high = _stretch(occupied, first, last, near, far)
        if soft_low > soft_high:
            continue
        low, high = _stretch(occupied, first, last, driven, until)
        i = room.counts[k]
        spans[k, i, HARD_LOW] = low - half_length - p.bumper_gap
        spans[k, i, HARD_HIGH] = high + half_length + p.bumper_gap
        spans[k, i, SOFT_LOW] = soft_low - half_length - p.stop_gap
        spans[k, i, SOFT_HIGH] = soft_high + half_length + p.stop_gap
        spans[k, i, COST] = p.following_cost if ahead else p.crossing_cost
        spans[k, i, LEADS] = 1.0 if ahead else 0.0
        spans[k, i, LEAD_SPEED] = lead_speed
        room.counts[k] += 1
    return True


@kernel
def _occupy(
    path: Path,
    profile: Profile,
    graph: LaneGraph,
    way: int,
    motion: Motion,
    strip: float,
    steps: int,
    room: StationTime,
) -> tuple[int, int]:
    """The stretch of the ego's path that an NPC's box takes up at each step of its way; the first and last that do."""
    tail, start, occupied = room.tails[way], room.stations[way], room.occupied
    depth = 0
    lane = graph.tails[tail, 0]
    first, last = -1, -1
    for i in range(steps):
        station = start + i * STEP
        while depth + 1 < graph.tails.shape[1] and graph.tails[tail, depth + 1] >= 0:
            if station <= graph.lanes[lane, LANE_LENGTH]:
                break
            start -= graph.lanes[lane, LANE_LENGTH]
            depth += 1
            lane = graph.tails[tail, depth]
            station = start + i * STEP
        low, high = math.inf, -math.inf
        if graph.near[lane]:
            x, y, cos, sin = direction_on_lane(graph.lanes, lane, station)
            straight = graph.lanes[lane, CURVATURE] == 0.0
            length = motion.length if straight else motion.turning_length
            width = motion.width if straight else motion.turning_width
            low, high = box_on_path(path, profile, x, y, cos, sin, length, width, strip)
        occupied[i, 0], occupied[i, 1] = low, high
        if low <= high:
            first, last = (i if first < 0 else first), i
    return first, last


@kernel
def _stretch(occupied: Floats, first: int, last: int, near: float, far: float) -> tuple[float, float]:
    """The stretch of the ego's path taken up while an NPC is between two distances along its way."""
    low, high = math.inf, -math.inf
    for i in range(max(int(near / STEP), first), min(int(far / STEP) + 1, last) + 1):
        low = min(low, occupied[i, 0])
        high = max(high, occupied[i, 1])
    return low, high


@kernel
def box_on_path(
    path: Path, profile: Profile, x: float, y: float, cos: float, sin: float, length: float, width: float, strip: float
) -> tuple[float, float]:
    """The stations between which a box reaches into the strip along the path; (inf, -inf) if it does not.

    Args:
        path: the ego's route.
        profile: its offset from that.
        x: the box's centre [m].
        y: the box's centre [m].
        cos: of the box's heading.
        sin: of the box's heading.
        length: [m].
        width: [m].
        strip: half the strip's width [m].
    """
    lane, station, aside = locate_on_path(path, x, y)
    beyond = max(aside - max(profile.first, profile.last), min(profile.first, profile.last) - aside)
    diagonal = (length + width) / 2  # at least half of it
    if beyond > strip + diagonal + SLACK:
        return math.inf, -math.inf
    straight = is_straight(path, lane, station - diagonal, station + diagonal)
    if straight:  # the box keeps its shape in the route's coordinates
        along, across = path.lanes[lane, COS], path.lanes[lane, SIN]
        cos, sin = cos * along + sin * across, sin * along - cos * across
        if beyond > strip + (length * abs(sin) + width * abs(cos)) / 2 + (SLACK if profile.length > 0.0 else 0.0):
            return math.inf, -math.inf
        if profile.length == 0.0 and abs(sin) < PARALLEL:
            return station - length / 2, station + length / 2
        x, y = station, aside
    low, high = math.inf, -math.inf
    last_s, last_d = _on_path(
        path, profile, x - (length * cos + width * sin) / 2, y - (length * sin - width * cos) / 2, straight
    )
    for front, right in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
        ahead, aside = front * length / 2, right * width / 2
        s, d = _on_path(path, profile, x + ahead * cos - aside * sin, y + ahead * sin + aside * cos, straight)
        if abs(d) <= strip:
            low, high = min(low, s), max(high, s)
        for edge in (-strip, strip):
            if (d - edge) * (last_d - edge) < 0.0:
                crossing = s + (last_s - s) * (edge - d) / (last_d - d)
                low, high = min(low, crossing), max(high, crossing)
        last_s, last_d = s, d
    return low, high


@kernel
def _on_path(path: Path, profile: Profile, x: float, y: float, straight: bool) -> tuple[float, float]:
    """Station, and offset from the profile, of a point [m], which is given in the route's coordinates if straight."""
    station, aside = (x, y) if straight else project_on_path(path, x, y)
    return station, aside - offset_at(profile, station)
