"""Prediction: the ways that an NPC may go, how far it may get, and which stretch of the ego's path its box takes up."""

import math
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np

from behavexplor.ads.road import lane_arrays
from behavexplor.ads.road.lane_arrays import COS, CURVATURE, HEADING, LENGTH, N_COLUMNS, SIN, X, Y
from behavexplor.ads.road.path import Path, is_straight, locate_on_path, project_on_path
from behavexplor.ads.rule.control import LateralProfile, offset_at
from behavexplor.ads.rule.parameters import Numbers
from behavexplor.data.array_types import Bools, Floats, Ints
from behavexplor.data.roadmap import RoadMap
from behavexplor.jit import kernel_in_place, kernel_inner

TWO_PI = 2 * math.pi
SAGITTA: Final = 0.5  # more than the distance between an arc and a chord of 1 m [m]
NEAR: Final = 7.0  # half the longest vehicle's diagonal plus half the ego's width, with some margin [m]

# columns of `beside_route`
LEAST, GREATEST = 0, 1  # offsets from the route within a meter of a lane [m]
SKEW = 2  # greatest sine of the angle to the route there; 1 on curves and beside them

BEYOND: Final = 130  # length for which lanes are continued beyond their ends [m]
AROUND: Final = 15.0  # half the longest vehicle's length and width, with some margin [m]
PARALLEL: Final = 1e-6  # sine of the angle to the route below which a box is parallel to it
SLACK: Final = 1.0  # lateral distance by which a profile may overshoot its offsets [m]


class LaneGraph(NamedTuple):
    """All ways on for vehicles on the map.

    The last lane and the last tail are spare: they lead straight on, for a vehicle that is on no lane.
    """

    lanes: Floats  # lanes of the map, shape (lanes + 1, 7), see `behavexplor.ads.road.lane_arrays`
    tails: Ints  # distinct sequences of lanes that routes end with, shape (tails + 1, depth), -1 after the last lane
    around: Floats  # least x and y and greatest x and y of each lane's center line [m], shape (lanes + 1, 4)
    beside: Floats  # where each meter of each lane is on the ego's route, by `beside_route`


def lane_graph(roadmap: RoadMap, path: Path) -> LaneGraph:
    """Make the lane graph of all routes, the ego's included: their lanes, and every distinct rest of a route."""
    rows, tails, around, near = _lanes_of(roadmap)
    rows = rows.copy()  # the spare lane is overwritten
    return LaneGraph(lanes=rows, tails=tails, around=around, beside=beside_route(path, rows, near))


@lru_cache(maxsize=4)  # triage makes many planners for one map
def _lanes_of(roadmap: RoadMap) -> tuple[Floats, Ints, Floats, Bools]:
    """Return what depends on the map alone: `lanes`, `tails` and `around`, and which lanes come near the route."""
    ego_route = roadmap.ego_route
    routes = (*roadmap.npc_routes, ego_route)
    lanes = tuple({lane.name: lane for route in routes for lane in route.lanes}.values())
    index = {lane.name: i for i, lane in enumerate(lanes)}
    sequences = [tuple(index[lane.name] for lane in route.lanes) for route in routes]
    tails = [*sorted({sequence[i:] for sequence in sequences for i in range(len(sequence))}), (len(lanes),)]
    depth = max(map(len, tails))
    padded = [tail + (-1,) * (depth - len(tail)) for tail in tails]
    way = ego_route.polyline(0.0, ego_route.length)
    limit = NEAR + ego_route.lanes[0].width  # the ego may overtake in the next lane; straight roads have no more lanes
    lines = [lane.pose(np.linspace(0.0, lane.length, math.ceil(lane.length) + 1))[:, :2] for lane in lanes]
    around = [[*line.min(axis=0), *line.max(axis=0)] for line in lines] + [[0.0] * 4]
    near = [*(_distance(line, way) <= limit for line in lines), True]
    rows = np.vstack([lane_arrays.lane_array(lanes), np.zeros(N_COLUMNS)])
    return rows, np.array(padded, dtype=np.int64), np.array(around), np.array(near)


def _distance(line: Floats, way: Floats) -> float:
    """Return the least distance between the points of two lines [m]."""
    gaps = line[:, None] - way
    return float(np.hypot(gaps[..., 0], gaps[..., 1]).min())


