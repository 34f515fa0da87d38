"""Speed: dynamic programming over the station-time graph, and an escape if no motion is free of contact."""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from behavexplor.ads.road.path import Path, limit_at
from behavexplor.ads.rule.parameters import Numbers
from behavexplor.ads.rule.station_time import (
    COST,
    HARD_HIGH,
    HARD_LOW,
    INTERVAL,
    LEAD_SPEED,
    LEADS,
    N_INTERVALS,
    SOFT_HIGH,
    SOFT_LOW,
    StationTime,
)
from behavexplor.jit import kernel, kernel_in_place

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

STAGES: Final = (2, 2, 4, 4, 4, 4, 6, 6)  # number of intervals in each stage of constant acceleration
ACCELERATIONS: Final = (-8.0, -5.0, -3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 4.0)  # candidate accelerations [m/s2]
HARDEST: Final = (0, 0, 1, 1, 2, 2, 2, 2)  # index of the hardest braking in each stage
STRONGEST: Final = (8, 8, 8, 8, 7, 7, 7, 7)  # index of the strongest acceleration in each stage

RESPONSE: Final = 0.3  # time in which the free speed is reached [s]
FINENESS: Final = 2.5  # bins per root of distance or speed, fine near 0; a stage keeps one node a bin
N_STATION_BINS: Final = 42
N_SPEED_BINS: Final = 16

S, V, LAST, FIRST, TOTAL, RISK, INSIDE = range(7)  # columns of a node


class SpeedPlan(NamedTuple):
    """The best motion along the path.

    Attributes:
        acceleration: acceleration to command now [m/s2].
        survived: number of intervals without contact.
        station: station at the end [m].
        speed: speed at the end [m/s].
        risk: cost of coming too close to other vehicles.
        inside: time of stopping inside the junction [s].
        free: True if the motion is that on a free road.
    """

    acceleration: float
    survived: int
    station: float
    speed: float
    risk: float
    inside: float
    free: bool


class Situation(NamedTuple):
    """Input of the speed search apart from the ego's motion.

    Attributes:
        path: path of the ego.
        graph: stretches of the path that other vehicles occupy.
        half_length: half the length of the ego [m].
        wall: station that must not be passed [m], infinite for none.
        caution: share of the cost of coming too close to other vehicles that counts.
        p: parameters of the planner.
    """

    path: Path
    graph: StationTime
    half_length: float
    wall: float
    caution: float
    p: Numbers


class Nodes(NamedTuple):
    """Working space for the search.

    Attributes:
        stages: nodes of the present and the next stage, shape (2, most, 7).
        places: index of the node in each bin, shape (station bins, speed bins), -1 for none.
    """

    stages: Floats
    places: Ints


@kernel
def empty_nodes() -> Nodes:
    """Allocate working space for one search at a time."""
    most = N_STATION_BINS * N_SPEED_BINS
    return Nodes(np.empty((2, most, 7)), np.empty((N_STATION_BINS, N_SPEED_BINS), np.int64))


@kernel_in_place
def plan_speed(situation: Situation, station: float, speed: float, acceleration: float, nodes: Nodes) -> SpeedPlan:
    """Plan the speed along the path: drive freely if possible, else search for the best motion, else escape.

    Args:
        situation: situation of the ego.
        station: station of the ego [m].
        speed: speed of the ego [m/s].
        acceleration: last commanded acceleration [m/s2].
        nodes: working space for the search.
    """
    plan = _drive_freely(situation, station, speed)
    if plan.survived == N_INTERVALS and plan.risk == 0.0 and plan.inside == 0.0:
        return plan
    plan = _search(situation, station, speed, acceleration, nodes)
    if plan.survived > 0:
        return plan
    return _escape(situation, station, speed)


@kernel_in_place
def free_acceleration(path: Path, station: float, speed: float, p: Numbers) -> float:
    """Return a comfortable acceleration towards the limit, here and after the response time."""
    limit = min(limit_at(path, station), limit_at(path, station + RESPONSE * speed))
    return min(max((limit - speed) / RESPONSE, -p.firm_braking), p.comfortable_acceleration)


