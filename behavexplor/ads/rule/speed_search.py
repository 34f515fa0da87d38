"""Search of the speed: dynamic programming over the stations and speeds that the ego can reach, stage by stage.

All motions of a stage are driven side by side, one interval after the other. Their arithmetic then has no branches, so
the processor works on several motions at once.
"""

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
from behavexplor.jit import kernel, kernel_inner

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

STAGES: Final = (2, 2, 4, 4, 4, 4, 6, 6)  # number of intervals in each stage of constant acceleration
ACCELERATIONS: Final = (-8.0, -5.0, -3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 4.0)  # candidate accelerations [m/s2]
HARDEST: Final = (0, 0, 1, 1, 2, 2, 2, 2)  # index of the hardest braking in each stage
STRONGEST: Final = (8, 8, 8, 8, 7, 7, 7, 7)  # index of the strongest acceleration in each stage

FINENESS: Final = 2.5  # bins per root of distance or speed, fine near 0; a stage keeps one node a bin
N_STATION_BINS: Final = 42
N_SPEED_BINS: Final = 16
N_BINS: Final = N_STATION_BINS * N_SPEED_BINS

MOST_HURRY: Final = 1.5  # weight of the delay in the first interval
MARGIN: Final = 0.1  # share by which the bound of the search exceeds the expected cost
ROUNDING: Final = 1e-9  # share of the bound by which roundings may change a cost, and much more

S, V, LAST, FIRST, TOTAL, RISK, INSIDE = range(7)  # columns of a node

# Where the rows of the motions of a stage begin. They are one array with constant offsets, so that the compiler knows
# that rows do not overlap. Otherwise, it would not compute several motions at once.
MOST: Final = N_BINS * len(ACCELERATIONS)
N_ROWS: Final = 12
STATION, SPEED, LIMIT, AHEAD, AFTER, CLEAR = (i * MOST for i in range(6))
CHOSEN, BEFORE, SPENT, TOTAL_SPENT, RISKED, STOPPED = (i * MOST for i in range(6, N_ROWS))


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
        cost: cost of the motion, 0 if the search did not find it.
    """

    acceleration: float
    survived: int
    station: float
    speed: float
    risk: float
    inside: float
    free: bool
    cost: float


class Situation(NamedTuple):
    """Input of the speed search apart from the ego's motion.

    Attributes:
        path: path of the ego.
        graph: stretches of the path that other vehicles occupy.
        half_length: half the length of the ego [m].
        wall: station that must not be passed [m], infinite for none.
        caution: share of the cost of coming too close to other vehicles that counts.
        expected: cost that the best motion probably has; it makes the search faster, and does not change its result.
        p: parameters of the planner.
    """

    path: Path
    graph: StationTime
    half_length: float
    wall: float
    caution: float
    expected: float
    p: Numbers


class Nodes(NamedTuple):
    """Working space for the search.

    Attributes:
        stages: nodes of the present and the next stage, shape (2, N_BINS, 7).
        cheapest: cheapest motion into each bin, shape (N_BINS,), -1 for none.
        filled: bins with a motion, in the order in which they are found, shape (N_BINS,).
        motions: rows of the motions of a stage, shape (N_ROWS * MOST,).
        parents: node from which each motion starts, shape (MOST,).
        bins: bin in which each motion ends, shape (MOST,).
    """

    stages: Floats
    cheapest: Ints
    filled: Ints
    motions: Floats
    parents: Ints
    bins: Ints


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

    The arguments are those of `behavexplor.ads.rule.speed.plan_speed`.
    """
    plan, is_sure = _search_below(_bound(situation), situation, station, speed, acceleration, nodes)
    if is_sure:
        return plan
    return _search_below(math.inf, situation, station, speed, acceleration, nodes)[0]


@kernel_inner
def _bound(situation: Situation) -> float:
    """Return a cost that the cheapest motion probably does not exceed."""
    p = situation.p
    grows = p.overspeed_cost >= MOST_HURRY * p.delay_cost  # else, driving above the limit would lower the cost
    return (1.0 + MARGIN) * situation.expected if grows else math.inf


@kernel_inner
def _search_below(
    bound: float, situation: Situation, station: float, speed: float, acceleration: float, nodes: Nodes
) -> tuple[SpeedPlan, bool]:
    """Search among the motions whose cost does not exceed a bound.

    Costs never fall along a motion. So what is left out does not change which motions within the bound are the cheapest
    in their bins, but it changes their order, which decides between motions of equal cost.

    Returns:
        The plan, and whether it is surely that of a search without a bound.
    """
    now, following, count = nodes.stages[0], nodes.stages[1], 1
    now[0, S], now[0, V], now[0, LAST], now[0, FIRST] = station, speed, acceleration, 0.0
    now[0, TOTAL], now[0, RISK], now[0, INSIDE] = 0.0, 0.0, 0.0
    survived, tied = 0, False
    for stage in range(len(STAGES)):
        n = _choose(now, count, stage, nodes)
        for k in range(survived, survived + STAGES[stage]):
            _drive(situation, k, n, nodes.motions)
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
def _choose(now: Floats, count: int, stage: int, nodes: Nodes) -> int:
    """Begin a motion with every acceleration from every node of a stage, and return the number of motions."""
    motions, n = nodes.motions, 0
    for i in range(count):
        for option in range(HARDEST[stage], STRONGEST[stage] + 1):
            a = ACCELERATIONS[option]
            if now[i, V] == 0.0 and a < 0.0:
                continue
            nodes.parents[n] = i
            motions[STATION + n], motions[SPEED + n], motions[CHOSEN + n] = now[i, S], now[i, V], a
            motions[BEFORE + n], motions[TOTAL_SPENT + n] = now[i, LAST], now[i, TOTAL]
            motions[SPENT + n], motions[RISKED + n], motions[STOPPED + n], motions[CLEAR + n] = 0.0, 0.0, 0.0, 1.0
            n += 1
    return n


