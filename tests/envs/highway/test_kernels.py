"""Kernels of the engine, one by one, against highway-env's functions."""

import math

import numpy as np
import pytest
from highway_env.road.lane import CircularLane, SineLane, StraightLane
from highway_env.road.road import RoadNetwork
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from behavexplor.envs.engine.lane_geometry import (
    SLACK,
    closest_lane,
    is_after_end,
    is_farther,
    is_on_lane,
    is_on_road,
    is_reachable,
    may_be_on_lane,
    note_places,
)
from behavexplor.envs.engine.lane_network import ALL_NEAR, NEAR_LIMIT, lane_indexes, make_network
from behavexplor.envs.engine.reactive_traffic import UNKNOWN, neighbors
from behavexplor.envs.engine.state import VEHICLE, Scene, make_scratch, make_slots
from behavexplor.envs.highway.conversion import load_state
from behavexplor.envs.tasks.intersection import clear_vehicles
from behavexplor.envs.tasks.reward_terms import plus
from behavexplor.envs.tasks.task import INTEGER, kind_of_number
from behavexplor.jit import kernel_in_place
from tests.envs.highway.comparison import N_PLACES, N_STEPS, make, world_of


@kernel_in_place
def closest(network, likely, x, y, heading):
    return closest_lane(network, likely, x, y, heading)[0]


@kernel_in_place
def closest_of_many(network, likely, points, found):
    for k in range(len(points)):
        lane, station, offset = closest_lane(network, likely[k], points[k, 0], points[k, 1], points[k, 2])
        found[k, 0], found[k, 1], found[k, 2] = lane, station, offset


@kernel_in_place
def bounds(network, x, y, limit, margin):
    return is_farther(network.lanes[0], x, y, limit), may_be_on_lane(network.lanes[0], x, y, margin)


@kernel_in_place
def judged(network, vehicle, station, offset):
    lane = network.lanes[0]
    is_on = is_on_lane(lane, station, offset, 1.0), is_on_road(network, vehicle)
    return *is_on, is_reachable(lane, vehicle.x, vehicle.y), is_after_end(lane, station)


@kernel_in_place
def neighbors_of(network, slots, scratch, i, lane, station):
    scene = Scene(slots.episodes[0], slots.vehicles[0], slots.traits[0], slots.routes[0], scratch)
    note_places(network, scene)
    return neighbors(network, scene, i, lane, station)


@kernel_in_place
def added(items, kinds):
    total, lost, kind = 0.0, 0.0, INTEGER
    for k in range(len(items)):
        total, lost, kind = plus(total, lost, kind, items[k], kinds[k])
    return total + lost


@kernel_in_place
def clear(network, slots, scratch):
    scene = Scene(slots.episodes[0], slots.vehicles[0], slots.traits[0], slots.routes[0], scratch)
    clear_vehicles(network, scene)


@pytest.mark.parametrize("env_id", ["merge", "roundabout", "two-way", "intersection", "exit", "u-turn", "highway"])
def test_the_closest_lane_is_highway_env_s_wherever_the_search_begins(env_id):
    env, rng = make(f"{env_id}-v0"), np.random.default_rng(0)
    network, indexes = world_of(env).network, lane_indexes(env.road.network)
    found = set()
    for _ in range(300):
        lane = env.road.network.get_lane(indexes[rng.integers(len(indexes))])
        position = lane.position(rng.uniform(-20, lane.length + 20), rng.normal(0, rng.choice([1, 6])))
        heading = rng.uniform(-4, 4)
        ours = {closest(network, likely, *position, heading) for likely in range(0, len(indexes), 3)}
        assert len(ours) == 1
        index = indexes[ours.pop()]
        distances = [
            env.road.network.get_lane(i).distance_with_heading(position, heading)
            for i in (index, env.road.network.get_closest_lane_index(position, heading))
        ]
        assert distances[0] == pytest.approx(distances[1], abs=1e-9)
        found.add(index)
    assert len(found) > len(indexes) / 2 - 1


