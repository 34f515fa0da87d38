"""Decision: whether to wait before the junction or to go, with memory."""

from typing import Final

from behavexplor.ads.rule.parameters import Numbers
from behavexplor.ads.rule.path import Path
from behavexplor.ads.rule.speed import SpeedPlan
from behavexplor.ads.rule.station_time import INTERVAL, LEADS, N_INTERVALS, SOFT_LOW, StationTime
from behavexplor.compiled import kernel

CRUISE: Final = 0  # drives as on a free road
FOLLOW: Final = 1  # adapts its speed to others
YIELD: Final = 2  # stops before the junction, or waits there
GO: Final = 3  # crosses the junction
STOP: Final = 4  # stops before an obstacle
EMERGENCY: Final = 5  # avoids or delays a contact that may be close

ALARM: Final = 3.0  # a plan without contact for a shorter time is an emergency [s]
STANDING: Final = 0.3  # [m/s]


@kernel
def can_wait(path: Path, station: float, speed: float, half_length: float, p: Numbers) -> bool:
    """Whether firm braking stops the ego before the junction, or little enough behind the stop line."""
    line = path.junction_start - half_length
    return station + speed * speed / (2 * p.firm_braking) <= line + p.line_overrun


@kernel
def passed(path: Path, station: float, half_length: float) -> bool:
    """Whether the ego has left the junction behind, or there is none."""
    return station >= path.junction_end + half_length


@kernel
def waiting_station(path: Path, station: float, speed: float, half_length: float, p: Numbers) -> float:
    """Where to wait: with a gap to the stop line if firm braking still does, else closer [m]."""
    line = path.junction_start - half_length
    return min(line + p.line_overrun, max(line - p.stop_line_gap, station + speed * speed / (2 * p.firm_braking)))


@kernel
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


@kernel
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
