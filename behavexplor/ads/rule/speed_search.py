"""Search of the speed: dynamic programming over the stations and speeds that the ego can reach, stage by stage."""

import math
from typing import Final, NamedTuple

import numpy as np

from behavexplor.ads.rule.parameters import Numbers
from behavexplor.ads.rule.speed_motions import (
    ACCELERATIONS,
    BEFORE,
    CHOSEN,
    CLEAR,
    HARDEST,
    MOST,
    MOST_HURRY,
    N_BINS,
    N_ROWS,
    N_SPEED_BINS,
    RISKED,
    SPEED,
    SPENT,
    STAGES,
    STATION,
    STOPPED,
    STRONGEST,
    TOTAL_SPENT,
    Situation,
    drive,
    speed_bin,
    station_bin,
)
from behavexplor.ads.rule.station_time import HARD_LOW, INTERVAL, LEAD_SPEED, LEADS, N_INTERVALS
from behavexplor.data.array_types import Floats, Ints
from behavexplor.jit import kernel, kernel_inner

CLOSE, WIDE = 1.1, 1.5  # the first two bounds of the search, in multiples of the expected cost
ROUNDING: Final = 1e-9  # much more than the share by which roundings change a cost

S, V, LAST, FIRST, TOTAL, RISK, INSIDE = range(7)  # columns of a node


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

    The arguments are those of `behavexplor.ads.rule.option.plan_speed`.
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

    Costs never fall along a motion, so motions beyond the bound never lead to one within it, and in no bin are they
    cheaper than one within it. Without them, the search finds the same plan if its cost is within the bound. Only the
    order of the nodes changes, which matters if two costs are equal.

    Returns:
        The plan, and whether it is surely that of a search without a bound.
    """
    now, following, count = nodes.stages[0], nodes.stages[1], 1
    now[0, S], now[0, V], now[0, LAST], now[0, FIRST] = station, speed, acceleration, 0.0
    now[0, TOTAL], now[0, RISK], now[0, INSIDE] = 0.0, 0.0, 0.0
    survived, tied = 0, False
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
        node[S], node[V], node[LAST] = motions[STATION + j], motions[SPEED + j], a
        node[TOTAL] = motions[TOTAL_SPENT + j]
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
