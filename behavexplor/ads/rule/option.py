"""Options: a path with the best speed along it, and a wait before a junction that cannot be crossed."""

import math
from typing import Final, NamedTuple

from behavexplor.ads.road.path import Path, limit_at
from behavexplor.ads.rule import decision, station_time
from behavexplor.ads.rule.control import PERIOD, LateralProfile
from behavexplor.ads.rule.lane_choice import EgoState, cuts_in, lane_wall
from behavexplor.ads.rule.memory import Memory
from behavexplor.ads.rule.parameters import Numbers
from behavexplor.ads.rule.prediction import LaneGraph
from behavexplor.ads.rule.speed_search import ACCELERATIONS, Nodes, Situation, SpeedPlan, moved, search, stops_inside
from behavexplor.ads.rule.station_time import COST, HARD_HIGH, HARD_LOW, INTERVAL, N_INTERVALS, SOFT_HIGH, SOFT_LOW
from behavexplor.ads.rule.weaknesses import R1_5, note
from behavexplor.data.array_types import Floats
from behavexplor.jit import kernel_inner

RESPONSE: Final = 0.3  # time in which the free speed is reached [s]


class Surroundings(NamedTuple):
    """Input of one decision apart from the memory, and working space."""

    path: Path  # path of the ego
    ways: LaneGraph  # lanes of the map, and the sequences of lanes along which vehicles can go on
    scene: Floats  # scene, shape (1 + n, 8), see `behavexplor.data.scene`
    others: Floats  # working space for the table of other vehicles, see `behavexplor.ads.rule.traffic`
    st_graph: station_time.StationTime  # working space for the station-time graph
    nodes: Nodes  # working space for the search of the speed
    p: Numbers  # parameters of the planner


class Option(NamedTuple):
    """A path and a speed that the ego may choose."""

    profile: LateralProfile  # offset of the path from the route
    plan: SpeedPlan  # speed plan along the path
    yields: bool  # True if the ego waits before the junction
    crosses: bool  # True if the ego could cross the junction
    limit: float  # station up to which the ego may creep [m]


@kernel_inner
def plan_option(world: Surroundings, ego: EgoState, profile: LateralProfile, lane: int, memory: Memory) -> Option:
    """Plan the speed along a profile, with a wait before a junction that cannot be crossed."""
    path, graph, p = world.path, world.st_graph, world.p
    blind = -math.inf
    if cuts_in(ego, p) and profile.length > 0.0:
        blind = p.cut_in * 2 * ego.half_length
        note(graph.bits, R1_5, False)
    elif memory.ignores == 1.0:
        blind = 0.0
    station_time.project_obstacles(path, profile, world.ways, world.scene, ego.station, blind, p, graph)
    if memory.restarted > 0.0:
        decision.shorten(graph, decision.RESTART_OUTLOOK)
    wall = math.inf if memory.overrun == 1.0 else lane_wall(path, ego, lane, p)
    can_wait = decision.can_wait(path, ego.station, ego.speed, ego.half_length, p)
    caution = 1.0 if can_wait or decision.passed(path, ego.station, ego.half_length) else p.committed_caution
    last = memory.last_acceleration
    situation = Situation(path, graph, ego.half_length, wall, caution, memory.cost, p)
    plan = plan_speed(situation, ego.station, ego.speed, last, world.nodes)
    memory.cost = plan.cost
    if not can_wait:
        return Option(profile, plan, False, True, wall)
    crosses = decision.crosses_freely(path, graph, plan, ego.half_length)
    if decision.restarts_hastily(crosses, memory, graph.bits, p):
        decision.shorten(graph, decision.RESTART_OUTLOOK)
        plan = plan_speed(situation, ego.station, ego.speed, last, world.nodes)
        crosses = decision.crosses_freely(path, graph, plan, ego.half_length)
    if crosses and decision.waits_for_ever(graph, memory, graph.bits, p):
        crosses = False
    clear = memory.clear + PERIOD if crosses else 0.0
    limit = min(wall, path.junction_start - ego.half_length + p.line_overrun)
    yields = not crosses or (memory.decision == decision.YIELD and clear < p.clear_time)
    if yields:
        line = min(wall, decision.waiting_station(path, ego.station, ego.speed, ego.half_length, p))
        waiting = Situation(path, graph, ego.half_length, line, caution, memory.waiting_cost, p)
        wait = plan_speed(waiting, ego.station, ego.speed, last, world.nodes)
        memory.waiting_cost = wait.cost
        if wait.survived >= plan.survived:
            plan = wait
    return Option(profile, plan, yields, crosses, limit)


@kernel_inner
def plan_speed(situation: Situation, station: float, speed: float, acceleration: float, nodes: Nodes) -> SpeedPlan:
    """Plan the speed along the path: drive freely if possible, else search for the best motion, else escape.

    The ego is at `station` [m] and has the `speed` [m/s]; `acceleration` is its last command [m/s2]. `nodes` are
    working space.
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
    """Return the plan of a free road, which ends at the first contact."""
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
    """Return a plan of the acceleration with the latest contact, for when no motion is free of contact.

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
