"""Lane choice: keep the lane, change it for the route, overtake, return or abort; and acceptance of gaps."""

import math
from typing import Final, NamedTuple

from behavexplor.ads.road.path import Path, has_lane, lane_end, oncoming_lane
from behavexplor.ads.rule.memory import Memory
from behavexplor.ads.rule.parameters import Numbers
from behavexplor.ads.rule.traffic import HALF_ALONG, STATION, Neighbors, neighbors
from behavexplor.ads.rule.weaknesses import R1_5, R2_3, R3_1, R3_2, R3_3, note
from behavexplor.data.array_types import Floats, Ints
from behavexplor.jit import kernel_inner

KEEP: Final = 0  # keep the lane
CHANGE: Final = 1  # change towards the route's lane
OVERTAKE: Final = 2  # leave the route's lane for a better one
ABORT: Final = 3  # return to the lane that the ego was about to leave

CLOSE_UP: Final = 40.0  # gap up to which a leader makes a lane change late (R3-3) [m]
SLOW: Final = 6.0  # speed up to which a leader makes a lane change late (R3-3) [m/s]
PREPARATION: Final = 160.0  # distance on which needed lane changes are begun [m]
BORROW_SPEED: Final = 5.0  # speed up to which the ego overtakes in the oncoming lane (R2-3) [m/s]
BORROW_GAP: Final = 15.0  # gap to the leader up to which the ego does so (R2-3) [m]
MOVES: Final = 0.05  # speed up to which leaders stand (R3-1) [m/s]
ALONGSIDE: Final = 1.0  # least difference of speed to an overtaken vehicle [m/s]


class EgoState(NamedTuple):
    """The ego on its route."""

    station: float  # station of the center [m]
    offset: float  # offset of the center from the route [m]
    speed: float  # speed, at least 0 [m/s]
    half_length: float  # half the length [m]
    half_width: float  # half the width [m]


@kernel_inner
def change_length(speed: float, p: Numbers) -> float:
    """Return the length of a change to the next lane, along the route [m]."""
    return max(p.change_length, p.change_time * speed)


@kernel_inner
def beside_lane(path: Path, others: Floats, ego: EgoState, lane: int) -> Neighbors:
    """Find the nearest vehicles in a lane; a vehicle ahead that is beyond the destination does not count."""
    found = neighbors(others, ego.station, lane * path.lane_width, ego.half_length, ego.half_width)
    if found.ahead >= 0:
        rear = others[found.ahead, STATION] - others[found.ahead, HALF_ALONG]
        if rear > path.destination + ego.half_length + 1.0:
            return Neighbors(-1, math.inf, math.inf, found.behind, found.gap_behind, found.speed_behind)
    return found


@kernel_inner
def choose_lane(path: Path, others: Floats, ego: EgoState, memory: Memory, bits: Ints, p: Numbers) -> int:
    """Return the lane that the ego should be in: its own, or a lane next to it."""
    lane = int(memory.lane)
    leader = beside_lane(path, others, ego, lane)
    homewards = lane - int(math.copysign(1.0, lane)) if lane != 0 else 0
    if lane != 0 and _delays(path, ego, lane, leader, bits, p):
        return lane
    best, most = lane, _score(path, others, ego, lane, p)
    if lane != 0 and _must_return(path, ego, lane, p):
        return homewards
    gain = p.lane_gain
    for step in (-1, 1):
        other = lane + step
        if not _open(path, ego, other, p):
            continue
        outwards = abs(other) > abs(lane)
        score = _score(path, others, ego, other, p)
        if score <= most + (gain if outwards else 0.0):
            continue
        if outwards and not _may_overtake(path, others, ego, other, leader, memory, bits, p):
            continue
        best, most, gain = other, score, 0.0
    return best


@kernel_inner
def _open(path: Path, ego: EgoState, lane: int, p: Numbers) -> bool:
    """Return whether a lane runs beside the ego for the length of a change to it, without a junction in between."""
    until = ego.station + change_length(ego.speed, p) + ego.half_length
    if ego.station - ego.half_length < path.junction_end and until > path.junction_start:
        return False
    return has_lane(path, lane, ego.station) and has_lane(path, lane, until)


@kernel_inner
def _score(path: Path, others: Floats, ego: EgoState, lane: int, p: Numbers) -> float:
    """Return how far the ego gets in a lane within the outlook, less the cost of being beside the route [m]."""
    found = beside_lane(path, others, ego, lane)
    free = path.speed_limit * p.outlook
    if found.ahead >= 0:
        free = min(free, max(found.gap_ahead - p.standoff, 0.0) + max(found.speed_ahead, 0.0) * p.outlook)
    return free - abs(lane) * p.lane_cost


@kernel_inner
def _must_return(path: Path, ego: EgoState, lane: int, p: Numbers) -> bool:
    """Return whether the remaining room is needed to return to the route."""
    room = lane_end(path, lane, ego.station) - ego.station
    return room < abs(lane) * (change_length(ego.speed, p) + 2 * ego.speed + p.change_length)


