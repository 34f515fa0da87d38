"""The search of the speed against a plain one, which drives one motion after the other."""

import math

import numpy as np
import pytest

from behavexplor.ads.road.path import ego_path, limit_at
from behavexplor.ads.rule.parameters import Parameters, numbers
from behavexplor.ads.rule.speed_search import (
    ACCELERATIONS,
    CLOSE,
    FINENESS,
    HARDEST,
    N_SPEED_BINS,
    N_STATION_BINS,
    STAGES,
    STRONGEST,
    Situation,
    empty_nodes,
    search,
)
from behavexplor.ads.rule.station_time import INTERVAL, LEAD_SPEED, LEADS, N_INTERVALS, empty_station_time
from behavexplor.envs.logical_scenarios import crossing, straight_road
from tests.kernel_calls import called_alone

limit_at = called_alone(limit_at)
search = called_alone(search)

P = numbers(Parameters())
PATHS = {"road": ego_path(straight_road(2, 2, 10, 230)), "turn": ego_path(crossing("left", 10, 60))}
HALF_LENGTH = 2.35


def random_situation(path, rng):
    """A situation with a few vehicles that cross the path or drive along it, and sometimes a wall."""
    room = empty_station_time(4)
    room.reaches[:] = math.inf, -math.inf
    for _ in range(rng.integers(0, 5)):
        first, last = sorted(rng.integers(0, N_INTERVALS, 2))
        low, length, speed, leads = rng.uniform(0, 120), rng.uniform(5, 25), rng.uniform(0, 8), rng.integers(0, 2)
        for k in range(first, last + 1):
            begin, around = low + speed * k * INTERVAL, rng.uniform(0, 4)
            cost = P.following_cost if leads else P.crossing_cost
            row = begin, begin + length, begin - around, begin + length + around, cost, float(leads), speed
            room.spans[k, room.counts[k]] = row
            room.counts[k] += 1
            room.reaches[k] = min(room.reaches[k, 0], row[2]), max(room.reaches[k, 1], row[3])
    wall = rng.choice([math.inf, rng.uniform(30, 150)])
    return Situation(path, room, HALF_LENGTH, wall, rng.choice([1.0, 0.3]), 0.0, P)


def driven(world, s, v, a, first, intervals):
    """Station, speed, cost, risk and time inside the junction after a motion; None if it ends in contact."""
    path, graph = world.path, world.graph
    inside_from, inside_until = path.junction_start - world.half_length, path.junction_end + world.half_length
    cost = risk = inside = 0.0
    for k in range(first, first + intervals):
        limit = limit_at(path, s)
        after = min(max(v + a * INTERVAL, 0.0), max(limit, v))
        ahead = s + 0.5 * (v + after) * INTERVAL
        if ahead > world.wall:
            return None
        for low, high, soft_low, soft_high, rate, *_ in graph.spans[k, : graph.counts[k]]:
            if ahead > low and s < high:
                return None
            if ahead > soft_low and s < soft_high:
                cost += world.caution * rate * INTERVAL
                risk += rate * INTERVAL
        achieved = (after - v) / INTERVAL
        effort = P.acceleration_cost if 0 < achieved <= P.comfortable_acceleration else P.braking_cost
        cost += (P.delay_cost * (1.5 - k / N_INTERVALS) * (limit - after) + effort * achieved * achieved) * INTERVAL
        if after > limit:
            cost += P.overspeed_cost * (after - limit) * INTERVAL
        if achieved <= 0 and after < P.slow_speed and inside_from < ahead < inside_until:
            cost += P.keep_clear_cost * INTERVAL
            inside += INTERVAL
        s, v = ahead, after
    return s, v, cost, risk, inside


def braking_cost(closing, room):
    needed = closing * closing / (2 * max(room, P.bumper_gap))
    return P.braking_cost * needed * closing if closing > 0 else 0.0


def debt(world, s, v):
    rows = world.graph.spans[-1, : world.graph.counts[-1]]
    leaders = [braking_cost(v - row[LEAD_SPEED], row[0] - s) for row in rows if row[LEADS] == 1]
    return max([braking_cost(v, world.wall - s), *leaders])


def plain_search(world, station, speed, acceleration):
    """Acceleration, survived intervals, station, speed, risk and time inside of the cheapest plan."""
    nodes, survived = [(station, speed, acceleration, 0.0, 0.0, 0.0, 0.0)], 0
    for stage, intervals in enumerate(STAGES):
        following = {}
        for s, v, last, first, spent, risk, inside in nodes:
            for a in ACCELERATIONS[HARDEST[stage] : STRONGEST[stage] + 1]:
                motion = None if v == 0 and a < 0 else driven(world, s, v, a, survived, intervals)
                if motion is None:
                    continue
                end, speed_then, cost, more_risk, more_inside = motion
                total = spent + cost + P.jerk_cost * (a - last) * (a - last)
                row = min(int(FINENESS * math.sqrt(end - station)), N_STATION_BINS - 1)
                column = min(math.ceil(FINENESS * math.sqrt(speed_then)), N_SPEED_BINS - 1)
                if (row, column) not in following or total < following[row, column][4]:
                    begun = a if stage == 0 else first
                    node = end, speed_then, a, begun, total, risk + more_risk, inside + more_inside
                    following[row, column] = node
        if not following:
            break
        nodes, survived = list(following.values()), survived + intervals
    is_whole = survived == N_INTERVALS
    s, v, _, first, _, risk, inside = min(nodes, key=lambda n: n[4] + (debt(world, n[0], n[1]) if is_whole else 0.0))
    return first, survived, s, v, risk, inside


@pytest.mark.parametrize("path", PATHS)
def test_it_finds_the_plan_of_a_plain_search_bit_by_bit(path):
    rng, space, lengths = np.random.default_rng(0), empty_nodes(), set()
    for _ in range(25):
        world = random_situation(PATHS[path], rng)
        station, speed, last = rng.uniform(20, 110), rng.choice([0.0, rng.uniform(0, 11), 14.0]), rng.uniform(-3, 2)
        plan = search(world, station, speed, last, space)
        assert tuple(plan)[:-2] == plain_search(world, station, speed, last)
        lengths.add(plan.survived)
    assert len(lengths) > 1
    assert N_INTERVALS in lengths


@pytest.mark.parametrize("overspeed_cost", [P.overspeed_cost, 0.1])  # with the second one, haste lowers the cost
@pytest.mark.parametrize("path", PATHS)
def test_an_expected_cost_does_not_change_the_plan(path, overspeed_cost):
    rng, space = np.random.default_rng(1), empty_nodes()
    for _ in range(300):
        world = random_situation(PATHS[path], rng)
        world = world._replace(p=world.p._replace(overspeed_cost=overspeed_cost))
        speed, last = rng.choice([0.0, 2.0, 14.0, rng.uniform(0, 11)]), rng.choice([0.0, 1.0, rng.uniform(-3, 2)])
        station = rng.uniform(20, 110)
        plan = search(world, station, speed, last, space)
        expected = plan.cost * rng.choice([rng.uniform(0.4, 1.5), 1 / CLOSE])
        assert search(world._replace(expected=expected), station, speed, last, space) == plan
