"""Search of the speed: dynamic programming over the stations and speeds that the ego can reach, stage by stage.

All motions are driven side by side through a stage, one interval after the other. Their arithmetic then has no
branches, so the processor works on several motions at once.
"""

import math
from typing import Final, NamedTuple

import numpy as np

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
from behavexplor.data.array_types import Floats, Ints
from behavexplor.jit import int64, kernel, kernel_inner

STAGES: Final = (2, 2, 4, 4, 4, 4, 6, 6)  # number of intervals in each stage of constant acceleration
ACCELERATIONS: Final = (-8.0, -5.0, -3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 4.0)  # candidate accelerations [m/s2]
HARDEST: Final = (0, 0, 1, 1, 2, 2, 2, 2)  # index of the hardest braking in each stage
STRONGEST: Final = (8, 8, 8, 8, 7, 7, 7, 7)  # index of the strongest acceleration in each stage

FINENESS: Final = 2.5  # bins per root of distance or speed, fine near 0; a stage keeps one node a bin
N_STATION_BINS: Final = 42
N_SPEED_BINS: Final = 16
N_BINS: Final = N_STATION_BINS * N_SPEED_BINS
MOST_HURRY: Final = 1.5  # weight of the delay in the first interval

# Where the rows of the motions of a stage begin. They are one array with constant offsets, so that the compiler knows
# that rows do not overlap. Otherwise, it would not compute several motions at once.
MOST: Final = N_BINS * len(ACCELERATIONS)
N_ROWS: Final = 12
STATION, SPEED, LIMIT, AHEAD, AFTER, CLEAR = (i * MOST for i in range(6))
CHOSEN, BEFORE, SPENT, TOTAL_SPENT, RISKED, STOPPED = (i * MOST for i in range(6, N_ROWS))

CLOSE, WIDE = 1.1, 1.5  # the first two bounds of the search, in multiples of the expected cost
ROUNDING: Final = 1e-9  # much more than the share by which roundings change a cost
S, V, LAST, FIRST, TOTAL, RISK, INSIDE = range(7)  # columns of a node


class Situation(NamedTuple):
    """Input of the speed search apart from the ego's motion."""

    path: Path  # path of the ego
    graph: StationTime  # stretches of the path that other vehicles occupy
    half_length: float  # half the length of the ego [m]
    wall: float  # station that must not be passed [m], infinite for none
    caution: float  # share of the cost of coming too close to other vehicles that counts
    # cost that the best motion probably has; it makes the search faster, and does not change its result
    expected: float
    p: Numbers  # parameters of the planner


class SpeedPlan(NamedTuple):
    """The best motion along the path."""

    acceleration: float  # acceleration to command now [m/s2]
    survived: int  # number of intervals without contact
    station: float  # station at the end [m]
    speed: float  # speed at the end [m/s]
    risk: float  # cost of coming too close to other vehicles
    inside: float  # time of stopping inside the junction [s]
    free: bool  # True if the motion is that on a free road
    cost: float  # cost of the motion, 0 if the search did not find it


class Nodes(NamedTuple):
    """Working space for the search."""

    stages: Floats  # nodes of the present and the next stage, shape (2, N_BINS, 7)
    cheapest: Ints  # cheapest motion into each bin, shape (N_BINS,), -1 for none
    filled: Ints  # bins with a motion, in the order in which they are found, shape (N_BINS,)
    motions: Floats  # rows of the motions of a stage, shape (N_ROWS * MOST,)
    parents: Ints  # node from which each motion starts, shape (MOST,)
    bins: Ints  # bin in which each motion ends, shape (MOST,)


@kernel
def empty_nodes() -> Nodes:
    """Allocate working space for one search at a time."""
    return Nodes(
        np.empty((2, N_BINS, 7)),
        np.empty(N_BINS, np.int64),
        np.empty(N_BINS, np.int64),
        np.empty(N_ROWS * MOST),
        np.empty(MOST, np.int64),
        np.empty(MOST, np.int64),
    )


@kernel_inner
def search(situation: Situation, station: float, speed: float, acceleration: float, nodes: Nodes) -> SpeedPlan:
    """Find the cheapest way to each (station, speed) stage by stage, and return the cheapest of the last stage.

    Station [m] and speed [m/s] are the ego's, and the acceleration is the last that was commanded [m/s2].
    """
    p, expected = situation.p, situation.expected
    if p.overspeed_cost < MOST_HURRY * p.delay_cost:  # then driving above the limit lowers the cost
        expected = math.inf
    for bound in (CLOSE * expected, WIDE * expected, math.inf):
        plan, is_sure = _search_below(bound, situation, station, speed, acceleration, nodes)
        if is_sure:
            break
    return plan