@pytest.mark.parametrize(
    "env_id",
    ["merge", "merge-generic", "roundabout", "two-way", "intersection", "exit", "u-turn", "highway", "racetrack"],
)
def test_lanes_that_are_not_near_the_likely_one_are_never_the_closest(env_id):
    env, rng, count = make(f"{env_id}-v0"), np.random.default_rng(0), 30_000
    network, lanes = world_of(env).network, list(env.road.network.lanes_dict().values())
    likely = rng.integers(len(lanes), size=count)
    near = rng.integers(len(lanes), size=(count, 2))  # the place is on the likely lane, or on another one
    points = np.empty((count, 3))
    for k, (own, other) in enumerate(near):
        lane = lanes[likely[k] if own % 2 else other]
        station = rng.uniform(-5, lane.length + 5) if own % 3 else rng.choice([0.0, lane.length]) + rng.normal(0, 3)
        points[k] = *lane.position(station, rng.normal(0, 2)), rng.uniform(-4, 4)
    every = network.lanes.copy()
    every["near"] = ALL_NEAR
    found, expected = np.empty((2, count, 3))
    closest_of_many(network, likely, points, found)
    closest_of_many(network._replace(lanes=every), likely, points, expected)
    assert np.array_equal(found, expected)
    own = 1 << np.arange(len(lanes))
    assert not (network.lanes["near"] & own).any()
    assert (network.lanes["near"] < 1 << len(lanes)).all()


phases = st.floats(-7, 7)
circles = st.builds(CircularLane, st.just([3.0, -2.0]), st.floats(1, 100), phases, phases, st.booleans())
sines = st.builds(
    lambda end, *wave: SineLane([0.0, 0.0], end, *wave),
    st.sampled_from([[80.0, 0.0], [-30.0, 60.0]]),
    st.floats(-5, 5),
    st.floats(0.01, 0.3),
    phases,
)


@settings(max_examples=300)
@given(st.one_of(circles, sines), st.floats(-150, 150), st.floats(-8, 8))
def test_bounds_leave_out_no_lane_that_is_near(lane, station, offset):
    road = RoadNetwork()
    road.add_lane("a", "b", lane)
    network, position = make_network(road), lane.position(station, offset)
    distance = lane.distance(position)
    is_out_of_reach, may_be_on = bounds(network, *position, distance, 1.0)
    assert not is_out_of_reach
    on_lane = lane.on_lane(position, margin=1.0)
    assert may_be_on or not on_lane
    if isinstance(lane, CircularLane) and 0 < lane.length < math.pi * lane.radius:
        assert bounds(network, *position, -SLACK, 1.0)[0] or distance < 1e-6


def random_lane(rng):
    start, phase = rng.uniform(-60, 60, 2), rng.uniform(-4, 4)
    if rng.random() < 0.5:
        return CircularLane(start, rng.uniform(5, 50), phase, phase + rng.uniform(-4, 4), rng.random() < 0.5)
    return SineLane(start, start + rng.normal(0, 60, 2), rng.uniform(-8, 8), rng.uniform(0.01, 0.1), phase)


def test_lanes_that_are_not_near_are_as_far_apart_as_is_promised():
    """A point within `NEAR_LIMIT` of one is farther from the other, and by more than any difference of headings."""
    rng, reach, n_apart = np.random.default_rng(0), 2 * NEAR_LIMIT + math.pi, 0
    for _ in range(10):
        road, lanes = RoadNetwork(), [random_lane(rng) for _ in range(20)]
        for lane in lanes:
            road.add_lane("a", "b", lane)
        near = make_network(road).lanes["near"]
        lines = [[lane.position(station, 0) for station in np.linspace(0, lane.length, 200)] for lane in lanes]
        for i, line in enumerate(lines):
            others = [points for j, points in enumerate(lines) if j != i and not near[i] >> j & 1]
            gaps, _ = cKDTree(line).query(np.concatenate(others), distance_upper_bound=reach - 1e-3)
            assert np.isinf(gaps).all()  # farther than the bound
            n_apart += len(others)
    assert n_apart > 1000


@pytest.mark.parametrize("forbidden", [False, True])
def test_the_edges_of_a_lane_are_highway_env_s(forbidden):
    lane, road, vehicle = StraightLane([0, 0], [100, 0], forbidden=forbidden), RoadNetwork(), np.zeros(1, VEHICLE)[0]
    road.add_lane("a", "b", lane)
    network, around = make_network(road), [-0.05, 0.0, 0.05]
    for station in np.add.outer([-5.0, 0.0, 97.5, 100.0, 105.0], around).ravel():
        for offset in np.add.outer([-8.0, -3.0, -2.0, 0.0, 2.0, 3.0, 8.0], around).ravel():
            vehicle.x, vehicle.y = position = np.array([station, offset])
            is_on = lane.on_lane(position, margin=1), lane.on_lane(position)
            expected = *is_on, lane.is_reachable_from(position), lane.after_end(position)
            assert judged(network, vehicle, station, offset) == expected