@kernel_inner
def find_tails(
    ways: LaneGraph, x: float, y: float, heading: float, speed: float, p: Numbers, tails: Ints, stations: Floats
) -> tuple[int, int]:
    """Find every way on of a vehicle: all branches at a junction, straight on for a vehicle that is on no lane.

    The vehicle's center is at x and y [m], with a heading [rad] and a speed [m/s]. `tails` is filled with indices of
    `ways.tails`, and `stations` with its stations along them [m], each of shape (most,). The spare lane is overwritten.

    Returns:
        The number of ways found, at least 1, and the number of overlooked ones among them (weakness R1-8). The
        overlooked ways come last.
    """
    lanes, spare = ways.lanes, len(ways.tails) - 1
    count, overlooked = 0, 0
    lane, station, fits = -1, 0.0, False
    for tail in range(spare):
        if ways.tails[tail, 0] != lane:
            lane = ways.tails[tail, 0]
            fits, station = _fits(ways, lane, x, y, heading, p)
        if not fits or count + overlooked == len(tails):
            continue
        if p.branch_turn > 0.0 and speed > p.branch_speed and _overlooked(ways, tail, heading, p):
            overlooked += 1
            tails[-overlooked], stations[-overlooked] = tail, station
            continue
        tails[count], stations[count] = tail, station
        count += 1
    for i in range(overlooked):
        tails[count + i], stations[count + i] = tails[i - overlooked], stations[i - overlooked]
    if count == 0:
        lanes[-1, X], lanes[-1, Y], lanes[-1, HEADING] = x, y, heading
        lanes[-1, COS], lanes[-1, SIN] = math.cos(heading), math.sin(heading)
        tails[0], stations[0], count, overlooked = spare, 0.0, 1, 0
    return count + overlooked, overlooked


@kernel_inner
def _fits(ways: LaneGraph, lane: int, x: float, y: float, heading: float, p: Numbers) -> tuple[bool, float]:
    """Return whether a vehicle may be driving on a lane, and its station there [m], 0 if it is far from the lane."""
    lanes, around, margin = ways.lanes, ways.around, p.match_offset + SAGITTA
    if x < around[lane, 0] - margin or x > around[lane, 2] + margin:
        return False, 0.0
    if y < around[lane, 1] - margin or y > around[lane, 3] + margin:
        return False, 0.0
    if abs(lane_arrays.offset_on_lane(lanes, lane, x, y)) > p.match_offset:
        return False, 0.0
    station, _ = lane_arrays.project_on_lane(lanes, lane, x, y)
    if not 0.0 <= station <= lanes[lane, LENGTH]:
        return False, station
    along = lanes[lane, HEADING] + lanes[lane, CURVATURE] * station
    return abs((heading - along + math.pi) % TWO_PI - math.pi) <= p.match_heading, station


@kernel_inner
def _overlooked(ways: LaneGraph, tail: int, heading: float, p: Numbers) -> bool:
    """Return whether a way on turns off, but the vehicle has not clearly turned yet (weakness R1-8)."""
    lanes, lane, following = ways.lanes, ways.tails[tail, 0], ways.tails[tail, 1]
    if lanes[lane, CURVATURE] == 0.0:
        return bool(following >= 0 and lanes[following, CURVATURE] != 0.0)
    turned = abs((heading - lanes[lane, HEADING] + math.pi) % TWO_PI - math.pi)
    return bool(turned < p.branch_turn)


@kernel_inner
def traveled(speed: float, acceleration: float, duration: float, limit: float, time: float) -> float:
    """Return the distance [m] driven in a time, if an acceleration goes on for a duration.

    The speed stays between standstill and the limit.
    """
    if acceleration > 0.0:
        duration = min(duration, max(limit - speed, 0.0) / acceleration)
    elif acceleration < 0.0:
        duration = min(duration, speed / -acceleration)
    first = min(time, duration)
    after = speed + acceleration * duration
    return speed * first + 0.5 * acceleration * first * first + after * (time - first)