@kernel_inner
def _search_below(
    bound: float, situation: Situation, station: float, speed: float, acceleration: float, nodes: Nodes
) -> tuple[SpeedPlan, bool]:
    """Search among the motions whose cost does not exceed a bound.

    Return the plan, and whether it is surely that of a search without a bound.

    Costs never fall along a motion, so motions beyond the bound never lead to one within it, and in no bin are they
    cheaper than one within it. Without them, the search finds the same plan if its cost is within the bound. Only the
    order of the nodes changes, which matters if two costs are equal.
    """
    now, following = nodes.stages[0], nodes.stages[1]
    now[0, S], now[0, V], now[0, LAST], now[0, FIRST] = station, speed, acceleration, 0.0
    now[0, TOTAL], now[0, RISK], now[0, INSIDE] = 0.0, 0.0, 0.0
    count, survived, tied = int64(1), int64(0), False  # int64, as after the first stage
    for stage in range(len(STAGES)):
        n = _choose(now, count, stage, bound, situation.p, nodes)
        _begin(now, n, nodes)
        for k in range(survived, survived + STAGES[stage]):
            drive(situation, k, n, nodes.motions)
        _compare(situation, station, bound, n, nodes)
        found, more_tied = _keep_cheapest(now, following, n, stage == 0, nodes)
        if found == 0:
            break
        survived += STAGES[stage]
        tied = tied or more_tied
        now, following, count = following, now, found
    best, least = 0, math.inf
    for i in range(count):
        total = now[i, TOTAL] + _debt(situation, now[i, S], now[i, V], survived)
        tied = tied or total == least
        if total < least:
            best, least = i, total
    node = now[best]
    is_sure = survived == N_INTERVALS and not tied and least < (1.0 - ROUNDING) * bound
    return SpeedPlan(node[FIRST], survived, node[S], node[V], node[RISK], node[INSIDE], False, least), is_sure


@kernel_inner
def _choose(now: Floats, count: int, stage: int, bound: float, p: Numbers, nodes: Nodes) -> int:
    """Choose the motions of a stage, each a node and an acceleration from there, and return their number.

    Those whose changes of acceleration and speed alone cost more than the bound are left out.
    """
    duration, n = STAGES[stage] * INTERVAL, 0
    for i in range(count):
        hardest = -now[i, V] / duration  # braking to a standstill costs least if it takes the whole stage
        for option in range(HARDEST[stage], STRONGEST[stage] + 1):
            a = ACCELERATIONS[option]
            change, braking = a - now[i, LAST], min(max(a, hardest), 0.0)
            cost = now[i, TOTAL] + p.jerk_cost * change * change + p.braking_cost * braking * braking * duration
            nodes.parents[n], nodes.motions[CHOSEN + n] = i, a
            n += (cost <= bound) & ((a >= 0.0) | (now[i, V] > 0.0))  # no branch, which would be hard to predict
    return n


@kernel_inner
def _begin(now: Floats, n: int, nodes: Nodes) -> None:
    """Begin the chosen motions at their nodes."""
    motions = nodes.motions
    for j in range(n):
        node = now[nodes.parents[j]]
        motions[STATION + j], motions[SPEED + j] = node[S], node[V]
        motions[BEFORE + j], motions[TOTAL_SPENT + j] = node[LAST], node[TOTAL]
    for j in range(n):
        motions[SPENT + j], motions[RISKED + j], motions[STOPPED + j], motions[CLEAR + j] = 0.0, 0.0, 0.0, 1.0


@kernel_inner
def drive(situation: Situation, k: int, n: int, motions: Floats) -> None:
    """Drive all motions of a stage through one interval. Those that end in contact are marked, and driven on."""
    path, p = situation.path, situation.p
    for j in range(n):
        motions[LIMIT + j] = limit_at(path, motions[STATION + j])
    for j in range(n):
        motions[AHEAD + j], motions[AFTER + j] = moved(
            motions[STATION + j], motions[SPEED + j], motions[CHOSEN + j], motions[LIMIT + j]
        )
    _meet_all(situation, k, n, motions)
    for j in range(n):
        v, after, limit = motions[SPEED + j], motions[AFTER + j], motions[LIMIT + j]
        cost = _plus_effort(motions[SPENT + j], v, after, limit, k, p)
        stops = stops_inside(situation, v, after, motions[AHEAD + j])
        motions[SPENT + j] = cost + (p.keep_clear_cost * INTERVAL if stops else 0.0)
        motions[STOPPED + j] += INTERVAL if stops else 0.0
        motions[STATION + j], motions[SPEED + j] = motions[AHEAD + j], after


@kernel_inner
def _meet_all(situation: Situation, k: int, n: int, motions: Floats) -> None:
    """Mark the motions of an interval that end in contact, and add the costs of those that come too close."""
    spans = situation.graph.spans
    for i in range(situation.graph.counts[k]):
        risk = spans[k, i, COST] * INTERVAL
        cost = situation.caution * spans[k, i, COST] * INTERVAL
        hard_low, hard_high = spans[k, i, HARD_LOW], spans[k, i, HARD_HIGH]
        soft_low, soft_high = spans[k, i, SOFT_LOW], spans[k, i, SOFT_HIGH]
        for j in range(n):
            s, ahead = motions[STATION + j], motions[AHEAD + j]
            touches = (ahead > hard_low) & (s < hard_high)
            is_close = (ahead > soft_low) & (s < soft_high)
            motions[CLEAR + j] = 0.0 if touches else motions[CLEAR + j]
            motions[SPENT + j] += cost if is_close else 0.0
            motions[RISKED + j] += risk if is_close else 0.0
    for j in range(n):
        motions[CLEAR + j] = 0.0 if motions[AHEAD + j] > situation.wall else motions[CLEAR + j]