@kernel_inner
def _delays(path: Path, ego: EgoState, lane: int, leader: Neighbors, bits: Ints, p: Numbers) -> bool:
    """Return whether a needed lane change is put off behind a slow leader (weakness R3-3)."""
    if p.late_change == 0.0 or leader.ahead < 0 or leader.gap_ahead > CLOSE_UP or leader.speed_ahead > SLOW:
        return False
    left = lane_end(path, lane, ego.station) - ego.station
    late = left > (1.0 - p.late_change) * PREPARATION
    note(bits, R3_3, late)
    return late


@kernel_inner
def _may_overtake(
    path: Path, others: Floats, ego: EgoState, other: int, leader: Neighbors, memory: Memory, bits: Ints, p: Numbers
) -> bool:
    """Return whether the ego overtakes its leader: its last change is long enough ago, and it can return in time."""
    if leader.ahead < 0 or memory.since < p.lane_rest:
        return False
    if p.no_overtaking > 0.0 and leader.speed_ahead > MOVES:
        follows = leader.speed_ahead < p.no_overtaking
        note(bits, R3_1, follows)
        if follows:
            return False
    room = lane_end(path, other, ego.station) - ego.station
    needed = room_to_overtake(path, others, ego, leader, p) + (abs(other) - 1) * p.change_length
    fits = needed <= room
    if p.no_room > 0.0 and ego.speed < p.no_room_below and not fits and math.isfinite(leader.gap_ahead):
        fits = (1.0 - p.no_room) * min(needed, 1e3) <= room
        note(bits, R3_2, fits)
    return fits


@kernel_inner
def room_to_overtake(path: Path, others: Floats, ego: EgoState, leader: Neighbors, p: Numbers) -> float:
    """Return the distance until the ego is back in front of its leader, at the speed that needs the least room [m]."""
    least = math.inf
    passed = leader.gap_ahead + 2 * others[leader.ahead, HALF_ALONG] + 2 * ego.half_length + p.pass_gap
    for share in (1.0, 0.6, 0.35):
        speed = share * path.speed_limit
        if speed < leader.speed_ahead + ALONGSIDE:
            continue
        until = passed / (1.0 - max(leader.speed_ahead, 0.0) / speed)
        least = min(least, until + change_length(speed, p))
    return least


@kernel_inner
def wrong_side(path: Path, others: Floats, ego: EgoState, memory: Memory, bits: Ints, p: Numbers) -> int:
    """Return the oncoming lane if a slow leader is to be overtaken there (weakness R2-3), or else the ego's lane."""
    lane = int(memory.lane)
    other = oncoming_lane(path, ego.station)
    if p.wrong_side == 0.0 or other == 0 or other != lane - 1 or ego.speed > BORROW_SPEED:
        return lane
    leader = beside_lane(path, others, ego, lane)
    if leader.ahead < 0 or leader.gap_ahead > BORROW_GAP or leader.speed_ahead >= p.wrong_side:
        return lane
    if oncoming_lane(path, ego.station + change_length(ego.speed, p)) != other:
        return lane
    room = path.destination - ego.station
    if path.junction_start > ego.station:
        room = min(room, path.junction_start - ego.station)
    fits = room_to_overtake(path, others, ego, leader, p) <= room
    note(bits, R2_3, fits)
    return other if fits else lane


@kernel_inner
def gap_share(path: Path, others: Floats, ego: EgoState, lane: int, p: Numbers) -> float:
    """Return the gap in a lane as a share of the gap needed by distance and closing speed.

    It is the smaller of the shares ahead and behind.
    """
    found = neighbors(others, ego.station, lane * path.lane_width, ego.half_length, ego.half_width)
    ahead = p.gap + p.gap_ahead_time * max(ego.speed - found.speed_ahead, 0.0)
    behind = p.gap + p.gap_behind_time * max(found.speed_behind - ego.speed, 0.0)
    return min(found.gap_ahead / ahead, found.gap_behind / behind)


@kernel_inner
def cuts_in(ego: EgoState, p: Numbers) -> bool:
    """Return whether the ego would take a gap that is too small (weakness R1-5)."""
    return p.cut_in > 0.0 and ego.speed < p.cut_in_below


@kernel_inner
def accepts_gap(path: Path, others: Floats, ego: EgoState, lane: int, bits: Ints, p: Numbers) -> bool:
    """Return whether the gaps in a lane are wide enough to begin a change to it."""
    share = gap_share(path, others, ego, lane, p)
    if share < 1.0 and cuts_in(ego, p):
        note(bits, R1_5, share >= 1.0 - p.cut_in)
        return share >= 1.0 - p.cut_in
    return share >= 1.0


@kernel_inner
def lane_wall(path: Path, ego: EgoState, lane: int, p: Numbers) -> float:
    """Return the station that the ego must not pass beside its route's lane, so that it can still return [m]."""
    if lane == 0:
        return math.inf
    wall = lane_end(path, lane, ego.station) - abs(lane) * p.change_length - 2.0
    return max(wall, ego.station + ego.speed * ego.speed / (2 * p.firm_braking) + 0.1)
