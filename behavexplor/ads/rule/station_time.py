"""Station-time graph: which stretch of the ego's path the others take up, and when."""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from behavexplor.ads.rule.lanes import LENGTH as LANE_LENGTH
from behavexplor.ads.rule.lanes import pose_on_lane
from behavexplor.ads.rule.parameters import Numbers
from behavexplor.ads.rule.path import Path, project_on_path
from behavexplor.ads.rule.prediction import LaneGraph, find_tails, reach
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
    """

    spans: Floats
    counts: Ints
    occupied: Floats
    tails: Ints
    stations: Floats


@kernel
def empty_station_time(n_npcs: int) -> StationTime:
    """Room for the graphs of scenes with so many NPCs."""
    return StationTime(
        np.empty((N_INTERVALS, max(n_npcs, 1) * TAILS_PER_NPC, N_COLUMNS)),
        np.zeros(N_INTERVALS, np.int64),
        np.empty((N_STEPS, 2)),
        np.empty(TAILS_PER_NPC, np.int64),
        np.empty(TAILS_PER_NPC),
    )


@kernel
def project_obstacles(
    path: Path, graph: LaneGraph, scene: Floats, station: float, p: Numbers, room: StationTime
) -> None:
    """Fill the station-time graph with every NPC's predicted motion along every way it has.

    Args:
        path: the ego's.
        graph: the map.
        scene: shape (1 + n, 8), see `behavexplor.scene`.
        station: the ego's [m].
        p: the parameters.
        room: filled.
    """
    room.counts[:] = 0
    for row in range(EGO + 1, len(scene)):
        if scene[row, PRESENT] == 0.0:
            continue
        x, y, heading = scene[row, X], scene[row, Y], scene[row, HEADING]
        found = find_tails(graph, x, y, heading, p, room.tails, room.stations)
        for way in range(found):
            _project(path, graph, scene, row, way, station, p, room)


@kernel
def _project(
    path: Path, graph: LaneGraph, scene: Floats, row: int, way: int, station: float, p: Numbers, room: StationTime
) -> None:
    """Add one NPC's motion along one way; one that follows the ego on its own path is left out."""
    speed, acceleration = max(scene[row, SPEED], 0.0), scene[row, ACCELERATION]
    if speed < p.static_speed:
        speed = acceleration = 0.0
    limit = max(path.speed_limit, speed)
    horizon = N_INTERVALS * INTERVAL
    longest = max(p.following_time, p.crossing_time + p.crossing_time_growth * horizon)
    _, farthest = reach(speed, acceleration, p.acceleration_memory, limit, 0.0, horizon + longest)
    steps = min(int(farthest / STEP) + 2, N_STEPS)
    strip = scene[EGO, WIDTH] / 2 + p.side_gap
    occupied, spans = room.occupied, room.spans
    if not _occupy(path, graph, scene, row, way, strip, steps, room):
        return
    ahead = occupied[0, 0] <= occupied[0, 1]
    if ahead and occupied[0, 0] + occupied[0, 1] < 2 * station:
        return
    half_length = scene[EGO, LENGTH] / 2
    before = 0.0
    for k in range(N_INTERVALS):
        time = k * INTERVAL
        driven, until = reach(speed, acceleration, p.acceleration_memory, limit, time, time + INTERVAL)
        lead_speed = (driven - before) / INTERVAL if k > 0 else speed
        before = driven
        margin = p.following_time if ahead else p.crossing_time + p.crossing_time_growth * time
        near, far = reach(
            speed, acceleration, p.acceleration_memory, limit, max(time - margin, 0.0), time + INTERVAL + margin
        )
        soft_low, soft_high = _stretch(occupied, steps, near, far)
        if soft_low > soft_high:
            continue
        low, high = _stretch(occupied, steps, driven, until)
        i = room.counts[k]
        spans[k, i, HARD_LOW] = low - half_length - p.bumper_gap
        spans[k, i, HARD_HIGH] = high + half_length + p.bumper_gap
        spans[k, i, SOFT_LOW] = soft_low - half_length - p.stop_gap
        spans[k, i, SOFT_HIGH] = soft_high + half_length + p.stop_gap
        spans[k, i, COST] = p.following_cost if ahead else p.crossing_cost
        spans[k, i, LEADS] = 1.0 if ahead else 0.0
        spans[k, i, LEAD_SPEED] = lead_speed
        room.counts[k] += 1


@kernel
def _occupy(
    path: Path, graph: LaneGraph, scene: Floats, row: int, way: int, strip: float, steps: int, room: StationTime
) -> bool:
    """The stretch of the ego's path that an NPC's box takes up at each step of its way; whether any does."""
    length, width = scene[row, LENGTH], scene[row, WIDTH]
    tail, start, occupied = room.tails[way], room.stations[way], room.occupied
    depth = 0
    lane = graph.tails[tail, 0]
    touched = False
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
            x, y, heading = pose_on_lane(graph.lanes, lane, station)
            low, high = box_on_path(path, x, y, heading, length, width, strip)
        occupied[i, 0], occupied[i, 1] = low, high
        touched |= low <= high
    return touched


@kernel
def _stretch(occupied: Floats, steps: int, near: float, far: float) -> tuple[float, float]:
    """The stretch of the ego's path taken up while an NPC is between two distances along its way."""
    low, high = math.inf, -math.inf
    for i in range(int(near / STEP), min(int(far / STEP) + 2, steps)):
        low = min(low, occupied[i, 0])
        high = max(high, occupied[i, 1])
    return low, high


@kernel
def box_on_path(
    path: Path, x: float, y: float, heading: float, length: float, width: float, strip: float
) -> tuple[float, float]:
    """The stations between which a box reaches into the strip along the path; (inf, -inf) if it does not.

    Args:
        path: the ego's.
        x: the box's centre [m].
        y: the box's centre [m].
        heading: [rad].
        length: [m].
        width: [m].
        strip: half the strip's width [m].
    """
    low, high = math.inf, -math.inf
    _, aside = project_on_path(path, x, y)
    if abs(aside) > strip + math.hypot(length, width) / 2:
        return low, high
    cos, sin = math.cos(heading), math.sin(heading)
    last_s, last_d = project_on_path(path, x - (length * cos + width * sin) / 2, y - (length * sin - width * cos) / 2)
    for front, right in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
        along, across = front * length / 2, right * width / 2
        s, d = project_on_path(path, x + along * cos - across * sin, y + along * sin + across * cos)
        if abs(d) <= strip:
            low, high = min(low, s), max(high, s)
        for edge in (-strip, strip):
            if (d - edge) * (last_d - edge) < 0.0:
                crossing = s + (last_s - s) * (edge - d) / (last_d - d)
                low, high = min(low, crossing), max(high, crossing)
        last_s, last_d = s, d
    return low, high
