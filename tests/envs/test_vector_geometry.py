"""The compiled geometry of the vector environment: that of the package, and of highway-env's road network."""

import math

import numpy as np
import pytest
from highway_env.road.lane import StraightLane
from highway_env.road.road import RoadNetwork

from behavexplor.data import box_kernels
from behavexplor.data.box_kernels import boxes_touch, line_meets_box
from behavexplor.data.conventions import EGO_SIZE
from behavexplor.data.geometry import box_corners, boxes_overlap, segment_meets_box
from behavexplor.envs.engine import lane_keeping
from behavexplor.envs.engine.contact import touches_line
from behavexplor.envs.engine.lane_geometry import closest_lane, lane_coordinates, lane_heading, lane_point
from behavexplor.envs.engine.lane_network import lane_indexes, make_network
from behavexplor.envs.engine.state import NO_ROUTE, ROUTE_STEP, VEHICLE
from behavexplor.envs.functional import IntersectionLeftEnv, LaneChangeEnv
from behavexplor.envs.road_objects import road_network
from behavexplor.envs.tasks.scripted_world import make_world
from tests.kernel_calls import called_alone

boxes_touch = called_alone(boxes_touch)
closest_lane = called_alone(closest_lane)
corners_of = called_alone(box_kernels.corners)
lane_coordinates = called_alone(lane_coordinates)
lane_heading = called_alone(lane_heading)
lane_point = called_alone(lane_point)
line_meets_box = called_alone(line_meets_box)
next_lane = called_alone(lane_keeping._advance_on_route)
touches_line = called_alone(touches_line)

ENVS = [IntersectionLeftEnv, LaneChangeEnv]


def corners(x, y, heading, length, width):
    return corners_of(x, y, math.cos(heading), math.sin(heading), length, width)


def random_box(rng):
    return (*rng.uniform(-6, 6, 2), rng.uniform(-4, 4), *rng.uniform(0.5, 9, 2))


def as_array(box):
    x, y, heading, *size = box
    return box_corners(np.array([x, y]), np.array(heading), np.array(size))


def test_boxes_touch_where_geometry_says_so():
    rng = np.random.default_rng(0)
    found = set()
    for _ in range(500):
        a, b = random_box(rng), random_box(rng)
        assert pytest.approx(as_array(a), abs=1e-12) == np.array(corners(*a)).T
        touch = boxes_touch(corners(*a), corners(*b))
        assert touch == boxes_overlap(as_array(a), as_array(b))
        found.add(touch)
    assert found == {True, False}


def test_lines_meet_boxes_where_geometry_says_so():
    rng = np.random.default_rng(1)
    found = set()
    for _ in range(500):
        box, line = random_box(rng), rng.uniform(-8, 8, 4)
        meet = line_meets_box(corners(*box), *line)
        assert meet == segment_meets_box(as_array(box), line.reshape(2, 2))
        found.add(meet)
    assert found == {True, False}


@pytest.mark.parametrize("env_class", ENVS)
def test_no_illegal_line_is_overlooked(env_class):
    lines = env_class.logical.roadmap.illegal_lines
    rng = np.random.default_rng(2)
    found = set()
    for _ in range(500):
        position = lines[rng.integers(len(lines)), 0] + rng.uniform(-12, 12, 2)
        heading = rng.uniform(-4, 4)
        touched = touches_line(lines.reshape(-1, 4), *position, math.cos(heading), math.sin(heading))
        assert touched == segment_meets_box(as_array((*position, heading, *EGO_SIZE)), lines).any()
        found.add(touched)
    assert found == {True, False}


@pytest.mark.parametrize("env_class", ENVS)
def test_lanes_are_highway_env_s(env_class):
    env = env_class()
    network, world = road_network(env.logical.roadmap), make_world(env)
    rng = np.random.default_rng(3)
    low, high = (-100, 100) if env_class is IntersectionLeftEnv else ((-20, -10), (350, 25))
    for _ in range(200):
        position, heading = rng.uniform(low, high, 2), rng.uniform(-7, 7)
        closest, *_ = closest_lane(world.network, int(rng.integers(len(network._indexes))), *position, heading)
        assert network._indexes[closest] == network.get_closest_lane_index(position, heading)
        for i, lane in enumerate(network.lanes_list()):
            row = world.network.lanes[i]
            station, offset = lane_coordinates(row, *position)
            assert (station, offset) == pytest.approx(lane.local_coordinates(position), abs=1e-9)
            assert lane_heading(row, station) == pytest.approx(lane.heading_at(station))
            assert lane_point(row, station) == pytest.approx(lane.position(station, 0), abs=1e-9)


@pytest.mark.parametrize("env_class", ENVS)
def test_the_next_lane_is_highway_env_s(env_class):
    """On the route and off it, in any place, also where the map ends."""
    env = env_class()
    network, world = road_network(env.logical.roadmap), make_world(env)
    rng = np.random.default_rng(4)
    route = network.indexes(env.logical.roadmap.ego_route)
    for _ in range(500):
        lane, done = int(rng.integers(len(network._indexes))), int(rng.integers(len(route) + 1))
        end = network.lanes_list()[lane].position(network.lanes_list()[lane].length, 0)
        position = end + rng.normal(0, 4, 2)
        left = route[done:]
        expected = RoadNetwork.next_lane(network, network._indexes[lane], left, position, np.random.default_rng(0))
        vehicle = np.zeros(1, VEHICLE)[0]
        vehicle.target_lane, vehicle.route_position, vehicle.route_length = lane, done, len(route)
        station, _ = lane_coordinates(world.network.lanes[lane], *position)
        following = next_lane(world.network, vehicle, world.routes[0], station)
        assert network._indexes[following] == tuple(expected)
        assert route[vehicle.route_position :] == left


@pytest.mark.parametrize("number", range(3))
def test_of_equally_close_next_lanes_the_first_is_highway_env_s(number):
    road = RoadNetwork()
    for origin, target, y in (*(("a", "b", 4 * k) for k in range(3)), *(("b", to, y) for to in "cd" for y in (2, 6))):
        start = 0 if origin == "a" else 100
        road.add_lane(origin, target, StraightLane([start, y], [start + 100, y]))
    vehicle = np.zeros(1, VEHICLE)[0]
    vehicle.target_lane, vehicle.route_length = number, NO_ROUTE
    following = next_lane(make_network(road), vehicle, np.zeros(1, ROUTE_STEP), 100.0)
    assert lane_indexes(road)[following] == road.next_lane(("a", "b", number), None, np.array([100.0, 4.0 * number]))
