"""Which lane a careful planner wants, and how much room it asks for."""

import math

import numpy as np
import pytest

from behavexplor.ads.road.path import ego_path
from behavexplor.ads.rule.lane_choice import (
    EgoState,
    beside_lane,
    change_length,
    choose_lane,
    lane_wall,
    room_to_overtake,
)
from behavexplor.ads.rule.parameters import Parameters, numbers
from behavexplor.ads.rule.traffic import locate
from behavexplor.data.conventions import EGO_SIZE
from behavexplor.envs.logical_scenarios import crossing, straight_road
from tests.ads.rule.world import memory_with, scene
from tests.kernel_calls import called_alone

beside_lane = called_alone(beside_lane)
change_length = called_alone(change_length)
choose_lane = called_alone(choose_lane)
lane_wall = called_alone(lane_wall)
locate = called_alone(locate)
room_to_overtake = called_alone(room_to_overtake)

P = numbers(Parameters())
ROAD, LEFTMOST = straight_road(2, 2, 10, 230), straight_road(0, 0, 10, 230)
PATH = ego_path(ROAD)
WIDTH = PATH.lane_width


def ego_at(station, lane=0, speed=8.0):
    return EgoState(station, lane * WIDTH, speed, EGO_SIZE[0] / 2, EGO_SIZE[1] / 2)


def others(*cars, roadmap=ROAD):
    """The table of cars, each (station, lane, speed)."""
    rows = []
    for station, lane, speed in cars:
        x, y, heading = roadmap.ego_route.pose(station)
        offset = lane * WIDTH
        rows.append((x - offset * math.sin(heading), y + offset * math.cos(heading), heading, speed, 0.0))
    table = np.empty((len(rows), 6))
    locate(ego_path(roadmap), scene((0, 0, 0, 0), rows), table)
    return table


def chosen(table, ego, lane=0, since=100.0, path=PATH):
    memory, bits = memory_with(lane=lane, since=since), np.zeros(2, np.int64)
    wanted = choose_lane(path, table, ego, memory, bits, P)
    assert not bits.any()
    return wanted


def test_alone_it_keeps_its_routes_lane_and_comes_back_to_it():
    assert chosen(others(), ego_at(60.0)) == 0
    assert chosen(others(), ego_at(60.0, -1), lane=-1) == 0
    assert chosen(others(), ego_at(60.0, -2), lane=-2) == -1
    assert chosen(others(), ego_at(60.0, 1), lane=1) == 0


def test_it_takes_the_better_of_two_lanes_to_pass_a_slow_leader():
    slow = (85.0, 0, 2.0)
    assert chosen(others(slow, (90.0, 1, 4.0)), ego_at(60.0)) == -1
    assert chosen(others(slow, (90.0, -1, 4.0)), ego_at(60.0)) == 1
    assert chosen(others(slow, (85.0, -1, 2.0), (85.0, 1, 2.0)), ego_at(60.0)) == 0


def test_it_rests_between_changes_that_are_not_needed():
    slow = others((85.0, 0, 2.0))
    assert chosen(slow, ego_at(60.0), since=0.5 * P.lane_rest) == 0
    assert chosen(slow, ego_at(60.0), since=P.lane_rest) != 0


def test_a_fast_leader_is_not_worth_it():
    assert chosen(others((90.0, 0, 10.5)), ego_at(60.0)) == 0


def test_there_is_no_lane_beyond_the_edge():
    slow = others((85.0, 0, 2.0), roadmap=LEFTMOST)
    assert chosen(slow, ego_at(60.0), path=ego_path(LEFTMOST)) == 1


def test_when_the_room_runs_out_it_returns_even_behind_a_slow_one():
    slow_at_home = others((150.0, 0, 1.0))
    assert chosen(slow_at_home, ego_at(100.0, -1), lane=-1) == -1
    assert chosen(slow_at_home, ego_at(PATH.destination - 30.0, -1), lane=-1) == 0


def test_nobody_changes_lanes_inside_a_junction_or_into_one():
    roadmap = crossing("straight", 20, 60)
    path = ego_path(roadmap)
    for station in (path.junction_start - 10.0, path.junction_start + 10.0):
        slow = others((station + 12.0, 0, 0.5), roadmap=roadmap)
        assert chosen(slow, ego_at(station), path=path) == 0


def test_who_stands_beyond_the_destination_is_in_nobodys_way():
    before, beyond = PATH.destination - 2.0, PATH.destination + 10.0
    assert beside_lane(PATH, others((before, 0, 0.0)), ego_at(60.0), 0).ahead == 0
    assert beside_lane(PATH, others((beyond, 0, 0.0)), ego_at(60.0), 0).ahead == -1


@pytest.mark.parametrize("speed", [0.0, 3.0, 11.0])
def test_changes_are_longer_the_faster_and_have_a_least_length(speed):
    assert change_length(speed, P) == max(P.change_length, P.change_time * speed)


def test_overtaking_a_faster_one_takes_more_room_and_one_as_fast_as_the_limit_cannot_be_overtaken():
    def room(speed):
        table, ego = others((85.0, 0, speed)), ego_at(60.0)
        return room_to_overtake(PATH, table, ego, beside_lane(PATH, table, ego, 0), P)

    rooms = [room(speed) for speed in (0.0, 2.0, 4.0, 6.0, 8.0)]
    assert rooms == sorted(rooms)
    assert rooms[0] > 25.0
    assert room(PATH.speed_limit) == math.inf


def test_the_wall_leaves_room_to_come_back_but_is_never_nearer_than_braking_takes():
    assert lane_wall(PATH, ego_at(60.0), 0, P) == math.inf
    one, two = (lane_wall(PATH, ego_at(60.0, lane), lane, P) for lane in (-1, -2))
    assert one - two == pytest.approx(P.change_length)
    assert one < PATH.destination
    late = ego_at(PATH.destination - 3.0, -1, 8.0)
    assert lane_wall(PATH, late, -1, P) == pytest.approx(late.station + 64.0 / (2 * P.firm_braking) + 0.1)