@kernel_in_place
def _drive_freely(situation: Situation, station: float, speed: float) -> SpeedPlan:
    path, p = situation.path, situation.p
    first = free_acceleration(path, station, speed, p)
    s, v, risk, inside = station, speed, 0.0, 0.0
    for k in range(N_INTERVALS):
        a = free_acceleration(path, s, v, p)
        ok, s, v, _, more_risk, more_inside, _ = _advance(situation, s, v, a, k, 1)
        if not ok:
            return SpeedPlan(first, k, s, v, risk, inside, True)
        risk += more_risk
        inside += more_inside
    return SpeedPlan(first, N_INTERVALS, s, v, risk, inside, True)


@kernel_in_place
def _search(situation: Situation, station: float, speed: float, acceleration: float, nodes: Nodes) -> SpeedPlan:
    """Find the cheapest way to each (station, speed) stage by stage, and return the cheapest of the last stage."""
    now, following, count = nodes.stages[0], nodes.stages[1], 1
    now[0, S], now[0, V], now[0, LAST], now[0, FIRST] = station, speed, acceleration, 0.0
    now[0, TOTAL], now[0, RISK], now[0, INSIDE] = 0.0, 0.0, 0.0
    survived = 0
    for stage in range(len(STAGES)):
        found = _expand(situation, station, now, count, following, survived, stage, nodes.places)
        if found == 0:
            break
        survived += STAGES[stage]
        now, following, count = following, now, found
    best, least = 0, math.inf
    for i in range(count):
        total = now[i, TOTAL] + _debt(situation, now[i, S], now[i, V], survived)
        if total < least:
            best, least = i, total
    node = now[best]
    return SpeedPlan(node[FIRST], survived, node[S], node[V], node[RISK], node[INSIDE], False)


@kernel_in_place
def _expand(
    situation: Situation,
    station: float,
    now: Floats,
    count: int,
    following: Floats,
    interval: int,
    stage: int,
    places: Ints,
) -> int:
    """Try every acceleration from every node of a stage, and return the number of nodes of the next stage."""
    places[:] = -1
    found = 0
    ok, s, v, cost, risk, inside = True, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(count):
        capped = False
        for option in range(HARDEST[stage], STRONGEST[stage] + 1):
            a = ACCELERATIONS[option]
            if now[i, V] == 0.0 and a < 0.0:
                continue
            if not capped:  # once capped, a stronger acceleration gives the same motion
                ok, s, v, cost, risk, inside, capped = _advance(
                    situation, now[i, S], now[i, V], a, interval, STAGES[stage]
                )
            if not ok:
                continue
            change = a - now[i, LAST]
            total = now[i, TOTAL] + cost + situation.p.jerk_cost * change * change
            row = min(int(FINENESS * math.sqrt(s - station)), N_STATION_BINS - 1)
            column = min(math.ceil(FINENESS * math.sqrt(v)), N_SPEED_BINS - 1)
            place = places[row, column]
            if place < 0:
                place = found
                places[row, column] = place
                found += 1
            elif total >= following[place, TOTAL]:
                continue
            node = following[place]
            node[S], node[V], node[LAST], node[TOTAL] = s, v, a, total
            node[FIRST] = a if interval == 0 else now[i, FIRST]
            node[RISK], node[INSIDE] = now[i, RISK] + risk, now[i, INSIDE] + inside
    return found


@kernel_in_place
def _debt(situation: Situation, s: float, v: float, survived: int) -> float:
    """Return the cost of the braking that a plan leaves for later; without it every plan would brake too late."""
    if survived < N_INTERVALS:
        return 0.0
    debt = _braking_cost(situation, v, situation.wall - s)
    spans, last = situation.graph.spans, N_INTERVALS - 1
    for i in range(situation.graph.counts[last]):
        if spans[last, i, LEADS] == 1.0:
            room = spans[last, i, HARD_LOW] - s
            debt = max(debt, _braking_cost(situation, v - spans[last, i, LEAD_SPEED], room))
    return debt


