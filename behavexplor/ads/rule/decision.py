"""Decision: whether to wait before the junction or to go, with memory."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from behavexplor.ads.road.path import Path
from behavexplor.ads.rule.memory import CREEPS, RESTARTED, STOOD, WAITED
from behavexplor.ads.rule.parameters import Numbers
from behavexplor.ads.rule.speed import SpeedPlan
from behavexplor.ads.rule.station_time import (
    HARD_HIGH,
    HARD_LOW,
    INTERVAL,
    LEAD_SPEED,
    LEADS,
    N_COLUMNS,
    N_INTERVALS,
    SOFT_LOW,
    StationTime,
)
from behavexplor.ads.rule.weaknesses import R1_3, R3_4, note
from behavexplor.jit import kernel_in_place

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

CRUISE: Final = 0  # drives as on a free road
FOLLOW: Final = 1  # adapts its speed to others
YIELD: Final = 2  # stops before the junction, or waits there
GO: Final = 3  # crosses the junction
STOP: Final = 4  # stops before an obstacle
EMERGENCY: Final = 5  # avoids or delays a contact that may be close
CREEP: Final = 6  # moves on a little after a long wait

ALARM: Final = 3.0  # a plan without contact for a shorter time is an emergency [s]
STANDING: Final = 0.3  # [m/s]

CREEP_TIME: Final = 0.5  # of accelerating while creeping [s]
CREEP_ROOM: Final = 1.0  # that must stay free ahead of a creeping ego [m]
CREEP_INTERVALS: Final = 12  # and for how long
RESTART_OUTLOOK: Final = 1.0  # of a hasty planner (R1-3) [s]
RESTART_WAIT: Final = 0.5  # after which a hasty planner decides anew (R1-3) [s]


@kernel_in_place
def can_wait(path: Path, station: float, speed: float, half_length: float, p: Numbers) -> bool:
    """Whether firm braking stops the ego before the junction, or little enough behind the stop line."""
    line = path.junction_start - half_length
    return station + speed * speed / (2 * p.firm_braking) <= line + p.line_overrun


@kernel_in_place
def passed(path: Path, station: float, half_length: float) -> bool:
    """Whether the ego has left the junction behind, or there is none."""
    return station >= path.junction_end + half_length


@kernel_in_place
def waiting_station(path: Path, station: float, speed: float, half_length: float, p: Numbers) -> float:
    """Where to wait: with a gap to the stop line if firm braking still does, else closer [m]."""
    line = path.junction_start - half_length
    return min(line + p.line_overrun, max(line - p.stop_line_gap, station + speed * speed / (2 * p.firm_braking)))


@kernel_in_place
def crosses_freely(path: Path, graph: StationTime, plan: SpeedPlan, half_length: float) -> bool:
    """Whether a plan stays before the junction, or crosses it without stopping or coming too close to others.

    Behind the junction there must be room: nobody ahead may end up where the ego would have to stop inside.
    """
    if plan.station <= path.junction_start - half_length:
        return True
    spans, last = graph.spans, N_INTERVALS - 1
    for i in range(graph.counts[last]):
        if spans[last, i, LEADS] == 1.0 and spans[last, i, SOFT_LOW] < path.junction_end + half_length:
            return False
    return plan.risk == 0.0 and plan.inside == 0.0


@kernel_in_place
def decision_code(path: Path, plan: SpeedPlan, station: float, half_length: float, yields: bool) -> int:
    """What the plan amounts to, for the log."""
    if plan.survived * INTERVAL < ALARM:
        return EMERGENCY
    if yields:
        return YIELD
    if path.junction_start - half_length < station < path.junction_end + half_length:
        return GO
    if plan.free:
        return CRUISE
    return STOP if plan.speed < STANDING else FOLLOW


@kernel_in_place
def restarts_hastily(crosses: bool, memory: Floats, bits: Ints, p: Numbers) -> bool:
    """Whether the ego, having stood and yielded, hardly looks ahead now (weakness R1-3)."""
    if p.restart == 0.0 or memory[WAITED] < RESTART_WAIT:
        return False
    note(bits, R1_3, not crosses)
    if not crosses:
        memory[RESTARTED] = p.restart
    return not crosses


@kernel_in_place
def waits_for_ever(graph: StationTime, memory: Floats, bits: Ints, p: Numbers) -> bool:
    """Whether a standing ego waits for somebody who hardly moves across its way (weakness R3-4)."""
    if memory[WAITED] == 0.0 or not _deadlocked(graph, memory, p):
        return False
    note(bits, R3_4, True)
    return True


@kernel_in_place
def _deadlocked(graph: StationTime, memory: Floats, p: Numbers) -> bool:
    """Whether the gate of weakness R3-4 is open."""
    return bool(p.deadlock > 0.0 and memory[STOOD] >= p.deadlock_after and _slowest(graph) < p.deadlock)


@kernel_in_place
def _slowest(graph: StationTime) -> float:
    """Least speed of those who cross or lead, infinite for nobody [m/s]."""
    slowest = np.inf
    for k in range(N_INTERVALS):
        for i in range(graph.counts[k]):
            slowest = min(slowest, graph.spans[k, i, LEAD_SPEED])
    return slowest


@kernel_in_place
def shorten(graph: StationTime, outlook: float) -> None:
    """Forget what crosses or merges later than an outlook [s]."""
    for k in range(N_INTERVALS):
        if k * INTERVAL < outlook:
            continue
        kept = 0
        for i in range(graph.counts[k]):
            if graph.spans[k, i, LEADS] == 1.0:
                for column in range(N_COLUMNS):
                    graph.spans[k, kept, column] = graph.spans[k, i, column]
                kept += 1
        graph.counts[k] = kept


@kernel_in_place
def may_creep(graph: StationTime, station: float, limit: float, memory: Floats, bits: Ints, p: Numbers) -> bool:
    """Whether an ego that has stood for long may move on a little: nobody is or comes close ahead of it."""
    if memory[STOOD] < p.creep_after or station + CREEP_ROOM / 2 > limit:
        return False
    for k in range(CREEP_INTERVALS):
        for i in range(graph.counts[k]):
            low, high = graph.spans[k, i, HARD_LOW], graph.spans[k, i, HARD_HIGH]
            if low < station + CREEP_ROOM and high > station:
                return False
    if _deadlocked(graph, memory, p):
        note(bits, R3_4, True)
        return False
    return True


@kernel_in_place
def creep(graph: StationTime, station: float, limit: float, memory: Floats, bits: Ints, p: Numbers) -> bool:
    """Whether the ego creeps now; it goes on for `CREEP_TIME` once it has begun."""
    if memory[CREEPS] <= 0.0 and may_creep(graph, station, limit, memory, bits, p):
        memory[CREEPS] = CREEP_TIME
    return bool(memory[CREEPS] > 0.0)
