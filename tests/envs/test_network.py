"""The road map in highway-env: the same lanes, and the same closest lane as highway-env finds."""

import math

import numpy as np
import pytest
from highway_env.road.lane import LineType
from highway_env.road.road import RoadNetwork

from behavexplor.data.roadmap import Route
from behavexplor.envs.functional import IntersectionStraightEnv, LaneChangeEnv
from behavexplor.envs.road_objects import road_network

LOGICAL = IntersectionStraightEnv.logical

ROADMAP = LOGICAL.roadmap
NETWORK = road_network(ROADMAP)


@pytest.mark.parametrize("route", ROADMAP.npc_routes, ids=lambda route: route.name)
def test_lanes_are_the_map_s(route):
    for lane, index in zip(route.lanes, NETWORK.indexes(route), strict=True):
        simulated = NETWORK.get_lane(index)
        assert simulated.length == pytest.approx(lane.length)
        for station in np.linspace(0, lane.length, 7):
            x, y, heading = lane.pose(station)
            assert simulated.position(station, 0.0) == pytest.approx([x, y])
            assert np.cos(simulated.heading_at(station) - heading) == pytest.approx(1)
            right = simulated.position(station, 1.0) - simulated.position(station, 0.0)
            assert right == pytest.approx([-np.sin(heading), np.cos(heading)])


@pytest.mark.parametrize("with_heading", [True, False])
def test_the_closest_lane_is_highway_envs(with_heading):
    rng = np.random.default_rng(0)
    for _ in range(500):
        position = rng.uniform(-60, 60, 2)
        heading = rng.uniform(-7, 7) if with_heading else None
        expected = RoadNetwork.get_closest_lane_index(NETWORK, position, heading)
        found = NETWORK.get_closest_lane_index(position, heading)
        if found != expected:  # lanes that begin at one place can be equally far
            lanes = NETWORK.get_lane(found), NETWORK.get_lane(expected)
            distances = [lane.distance_with_heading(position, heading) for lane in lanes]
            assert distances[0] == pytest.approx(distances[1], abs=1e-12)


def test_lanes_side_by_side_count_from_the_left():
    inner, outer = (
        NETWORK.indexes(ROADMAP.routes["west-inner-left"])[0],
        NETWORK.indexes(ROADMAP.routes["west-outer-right"])[0],
    )
    assert inner[:2] == outer[:2]
    assert (inner[2], outer[2]) == (0, 1)


def test_networks_are_shared():
    assert road_network(ROADMAP) is NETWORK


@pytest.mark.parametrize("roadmap", [ROADMAP, LaneChangeEnv.logical.roadmap], ids=["crossing", "road"])
def test_every_lane_has_its_map_s_width_limit_and_dividing_lines(roadmap):
    network = road_network(roadmap)
    assert len(network.lanes_list()) == len(roadmap.lanes)
    for lane in roadmap.lanes:
        (index,) = network.indexes(Route("one", (lane,)))
        simulated = network.get_lane(index)
        assert (simulated.width, simulated.speed_limit) == (lane.width, roadmap.speed_limit)
        beside = [other for other in roadmap.lanes if (other.origin, other.target) == (lane.origin, lane.target)]
        is_divided = not lane.junction and lane is not beside[-1]  # from the lane to its right
        assert simulated.line_types == (LineType.NONE, LineType.STRIPED if is_divided else LineType.NONE)


def test_routes_of_the_road_run_on_behind_it():
    roadmap = LaneChangeEnv.logical.roadmap
    network = road_network(roadmap)
    assert network.indexes(roadmap.routes["lane-2"]) == [("begin", "onward", 1), ("onward", "end", 1)]
    for heading, expected in ((0.0, ("begin", "onward", 0)), (math.pi, ("end-opposite", "begin-opposite", 0))):
        assert network.get_closest_lane_index(np.array([100.0, 0.0]), heading) == expected
