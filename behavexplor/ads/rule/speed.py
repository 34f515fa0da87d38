"""Speed along the path: that of a free road, else the best motion that the search finds, else an escape."""

from typing import Final

from behavexplor.ads.road.path import Path, limit_at
from behavexplor.ads.rule.parameters import Numbers
from behavexplor.ads.rule.speed_motions import ACCELERATIONS, Situation, moved, stops_inside
from behavexplor.ads.rule.speed_search import Nodes, SpeedPlan, search
from behavexplor.ads.rule.station_time import COST, HARD_HIGH, HARD_LOW, INTERVAL, N_INTERVALS, SOFT_HIGH, SOFT_LOW
from behavexplor.jit import kernel_inner

RESPONSE: Final = 0.3  # time in which the free speed is reached [s]


@kernel_inner
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
    plan = search(situation, station, speed, acceleration, nodes)
    if plan.survived > 0:
        return plan
    return _escape(situation, station, speed)


@kernel_inner
def free_acceleration(path: Path, station: float, speed: float, p: Numbers) -> float:
    """Return a comfortable acceleration towards the limit, here and after the response time."""
    limit = min(limit_at(path, station), limit_at(path, station + RESPONSE * speed))
    return min(max((limit - speed) / RESPONSE, -p.firm_braking), p.comfortable_acceleration)


@kernel_inner
def _drive_freely(situation: Situation, station: float, speed: float) -> SpeedPlan:
    path, p = situation.path, situation.p
    first = free_acceleration(path, station, speed, p)
    s, v, risk, inside = station, speed, 0.0, 0.0
    for k in range(N_INTERVALS):
        ahead, after = moved(s, v, free_acceleration(path, s, v, p), limit_at(path, s))
        if _is_near(situation, k, s, ahead):
            clear, more_risk = _meet(situation, k, s, ahead)
            if not clear:
                return SpeedPlan(first, k, s, v, risk, inside, True, 0.0)
            risk += more_risk
        inside += INTERVAL if stops_inside(situation, v, after, ahead) else 0.0
        s, v = ahead, after
    return SpeedPlan(first, N_INTERVALS, s, v, risk, inside, True, 0.0)


@kernel_inner
def _is_near(situation: Situation, k: int, s: float, ahead: float) -> bool:
    """Return whether driving from one station to another meets a vehicle or the wall, or comes close to a vehicle."""
    reaches = situation.graph.reaches
    return ahead > situation.wall or (ahead > reaches[k, 0] and s < reaches[k, 1])


@kernel_inner
def _meet(situation: Situation, k: int, s: float, ahead: float) -> tuple[bool, float]:
    """Return whether an interval is free of contact, and the cost of coming too close to other vehicles."""
    spans, risk = situation.graph.spans, 0.0
    for i in range(situation.graph.counts[k]):
        if ahead > spans[k, i, HARD_LOW] and s < spans[k, i, HARD_HIGH]:
            return False, risk
        if ahead > spans[k, i, SOFT_LOW] and s < spans[k, i, SOFT_HIGH]:
            risk += spans[k, i, COST] * INTERVAL
    return ahead <= situation.wall, risk


@kernel_inner
def _escape(situation: Situation, station: float, speed: float) -> SpeedPlan:
    """Return the acceleration with the latest contact, for when no motion is free of contact.

    Among accelerations with equally late contact, the hardest braking is chosen.
    """
    best, latest = ACCELERATIONS[0], -1
    for a in ACCELERATIONS:
        contact = _first_contact(situation, station, speed, a)
        if contact > latest:
            best, latest = a, contact
    return SpeedPlan(best, 0, station, speed, 0.0, 0.0, False, 0.0)


@kernel_inner
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