@kernel_in_place
def _braking_cost(situation: Situation, closing: float, room: float) -> float:
    """Return the cost of losing a closing speed [m/s] within a distance [m] by constant braking."""
    if closing <= 0.0:
        return 0.0
    needed = closing * closing / (2 * max(room, situation.p.bumper_gap))
    return situation.p.braking_cost * needed * closing


@kernel_in_place
def _advance(
    situation: Situation, s: float, v: float, a: float, interval: int, count: int
) -> tuple[bool, float, float, float, float, float, bool]:
    """Drive on with one acceleration.

    Returns:
        True if there is no contact and the wall is not passed; station, speed, cost, risk and time inside the junction;
        and True if the speed is at its limit all the time, so that a stronger acceleration makes no difference.
    """
    path, graph, p = situation.path, situation.graph, situation.p
    spans = graph.spans
    inside_from, inside_until = path.junction_start - situation.half_length, path.junction_end + situation.half_length
    cost, risk, inside, capped = 0.0, 0.0, 0.0, True
    for k in range(interval, interval + count):
        limit = limit_at(path, s)
        cap = max(limit, v)
        after = max(v + a * INTERVAL, 0.0)
        capped = capped and after >= cap
        after = min(after, cap)
        ahead = s + 0.5 * (v + after) * INTERVAL
        if ahead > situation.wall:
            return False, s, v, cost, risk, inside, capped
        near = ahead > graph.reaches[k, 0] and s < graph.reaches[k, 1]
        for i in range(graph.counts[k] if near else 0):
            if ahead > spans[k, i, HARD_LOW] and s < spans[k, i, HARD_HIGH]:
                return False, s, v, cost, risk, inside, capped
            if ahead > spans[k, i, SOFT_LOW] and s < spans[k, i, SOFT_HIGH]:
                cost += situation.caution * spans[k, i, COST] * INTERVAL
                risk += spans[k, i, COST] * INTERVAL
        achieved = (after - v) / INTERVAL
        effort = p.acceleration_cost if 0.0 < achieved <= p.comfortable_acceleration else p.braking_cost
        hurry = 1.5 - k / N_INTERVALS  # meters count more now than later, or the ego would always start later
        cost += (p.delay_cost * hurry * (limit - after) + effort * achieved * achieved) * INTERVAL
        if after > limit:
            cost += p.overspeed_cost * (after - limit) * INTERVAL
        s, v = ahead, after
        halting = achieved <= 0.0 and v < p.slow_speed
        if halting and inside_from < s < inside_until:
            cost += p.keep_clear_cost * INTERVAL
            inside += INTERVAL
    return True, s, v, cost, risk, inside, capped


@kernel_in_place
def _escape(situation: Situation, station: float, speed: float) -> SpeedPlan:
    """Return the acceleration with the latest contact, for when no motion is free of contact.

    Among accelerations with equally late contact, the hardest braking is chosen.
    """
    best, latest = ACCELERATIONS[0], -1
    for a in ACCELERATIONS:
        contact = _first_contact(situation, station, speed, a)
        if contact > latest:
            best, latest = a, contact
    return SpeedPlan(best, 0, station, speed, 0.0, 0.0, False)


@kernel_in_place
def _first_contact(situation: Situation, s: float, v: float, a: float) -> int:
    """Return the first interval in which boxes touch on the path."""
    graph, gap = situation.graph, situation.p.bumper_gap
    for k in range(N_INTERVALS):
        after = min(max(v + a * INTERVAL, 0.0), max(v, situation.path.speed_limit))
        ahead = s + 0.5 * (v + after) * INTERVAL
        for i in range(graph.counts[k]):
            low, high = graph.spans[k, i, HARD_LOW], graph.spans[k, i, HARD_HIGH]
            if ahead > low + gap and s < high - gap:
                return k
        s, v = ahead, after
    return N_INTERVALS
