import math

import numpy as np
import pytest

from behavexplor.ads.road.path import ego_path
from behavexplor.ads.rule.traffic import ALONG_SPEED, NO_VEHICLE, OFFSET, STATION, TURNED, locate, neighbors
from behavexplor.data.conventions import EGO_SIZE
from behavexplor.envs.logical_scenarios import crossing, straight_road
from tests.ads.rule.world import SEDAN, scene
from tests.kernel_calls import called_alone

locate = called_alone(locate)
neighbors = called_alone(neighbors)

ROAD = straight_road(2, 2, 10, 230)
LEFT = crossing("left", 10, 60)
HALF = EGO_SIZE[0] / 2, EGO_SIZE[1] / 2


def table(roadmap, npcs):
    others = np.empty((len(npcs), 6))
    locate(ego_path(roadmap), scene((*roadmap.start_pose, 5.0), npcs), others)
    return others


def on_road(station, lane, speed=5.0, turned=0.0):
    return (station, 8.75 + 3.5 * lane, turned, speed, 0.0)


def test_vehicles_are_located_along_the_route_also_in_its_curve():
    station = float(LEFT.ego_route.bounds[1]) + 10.0
    x, y, heading = LEFT.ego_route.pose(station)
    others = table(LEFT, [(x, y, heading + 0.3, 4.0, 0.0)])
    assert others[0, [STATION, OFFSET, TURNED]] == pytest.approx((station, 0.0, 0.3), abs=1e-9)
    assert others[0, ALONG_SPEED] == pytest.approx(4 * math.cos(0.3))


def test_the_next_ones_in_each_lane_are_found_with_the_gaps_between_bumpers():
    npcs = [on_road(80, 0, 3.0), on_road(60, 0, 4.0), on_road(20, 0, 9.0), on_road(55, 1, 6.0)]
    others = table(ROAD, npcs)
    own = neighbors(others, 40.0, 0.0, *HALF)
    assert (own.ahead, own.speed_ahead, own.behind, own.speed_behind) == (1, 4.0, 2, 9.0)
    assert (own.gap_ahead, own.gap_behind) == pytest.approx((20 - (EGO_SIZE[0] + SEDAN[0]) / 2,) * 2)
    right = neighbors(others, 40.0, 3.5, *HALF)
    assert (right.ahead, right.behind, right.gap_behind) == (3, NO_VEHICLE, math.inf)


def test_who_drives_alongside_has_a_negative_gap_and_who_crosses_is_in_no_lane():
    others = table(ROAD, [on_road(41, 1), on_road(50, 0, turned=1.5)])
    assert neighbors(others, 40.0, 3.5, *HALF).gap_ahead < 0
    assert neighbors(others, 40.0, 0.0, *HALF).ahead == NO_VEHICLE


def test_a_vehicle_between_two_lanes_is_in_both():
    others = table(ROAD, [on_road(60, 0.5)])
    assert [neighbors(others, 40.0, offset, *HALF).ahead for offset in (-3.5, 0.0, 3.5)] == [NO_VEHICLE, 0, 0]


def test_absent_vehicles_are_nowhere():
    observation = scene((*ROAD.start_pose, 5.0), [on_road(60, 0)])
    observation[1, 0] = 0.0
    others = np.empty((1, 6))
    locate(ego_path(ROAD), observation, others)
    assert neighbors(others, 40.0, 0.0, *HALF).ahead == NO_VEHICLE
