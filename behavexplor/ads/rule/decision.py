"""Decision: wait before the junction, or go; with memory."""

from typing import Final

import numpy as np

from behavexplor.ads.road.path import Path
from behavexplor.ads.rule import station_time
from behavexplor.ads.rule.memory import Memory
from behavexplor.ads.rule.parameters import Numbers
from behavexplor.ads.rule.speed_search import SpeedPlan
from behavexplor.ads.rule.station_time import StationTime
from behavexplor.ads.rule.weaknesses import R1_3, R3_4, note
from behavexplor.data.array_types import Ints
from behavexplor.jit import kernel_inner

CRUISE: Final = 0  # drive as on a free road
FOLLOW: Final = 1  # adapt the speed to other vehicles
YIELD: Final = 2  # stop before the junction, or wait there
GO: Final = 3  # cross the junction
STOP: Final = 4  # stop before an obstacle
EMERGENCY: Final = 5  # avoid or delay a contact that may be close
CREEP: Final = 6  # move on a little after a long wait

ALARM: Final = 3.0  # time without contact below which a plan is an emergency [s]
STANDING: Final = 0.3  # speed below which the ego stands [m/s]

CREEP_TIME: Final = 0.5  # duration of the acceleration while creeping [s]
CREEP_ROOM: Final = 1.0  # distance that must stay free ahead of a creeping ego [m]
CREEP_INTERVALS: Final = 12  # number of intervals for which it must stay free
RESTART_OUTLOOK: Final = 1.0  # time over which a hasty planner looks ahead (R1-3) [s]
RESTART_WAIT: Final = 0.5  # time after which a hasty planner decides anew (R1-3) [s]


@kernel_inner
def can_wait(path: Path, station: float, speed: float, half_length: float, p: Numbers) -> bool:
    """Return whether firm braking stops the ego before the junction, or within `line_overrun` beyond the stop line."""
    line = path.junction_start - half_length
    return station + speed * speed / (2 * p.firm_braking) <= line + p.line_overrun


@kernel_inner
def passed(path: Path, station: float, half_length: float) -> bool:
    """Return whether the ego has left the junction, or there is no junction."""
    return station >= path.junction_end + half_length


@kernel_inner
def waiting_station(path: Path, station: float, speed: float, half_length: float, p: Numbers) -> float:
    """Return the station for waiting [m]: with a gap to the stop line if firm braking suffices, else closer."""
    line = path.junction_start - half_length
    return min(line + p.line_overrun, max(line - p.stop_line_gap, station + speed * speed / (2 * p.firm_braking)))


@kernel_inner
def crosses_freely(path: Path, graph: StationTime, plan: SpeedPlan, half_length: float) -> bool:
    """Return whether a plan stays before the junction, or crosses it without stopping or coming too close to a vehicle.

    There must be room beyond the junction: no vehicle ahead may end up where the ego would have to stop inside.
    """
    if plan.station <= path.junction_start - half_length:
        return True
    spans, last = graph.spans, station_time.N_INTERVALS - 1
    for i in range(graph.counts[last]):
        leads = spans[last, i, station_time.LEADS] == 1.0
        if leads and spans[last, i, station_time.SOFT_LOW] < path.junction_end + half_length:
            return False
    return plan.risk == 0.0 and plan.inside == 0.0


@kernel_inner
def decision_code(path: Path, plan: SpeedPlan, station: float, half_length: float, yields: bool) -> int:
    """Return the code of a plan's decision for the decision log."""
    if plan.survived * station_time.INTERVAL < ALARM:
        return EMERGENCY
    if yields:
        return YIELD
    if path.junction_start - half_length < station < path.junction_end + half_length:
        return GO
    if plan.free:
        return CRUISE
    return STOP if plan.speed < STANDING else FOLLOW


@kernel_inner
def restarts_hastily(crosses: bool, memory: Memory, bits: Ints, p: Numbers) -> bool:
    """Return whether the ego, which has stood and yielded, hardly looks ahead now (weakness R1-3)."""
    if p.restart == 0.0 or memory.waited < RESTART_WAIT:
        return False
    note(bits, R1_3, not crosses)
    if not crosses:
        memory.restarted = p.restart
    return not crosses


@kernel_inner
def waits_for_ever(graph: StationTime, memory: Memory, bits: Ints, p: Numbers) -> bool:
    """Return whether a standing ego waits for a vehicle that hardly moves across its way (weakness R3-4)."""
    if memory.waited == 0.0 or not _deadlocked(graph, memory, p):
        return False
    note(bits, R3_4, True)
    return True


@kernel_inner
def _deadlocked(graph: StationTime, memory: Memory, p: Numbers) -> bool:
    """Return whether the gate of weakness R3-4 is open."""
    return bool(p.deadlock > 0.0 and memory.stood >= p.deadlock_after and _slowest(graph) < p.deadlock)


@kernel_inner
def _slowest(graph: StationTime) -> float:
    """Return the least speed of the vehicles that cross or lead [m/s], infinity without any."""
    slowest = np.inf
    for k in range(station_time.N_INTERVALS):
        for i in range(graph.counts[k]):
            slowest = min(slowest, graph.spans[k, i, station_time.LEAD_SPEED])
    return slowest


@kernel_inner
def shorten(graph: StationTime, outlook: float) -> None:
    """Remove the vehicles that cross or merge later than an outlook [s]."""
    for k in range(station_time.N_INTERVALS):
        if k * station_time.INTERVAL < outlook:
            continue
        kept = 0
        for i in range(graph.counts[k]):
            if graph.spans[k, i, station_time.LEADS] == 1.0:
                for column in range(station_time.N_COLUMNS):
                    graph.spans[k, kept, column] = graph.spans[k, i, column]
                kept += 1
        graph.counts[k] = kept


@kernel_inner
def may_creep(graph: StationTime, station: float, limit: float, memory: Memory, bits: Ints, p: Numbers) -> bool:
    """Return whether an ego that has stood for long may move on a little: no vehicle is or comes close ahead of it."""
    if memory.stood < p.creep_after or station + CREEP_ROOM / 2 > limit:
        return False
    for k in range(CREEP_INTERVALS):
        for i in range(graph.counts[k]):
            low, high = graph.spans[k, i, station_time.HARD_LOW], graph.spans[k, i, station_time.HARD_HIGH]
            if low < station + CREEP_ROOM and high > station:
                return False
    if _deadlocked(graph, memory, p):
        note(bits, R3_4, True)
        return False
    return True


@kernel_inner
def creep(graph: StationTime, station: float, limit: float, memory: Memory, bits: Ints, p: Numbers) -> bool:
    """Return whether the ego creeps now. Once begun, creeping goes on for `CREEP_TIME`."""
    if memory.creeps <= 0.0 and may_creep(graph, station, limit, memory, bits, p):
        memory.creeps = CREEP_TIME
    return bool(memory.creeps > 0.0)