@kernel_in_place
def reach(
    speed: float, acceleration: float, duration: float, limit: float, since: float, until: float
) -> tuple[float, float]:
    """Return the least and greatest distance driven [m] between two times.

    The two distances cover an NPC that keeps its speed and an NPC that keeps its acceleration for the duration.
    """
    near = min(speed * since, traveled(speed, acceleration, duration, limit, since))
    far = max(speed * until, traveled(speed, acceleration, duration, limit, until))
    return near, far


def beside_route(path: Path, lanes: Floats, near: Bools) -> Floats:
    """Compute where each meter of each lane is on the ego's route: the columns above, shape (lanes, meters, 3).

    The last lane can be anywhere. `near`, shape (lanes,), is False for each lane on which no vehicle can be in the
    ego's way; offsets are infinite there.
    """
    table = np.empty((len(lanes), int(lanes[:, LENGTH].max()) + BEYOND, 3))
    _fill(path, lanes, table)
    table[~near, :, LEAST] = math.inf
    table[-1] = -math.inf, math.inf, 1.0
    return table


@kernel_in_place
def _fill(path: Path, lanes: Floats, table: Floats) -> None:
    for lane in range(len(lanes) - 1):
        last, last_skew = _offset(path, lanes, lane, 0.0)
        for meter in range(table.shape[1]):
            first, first_skew = last, last_skew
            last, last_skew = _offset(path, lanes, lane, meter + 1.0)
            skew = max(first_skew, last_skew)
            between = 0.5 if skew == 1.0 else 0.0  # an offset changes by a meter in each meter at most
            row = table[lane, meter]
            row[LEAST], row[GREATEST], row[SKEW] = min(first, last) - between, max(first, last) + between, skew


@kernel_inner
def _offset(path: Path, lanes: Floats, lane: int, station: float) -> tuple[float, float]:
    """Return the offset of a station of a lane from the route [m], and the sine of the angle there, 1 on curves."""
    x, y, _ = lane_arrays.pose_on_lane(lanes, lane, station)
    nearest, there, offset = locate_on_path(path, x, y)
    if lanes[lane, CURVATURE] != 0.0 or not is_straight(path, nearest, there - AROUND, there + AROUND):
        return offset, 1.0
    along, across = path.lanes[nearest, COS], path.lanes[nearest, SIN]
    return offset, abs(lanes[lane, SIN] * along - lanes[lane, COS] * across)


@kernel_inner
def is_beside(place: Floats, profile: LateralProfile, length: float, width: float, strip: float) -> bool:
    """Return whether a vehicle at a place of `beside_route`, shape (3,), is surely beside the strip along the path.

    Length and width are the vehicle's [m]. The profile is as in `box_on_path`, and `strip` half the strip's width [m].
    """
    needed = strip + (length * place[SKEW] + width) / 2 + (SLACK if profile.length > 0.0 else 0.0)
    away = max(place[LEAST] - max(profile.first, profile.last), min(profile.first, profile.last) - place[GREATEST])
    return bool(away > needed and (length + width) / 2 < AROUND)


class Box(NamedTuple):
    """An oriented box."""

    x: float  # position of the center [m]
    y: float  # position of the center [m]
    cos: float  # cosine of the heading
    sin: float  # sine of the heading
    length: float  # length along the heading [m]
    width: float  # width across the heading [m]


@kernel_inner
def box_on_path(path: Path, profile: LateralProfile, box: Box, strip: float) -> tuple[float, float]:
    """Return the stations between which a box reaches into the strip along the path; (inf, -inf) if it does not.

    The profile is the planned path's offset from the route, and `strip` is half the width of the strip [m].
    """
    x, y, cos, sin, length, width = box
    lane, station, aside = locate_on_path(path, x, y)
    beyond = max(aside - max(profile.first, profile.last), min(profile.first, profile.last) - aside)
    diagonal = (length + width) / 2  # an upper bound of half the diagonal
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


@kernel_inner
def _on_path(path: Path, profile: LateralProfile, x: float, y: float, straight: bool) -> tuple[float, float]:
    """Return the station of a point [m] and its offset from the profile [m].

    If `straight`, x and y are the point's coordinates along and across the route.
    """
    station, aside = (x, y) if straight else project_on_path(path, x, y)
    return station, aside - offset_at(profile, station)
