"""Options: a path with the best speed along it, and a wait before a junction that cannot be crossed."""

import math
from typing import NamedTuple

from behavexplor.ads.road.path import Path
from behavexplor.ads.rule import decision
from behavexplor.ads.rule.control import PERIOD, LateralProfile
from behavexplor.ads.rule.lane_choice import (
    EgoState,
    cuts_in,
    lane_wall,
)
from behavexplor.ads.rule.parameters import Numbers
from behavexplor.ads.rule.prediction import LaneGraph
from behavexplor.ads.rule.speed import plan_speed
from behavexplor.ads.rule.speed_motions import Situation
from behavexplor.ads.rule.speed_search import Nodes, SpeedPlan
from behavexplor.ads.rule.station_time import StationTime, project_obstacles
from behavexplor.ads.rule.traffic import Memory
from behavexplor.ads.rule.weaknesses import R1_5, note
from behavexplor.data.array_types import Floats
from behavexplor.jit import kernel_inner


class Surroundings(NamedTuple):
    """Input of one decision apart from the memory, and working space.

    Attributes:
        path: path of the ego.
        graph: lanes of the map.
        scene: scene, shape (1 + n, 8), see `behavexplor.data.scene`.
        others: working space for the table of other vehicles, see `behavexplor.ads.rule.traffic`.
        room: working space for the station-time graph.
        nodes: working space for the search of the speed.
        p: parameters of the planner.
    """

    path: Path
    graph: LaneGraph
    scene: Floats
    others: Floats
    room: StationTime
    nodes: Nodes
    p: Numbers


class Option(NamedTuple):
    """A path and a speed that the ego may choose.

    Attributes:
        profile: offset of the path from the route.
        plan: speed plan along the path.
        yields: True if the ego waits before the junction.
        crosses: True if the ego could cross the junction.
        limit: station up to which the ego may creep [m].
    """

    profile: LateralProfile
    plan: SpeedPlan
    yields: bool
    crosses: bool
    limit: float


@kernel_inner
def plan_option(world: Surroundings, ego: EgoState, profile: LateralProfile, lane: int, memory: Memory) -> Option:
    """Plan the speed along a profile, with a wait before a junction that cannot be crossed."""
    path, room, p = world.path, world.room, world.p
    blind = -math.inf
    if cuts_in(ego, p) and profile.length > 0.0:
        blind = p.cut_in * 2 * ego.half_length
        note(room.bits, R1_5, False)
    elif memory.ignores == 1.0:
        blind = 0.0
    project_obstacles(path, profile, world.graph, world.scene, ego.station, blind, p, room)
    if memory.restarted > 0.0:
        decision.shorten(room, decision.RESTART_OUTLOOK)
    wall = math.inf if memory.overrun == 1.0 else lane_wall(path, ego, lane, p)
    waits = decision.can_wait(path, ego.station, ego.speed, ego.half_length, p)
    caution = 1.0 if waits or decision.passed(path, ego.station, ego.half_length) else p.committed_caution
    last = memory.last_acceleration
    situation = Situation(path, room, ego.half_length, wall, caution, memory.cost, p)
    plan = plan_speed(situation, ego.station, ego.speed, last, world.nodes)
    memory.cost = plan.cost
    if not waits:
        return Option(profile, plan, False, True, wall)
    crosses = decision.crosses_freely(path, room, plan, ego.half_length)
    if decision.restarts_hastily(crosses, memory, room.bits, p):
        decision.shorten(room, decision.RESTART_OUTLOOK)
        plan = plan_speed(situation, ego.station, ego.speed, last, world.nodes)
        crosses = decision.crosses_freely(path, room, plan, ego.half_length)
    if crosses and decision.waits_for_ever(room, memory, room.bits, p):
        crosses = False
    clear = memory.clear + PERIOD if crosses else 0.0
    limit = min(wall, path.junction_start - ego.half_length + p.line_overrun)
    yields = not crosses or (memory.decision == decision.YIELD and clear < p.clear_time)
    if yields:
        line = min(wall, decision.waiting_station(path, ego.station, ego.speed, ego.half_length, p))
        waiting = Situation(path, room, ego.half_length, line, caution, memory.waiting_cost, p)
        wait = plan_speed(waiting, ego.station, ego.speed, last, world.nodes)
        memory.waiting_cost = wait.cost
        if wait.survived >= plan.survived:
            plan = wait
    return Option(profile, plan, yields, crosses, limit)