@kernel_inner
def moved(s: float, v: float, a: float, limit: float) -> tuple[float, float]:
    """Return station and speed after one interval, in which the speed does not rise above the limit."""
    after = min(max(v + a * INTERVAL, 0.0), max(limit, v))
    return s + 0.5 * (v + after) * INTERVAL, after


@kernel_inner
def stops_inside(situation: Situation, v: float, after: float, ahead: float) -> bool:
    """Return whether the ego hardly moves, and does not speed up, inside the junction."""
    begin = situation.path.junction_start - situation.half_length
    end = situation.path.junction_end + situation.half_length
    return (after <= v) & (after < situation.p.slow_speed) & (begin < ahead) & (ahead < end)


@kernel_inner
def _plus_effort(cost: float, v: float, after: float, limit: float, k: int, p: Numbers) -> float:
    """Return a cost with those of delay, of changing the speed, and of exceeding the limit in an interval added."""
    achieved = (after - v) / INTERVAL
    eases = (achieved > 0.0) & (achieved <= p.comfortable_acceleration)
    effort = p.acceleration_cost if eases else p.braking_cost
    hurry = MOST_HURRY - k / N_INTERVALS  # meters count more now than later, or the ego would always start later
    cost += (p.delay_cost * hurry * (limit - after) + effort * achieved * achieved) * INTERVAL
    return cost + (p.overspeed_cost * (after - limit) * INTERVAL if after > limit else 0.0)


@kernel_inner
def _compare(situation: Situation, station: float, bound: float, n: int, nodes: Nodes) -> None:
    """Compute the bin in which each motion ends, and its cost since the start of the plan.

    The cost is infinite after a contact, and beyond the bound.
    """
    motions, jerk_cost = nodes.motions, situation.p.jerk_cost
    for j in range(n):
        row, column = station_bin(motions[STATION + j] - station), speed_bin(motions[SPEED + j])
        nodes.bins[j] = row * N_SPEED_BINS + column
    for j in range(n):
        change = motions[CHOSEN + j] - motions[BEFORE + j]
        total = motions[TOTAL_SPENT + j] + motions[SPENT + j] + jerk_cost * change * change
        motions[TOTAL_SPENT + j] = total if (motions[CLEAR + j] == 1.0) & (total <= bound) else math.inf


@kernel_inner
def _keep_cheapest(now: Floats, following: Floats, n: int, is_first: bool, nodes: Nodes) -> tuple[int, bool]:
    """Keep the cheapest motion in each bin as a node of the next stage.

    Return the number of nodes, and whether motions from several nodes had equal costs, so that their order decided.
    """
    motions, bins, cheapest = nodes.motions, nodes.bins, nodes.cheapest
    found, tied = 0, False
    cheapest[:] = -1
    for j in range(n):
        best = cheapest[bins[j]]
        least = math.inf if best < 0 else motions[TOTAL_SPENT + best]
        if motions[TOTAL_SPENT + j] == least < math.inf:
            tied = tied or nodes.parents[j] != nodes.parents[best]
        if motions[TOTAL_SPENT + j] < least:
            if best < 0:
                nodes.filled[found] = bins[j]
                found += 1
            cheapest[bins[j]] = j
    for place in range(found):
        j = cheapest[nodes.filled[place]]
        node, before, a = following[place], now[nodes.parents[j]], motions[CHOSEN + j]
        node[S], node[V], node[LAST] = motions[STATION + j], motions[SPEED + j], a
        node[TOTAL] = motions[TOTAL_SPENT + j]
        node[FIRST] = a if is_first else before[FIRST]
        node[RISK], node[INSIDE] = before[RISK] + motions[RISKED + j], before[INSIDE] + motions[STOPPED + j]
    return found, tied


@kernel_inner
def station_bin(driven: float) -> int:
    """Return the row of bins for a distance since the start of the plan [m]."""
    return min(int(FINENESS * math.sqrt(driven)), N_STATION_BINS - 1)


@kernel_inner
def speed_bin(speed: float) -> int:
    """Return the column of bins for a speed [m/s]."""
    return min(math.ceil(FINENESS * math.sqrt(speed)), N_SPEED_BINS - 1)


@kernel_inner
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


@kernel_inner
def _braking_cost(situation: Situation, closing: float, room: float) -> float:
    """Return the cost of losing a closing speed [m/s] within a distance [m] by constant braking."""
    if closing <= 0.0:
        return 0.0
    needed = closing * closing / (2 * max(room, situation.p.bumper_gap))
    return situation.p.braking_cost * needed * closing