@kernel_inner
def _drive(situation: Situation, k: int, n: int, motions: Floats) -> None:
    """Drive all motions of a stage through one interval. Those that end in contact are marked, and driven on."""
    path, p = situation.path, situation.p
    for j in range(n):
        motions[LIMIT + j] = limit_at(path, motions[STATION + j])
    for j in range(n):
        motions[AHEAD + j], motions[AFTER + j] = moved(
            motions[STATION + j], motions[SPEED + j], motions[CHOSEN + j], motions[LIMIT + j]
        )
    for j in range(n):
        s, ahead = motions[STATION + j], motions[AHEAD + j]
        if is_near(situation, k, s, ahead):
            clear, cost, risk = meet(situation, k, s, ahead, motions[SPENT + j], motions[RISKED + j])
            motions[SPENT + j], motions[RISKED + j] = cost, risk
            motions[CLEAR + j] = motions[CLEAR + j] if clear else 0.0
    for j in range(n):
        v, after, limit = motions[SPEED + j], motions[AFTER + j], motions[LIMIT + j]
        cost = _plus_effort(motions[SPENT + j], v, after, limit, k, p)
        stops = stops_inside(situation, v, after, motions[AHEAD + j])
        motions[SPENT + j] = cost + (p.keep_clear_cost * INTERVAL if stops else 0.0)
        motions[STOPPED + j] += INTERVAL if stops else 0.0
        motions[STATION + j], motions[SPEED + j] = motions[AHEAD + j], after


@kernel_inner
def moved(s: float, v: float, a: float, limit: float) -> tuple[float, float]:
    """Return station and speed after one interval, in which the speed does not rise above the limit."""
    after = min(max(v + a * INTERVAL, 0.0), max(limit, v))
    return s + 0.5 * (v + after) * INTERVAL, after


@kernel_inner
def is_near(situation: Situation, k: int, s: float, ahead: float) -> bool:
    """Return whether driving from one station to another meets a vehicle or the wall, or comes close to a vehicle."""
    reaches = situation.graph.reaches
    return ahead > situation.wall or (ahead > reaches[k, 0] and s < reaches[k, 1])


@kernel_inner
def meet(situation: Situation, k: int, s: float, ahead: float, cost: float, risk: float) -> tuple[bool, float, float]:
    """Return whether an interval is free of contact, and the cost and risk with those of coming too close added."""
    spans = situation.graph.spans
    for i in range(situation.graph.counts[k]):
        if ahead > spans[k, i, HARD_LOW] and s < spans[k, i, HARD_HIGH]:
            return False, cost, risk
        if ahead > spans[k, i, SOFT_LOW] and s < spans[k, i, SOFT_HIGH]:
            cost += situation.caution * spans[k, i, COST] * INTERVAL
            risk += spans[k, i, COST] * INTERVAL
    return ahead <= situation.wall, cost, risk


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
        row = min(int(FINENESS * math.sqrt(motions[STATION + j] - station)), N_STATION_BINS - 1)
        column = min(math.ceil(FINENESS * math.sqrt(motions[SPEED + j])), N_SPEED_BINS - 1)
        nodes.bins[j] = row * N_SPEED_BINS + column
    for j in range(n):
        change = motions[CHOSEN + j] - motions[BEFORE + j]
        total = motions[TOTAL_SPENT + j] + motions[SPENT + j] + jerk_cost * change * change
        motions[TOTAL_SPENT + j] = total if motions[CLEAR + j] == 1.0 and total <= bound else math.inf


@kernel_inner
def _keep_cheapest(now: Floats, following: Floats, n: int, is_first: bool, nodes: Nodes) -> tuple[int, bool]:
    """Keep the cheapest motion in each bin as a node of the next stage.

    Returns:
        The number of nodes, and whether motions from several nodes had equal costs, so that their order decided.
    """
    motions, bins, cheapest, found, tied = nodes.motions, nodes.bins, nodes.cheapest, 0, False
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
        node[S], node[V], node[LAST], node[TOTAL] = (
            motions[STATION + j],
            motions[SPEED + j],
            a,
            motions[TOTAL_SPENT + j],
        )
        node[FIRST] = a if is_first else before[FIRST]
        node[RISK], node[INSIDE] = before[RISK] + motions[RISKED + j], before[INSIDE] + motions[STOPPED + j]
    return found, tied


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
