"""Motions of the speed search: they are driven side by side through a stage, one interval after the other.

Their arithmetic then has no branches, so the processor works on several motions at once.
"""

import math
from typing import Final, NamedTuple

from behavexplor.ads.road.path import Path, limit_at
from behavexplor.ads.rule.parameters import Numbers
from behavexplor.ads.rule.station_time import (
    COST,
    HARD_HIGH,
    HARD_LOW,
    INTERVAL,
    N_INTERVALS,
    SOFT_HIGH,
    SOFT_LOW,
    StationTime,
)
from behavexplor.data.array_types import Floats
from behavexplor.jit import kernel_inner

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


@kernel_inner
def station_bin(driven: float) -> int:
    """Return the row of bins for a distance since the start of the plan [m]."""
    return min(int(FINENESS * math.sqrt(driven)), N_STATION_BINS - 1)


@kernel_inner
def speed_bin(speed: float) -> int:
    """Return the column of bins for a speed [m/s]."""
    return min(math.ceil(FINENESS * math.sqrt(speed)), N_SPEED_BINS - 1)


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