def test_of_equally_close_lanes_the_first_is_chosen():
    env = make("two-way-v0")
    network = world_of(env).network
    assert lane_indexes(env.road.network)[2] == ("b", "a", 0)
    assert closest(network, 2, 100.0, 0.0, np.pi / 2) == 0  # as far from the direction of either lane


@pytest.mark.parametrize("connected", [False, True])
@pytest.mark.parametrize("env_id", ["merge-v0", "roundabout-v0"])
def test_neighbors_are_highway_env_s(env_id, connected):
    env, rng = make(env_id, {"neighbour_vehicles_connected_lanes": connected}), np.random.default_rng(1)
    world, slots = world_of(env), make_slots(1, N_PLACES, N_STEPS)
    indexes = lane_indexes(env.road.network)
    scratch = make_scratch(len(indexes), N_PLACES)
    some = 0
    for _ in range(20):
        for vehicle in env.road.vehicles:
            lane = env.road.network.get_lane(indexes[rng.integers(len(indexes))])
            station, offset = rng.uniform(0, lane.length), rng.normal(0, 1)
            if env_id == "merge-v0" and rng.random() < 0.5:  # straight lanes, on which vehicles are equally far
                station, offset = 40.0, 0.0
            vehicle.position = lane.position(station, offset)
            vehicle.on_state_update()
        load_state(env, world, slots, 0)
        scratch.n_on_lane[:] = UNKNOWN
        things = [*env.road.vehicles, *env.road.objects]
        for i, vehicle in enumerate(env.road.vehicles):
            for lane, index in enumerate(indexes):
                station = env.road.network.get_lane(index).local_coordinates(vehicle.position)[0]
                ours = neighbors_of(world.network, slots, scratch, i, lane, station)
                theirs = env.road.neighbour_vehicles(vehicle, index)
                assert ours == tuple(-1 if other is None else things.index(other) for other in theirs)
                some += theirs != (None, None)
    assert some > 50


def test_the_ego_and_the_rest_keep_their_order_when_vehicles_leave():
    env = make("intersection-v0")
    env.reset(seed=4)
    world, slots = world_of(env), make_slots(1, N_PLACES, N_STEPS)
    leaving = env.road.network.get_lane(("il2", "o2", 0))
    for vehicle in (env.road.vehicles[0], env.road.vehicles[2]):
        vehicle.position = leaving.position(leaving.length - 10, 0)
        vehicle.heading = leaving.heading
        vehicle.on_state_update()
    env.road.vehicles[1].route = None
    load_state(env, world, slots, 0)
    clear(world.network, slots, make_scratch(len(world.network.lanes), N_PLACES))
    expected = make_slots(1, N_PLACES, N_STEPS)
    env._clear_vehicles()
    load_state(env, world, expected, 0)
    n = len(env.road.vehicles)
    assert n == slots.episodes[0].n_vehicles
    assert slots.vehicles[0, :n]["number"].tolist() == [3, *range(4, n + 3)]
    expected.vehicles[0, :n]["number"] += 3
    expected.episodes[0].n_numbered += 3
    assert slots.episodes[0] == expected.episodes[0]
    for ours, theirs in ((slots.vehicles, expected.vehicles), (slots.traits, expected.traits)):
        assert ours[0, :n].tolist() == theirs[0, :n].tolist()
    for i in range(n):
        length = max(slots.vehicles[0, i].route_length, 0)
        assert slots.routes[0, i, :length].tolist() == expected.routes[0, i, :length].tolist()


NUMBERS = st.floats(-1e3, 1e3) | st.integers(-9, 9) | st.floats(-1e3, 1e3).map(np.float64)


@given(st.lists(NUMBERS, max_size=8))
@example([0, 0.1, 0.15, -0.05, -0.05])
@example([-1.0, 0.1, np.float64(0.7), 0.2, 0.3])
def test_numbers_are_added_as_this_python_adds_them(items):
    kinds = [kind_of_number(item) for item in items]
    assert added(np.array(items, dtype=np.float64), np.array(kinds, dtype=np.int64)) == sum(items)
