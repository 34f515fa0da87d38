"""The best speed along a path among others, which are given as spans of its stations over time."""

import math

import numpy as np
import pytest

from behavexplor.ads.road.path import ego_path
from behavexplor.ads.rule.option import free_acceleration, plan_speed
from behavexplor.ads.rule.parameters import Parameters, numbers
from behavexplor.ads.rule.speed_search import ACCELERATIONS, Situation, empty_nodes
from behavexplor.ads.rule.station_time import INTERVAL, N_INTERVALS, empty_station_time
from behavexplor.envs.logical_scenarios import crossing, straight_road
from tests.kernel_calls import called_alone

free_acceleration = called_alone(free_acceleration)
plan_speed = called_alone(plan_speed)

NUMBERS = numbers(Parameters())
ROAD = ego_path(straight_road(2, 2, 10, 230))
TURN = ego_path(crossing("left", 10, 60))
HALF_LENGTH = 2.35
CROSSES, LEADS = (NUMBERS.crossing_cost, 0.0), (NUMBERS.following_cost, 1.0)


def situation(*spans, wall=math.inf, path=ROAD):
    """Spans are (first interval, last interval, low, high, kind, speed): nearer than 2 m to them is too close."""
    room = empty_station_time(max(len(spans), 1))
    room.reaches[:] = math.inf, -math.inf
    for first, last, low, high, (cost, leads), speed in spans:
        for k in range(first, last + 1):
            moved = speed * k * INTERVAL
            span = low + moved, high + moved, low + moved - 2.0, high + moved + 2.0, cost, leads, speed
            room.spans[k, room.counts[k]] = span
            room.counts[k] += 1
            room.reaches[k] = min(room.reaches[k, 0], span[2]), max(room.reaches[k, 1], span[3])
    return Situation(path, room, HALF_LENGTH, wall, 1.0, 0.0, NUMBERS)


def plan(world, station, speed, acceleration=0.0):
    return plan_speed(world, station, speed, acceleration, empty_nodes())


def drive(world_at, station, speed, steps=300):
    """Stations and speeds of an ego that does at once what each new plan says, ten times a second."""
    driven, acceleration = [], 0.0
    for step in range(steps):
        acceleration = plan(world_at(step / 10), station, speed, acceleration).acceleration
        after = max(speed + acceleration / 10, 0.0)
        station, speed = station + (speed + after) / 20, after
        driven.append((station, speed))
    return np.array(driven)


@pytest.mark.parametrize(("path", "station"), [(ROAD, 20.0), (TURN, 20.0), (TURN, 80.0)], ids=["road", "way", "turn"])
@pytest.mark.parametrize("speed", [0.0, 5.0, 11.0])
def test_on_a_free_road_it_drives_towards_the_limit(path, station, speed):
    found = plan(situation(path=path), station, speed)
    assert found.free
    assert found.survived == N_INTERVALS
    assert found.acceleration == free_acceleration(path, station, speed, NUMBERS)
    assert 6.0 < found.speed <= path.limits[int(found.station)] + 0.3


def test_it_stops_before_one_who_stands_and_before_a_wall_and_does_not_give_up_room_for_ever():
    for world, line in ((situation((0, N_INTERVALS - 1, 80.0, 90.0, LEADS, 0.0)), 80.0), (situation(wall=80.0), 80.0)):
        driven = drive(lambda _, world=world: world, 30.0, 10.0)
        assert driven[-1, 1] < 0.05
        assert line - 6.0 < driven[-1, 0] <= line
        assert np.diff(driven[:, 1]).min() > -0.6  # 6 m/s2: it need not brake fully


def test_it_follows_a_leader_at_the_leaders_speed():
    def world(time):
        return situation((0, N_INTERVALS - 1, 60.0 + 4.0 * time, 70.0 + 4.0 * time, LEADS, 4.0))

    driven = drive(world, 30.0, 10.0)
    assert driven[-50:, 1] == pytest.approx(4.0, abs=0.5)
    assert 1.0 < 60.0 + 4.0 * 30.0 - driven[-1, 0] < 15.0


@pytest.mark.parametrize(("first", "last", "before"), [(0, 12, False), (16, 31, True)])
def test_it_goes_behind_those_who_cross_soon_and_before_those_who_cross_late(first, last, before):
    found = plan(situation((first, last, 45.0, 51.0, CROSSES, 0.0)), 30.0, 8.0)
    assert found.survived == N_INTERVALS
    assert found.risk == 0.0
    assert found.station > 51.0
    assert (found.acceleration >= 0.0) == before


def test_where_contact_cannot_be_ruled_out_it_is_put_off():
    blocked = plan(situation((0, N_INTERVALS - 1, 32.0, 60.0, CROSSES, 0.0)), 30.0, 10.0)
    assert (blocked.survived, blocked.acceleration) == (0, ACCELERATIONS[0])
    from_behind = situation((0, 1, -50.0, 30.5, CROSSES, 0.0), (2, 31, -50.0, 33.5, CROSSES, 0.0))
    pushed = plan(from_behind, 30.1, 5.0)
    assert (pushed.survived, pushed.acceleration) == (0, ACCELERATIONS[-1])


def test_who_cannot_be_touched_makes_no_difference():
    rng = np.random.default_rng(1)
    for _ in range(30):
        lead = (0, 31, rng.uniform(50.0, 80.0), 90.0, LEADS, 1.0)
        behind = (0, 31, -60.0, rng.uniform(-20.0, 10.0), CROSSES, 0.0)
        speed = rng.uniform(0.0, 11.0)
        assert plan(situation(lead, behind), 30.0, speed) == plan(situation(lead), 30.0, speed)
