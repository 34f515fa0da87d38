"""The kernels of the vector environment, one by one, against shapely, highway-env and the single environment."""

import math

import numpy as np
import pytest
from highway_env.road.road import Road
from highway_env.vehicle.controller import MDPVehicle
from highway_env.vehicle.kinematics import Vehicle
from hypothesis import given
from hypothesis import strategies as st
from shapely import LineString, Point, Polygon

from behavexplor.data.conventions import MANEUVERS
from behavexplor.data.npc_motion import motion_table
from behavexplor.data.scripted import ScriptedScenario
from behavexplor.data.trace import ENDS
from behavexplor.data.vehicle_sizes import EGO_SIZE, VEHICLE_SIZES
from behavexplor.envs.functional.intersection_left import IntersectionLeftEnv
from behavexplor.envs.functional.intersection_straight import IntersectionStraightEnv
from behavexplor.envs.functional.lane_change import LaneChangeEnv
from behavexplor.envs.network import road_network
from behavexplor.envs.reward import WEIGHTS
from behavexplor.envs.reward import reward_terms as terms_of_one
from behavexplor.envs.vector import meta, slots, step
from behavexplor.envs.vector.contact import boxes_touch, corners, line_distance, line_meets_box, touches_line
from behavexplor.envs.vector.rewards import TERMS, reward_terms
from behavexplor.envs.vector.slots import (
    END,
    LINE_FRAME,
    N_NPCS,
    RUNNING,
    begin_episodes,
    make_slots,
    move_npcs,
    npc_arrays,
)
from behavexplor.envs.vector.world import make_world
from behavexplor.envs.vehicles import MetaEgoVehicle, place_ego
from tests.kernel_calls import called_alone

boxes_touch = called_alone(boxes_touch)
corners = called_alone(corners)
line_distance = called_alone(line_distance)
line_meets_box = called_alone(line_meets_box)
move_npcs = called_alone(move_npcs)
touches_line = called_alone(touches_line)
changed_lane = called_alone(meta.changed_lane)
changed_speed = called_alone(meta.changed_speed)
follow_road = called_alone(meta.follow_road)
nearest_speed = called_alone(meta.nearest_speed)
steering = called_alone(meta.steering)
throttle = called_alone(meta.throttle)
find_end = called_alone(step._find_end)
station = called_alone(step._station)
within_speeds = called_alone(step._within_speeds)

LEFT, CHANGE = IntersectionLeftEnv(), LaneChangeEnv()
WORLDS = {env: make_world(env) for env in (LEFT, CHANGE)}
CLEAR = 1e-6  # distances below that are not judged: rounding decides there [m]

places = st.integers(-1200, 1200).map(lambda n: n / 100)  # shapely takes tinier lines for points at infinity
boxes = st.tuples(places, places, st.floats(-7, 7), st.floats(0.5, 10), st.floats(0.5, 4))
segments = st.tuples(places, places, places, places)


def polygon(box):
    return Polygon(np.array(corners(*box)).T)


@given(boxes, boxes)
def test_boxes_touch_where_shapely_says_so(a, b):
    gap, overlap = polygon(a).distance(polygon(b)), polygon(a).intersection(polygon(b)).area
    if gap > CLEAR or overlap > CLEAR:
        assert boxes_touch(corners(*a), corners(*b)) == (gap == 0)


@given(boxes)
def test_corners_are_a_box_of_its_size_round_its_center(box):
    x, y, _, length, width = box
    shape = polygon(box)
    assert shape.area == pytest.approx(length * width)
    assert (shape.centroid.x, shape.centroid.y) == pytest.approx((x, y), abs=1e-6)
    assert boxes_touch(corners(*box), corners(*box))


@given(boxes, segments)
def test_lines_meet_boxes_where_shapely_says_so(box, line):
    segment = LineString([line[:2], line[2:]])
    gap, inside = polygon(box).distance(segment), polygon(box).intersection(segment).length
    if gap > CLEAR or inside > CLEAR:
        assert line_meets_box(corners(*box), *line) == (gap == 0)


@given(places, places, segments)
def test_the_distance_from_a_line_is_shapely_s(x, y, line):
    assert line_distance(x, y, *line) == pytest.approx(Point(x, y).distance(LineString([line[:2], line[2:]])), abs=1e-9)


def test_the_distance_from_a_point_like_line():
    assert line_distance(3.0, 4.0, 0.0, 0.0, 0.0, 0.0) == 5.0


@given(st.integers(0, 10**6), st.floats(-6, 6), st.floats(-6, 6), st.floats(-4, 4))
def test_illegal_lines_are_touched_where_shapely_says_so(which, dx, dy, heading):
    lines = WORLDS[LEFT].illegal_lines
    x, y = lines[which % len(lines), :2] + (dx, dy)
    box = polygon((x, y, heading, *EGO_SIZE))
    gaps = [box.distance(LineString([line[:2], line[2:]])) for line in lines]
    if min(gaps) == 0 or min(gaps) > CLEAR:
        assert touches_line(lines, x, y, heading) == (min(gaps) == 0)


def meta_ego(env, rng):
    """highway-env's vehicle for meta-actions, anywhere near its road, on its way to any lane."""
    network = road_network(env.logical.roadmap)
    lanes = network.lanes_list()
    target = int(rng.integers(len(lanes)))
    lane = lanes[target]
    position = lane.position(rng.uniform(-5, lane.length + 8), rng.normal(0, 3))
    road = Road(network, np_random=np.random.default_rng(0))
    vehicle = MetaEgoVehicle(
        road, position, lane.heading_at(0) + rng.normal(0, 0.6), rng.choice([0.0, 0.005, -3.0, 0.6, 9.0])
    )
    vehicle.LENGTH = EGO_SIZE[0]
    vehicle.target_lane_index = network._indexes[target]
    vehicle.target_speeds = np.array([0.0, 4.5, 9.0])
    vehicle.speed_index, vehicle.target_speed = 1, 4.5
    return vehicle, target


@pytest.mark.parametrize("env", [LEFT, CHANGE], ids=["left", "change"])
def test_maneuvers_are_highway_env_s(env):
    """Target speed, target lane, throttle and steering after each maneuver, to the last bit."""
    rng = np.random.default_rng(0)
    network, speeds = WORLDS[env].network, np.array([0.0, 4.5, 9.0])
    route = road_network(env.logical.roadmap).indexes(env.logical.roadmap.ego_route)
    changed = set()
    for _ in range(300):
        vehicle, target = meta_ego(env, rng)
        maneuver, done = int(rng.integers(5)), int(rng.integers(len(route) + 1))
        vehicle.route = route[done:]
        x, y = vehicle.position
        index = changed_speed(speeds, 1, maneuver, vehicle.speed)
        lane, _ = follow_road(network, done, target, x, y)
        lane = changed_lane(network, lane, maneuver, x, y)
        vehicle.act(MANEUVERS[maneuver])
        assert index == vehicle.speed_index
        assert road_network(env.logical.roadmap)._indexes[lane] == tuple(vehicle.target_lane_index)
        assert throttle(speeds[index], vehicle.speed) == vehicle.action["acceleration"]
        steered = steering(network.lanes, lane, x, y, vehicle.heading, vehicle.speed)
        assert steered == vehicle.action["steering"]
        changed.add((maneuver, lane != target))
    assert {(meta.LANE_LEFT, True), (meta.LANE_RIGHT, True), (meta.IDLE, False)} <= changed


@given(st.floats(-50, 50), st.lists(st.floats(0.5, 5), min_size=1, max_size=1), st.integers(2, 6))
def test_the_nearest_target_speed_is_highway_env_s(speed, steps, count):
    speeds = 1.0 + steps[0] * np.arange(count)
    vehicle = MDPVehicle(None, [0, 0], target_speeds=speeds)
    assert nearest_speed(speeds, speed) == vehicle.speed_to_index(speed)


@given(st.floats(-60, 60), st.floats(-10, 10))
def test_speeds_are_kept_within_limits_as_highway_env_does(speed, acceleration):
    vehicle = Vehicle(None, [0, 0], speed=speed)
    vehicle.act({"steering": 0.0, "acceleration": acceleration})
    vehicle.clip_actions()
    assert within_speeds(WORLDS[LEFT].rules, speed, acceleration) == vehicle.action["acceleration"]


@pytest.mark.parametrize("env", [LEFT, CHANGE], ids=["left", "change"])
def test_stations_on_the_route_are_the_map_s(env):
    rng = np.random.default_rng(1)
    route = env.logical.roadmap.ego_route
    for _ in range(300):
        x, y = route.pose(rng.uniform(-20, route.length + 20))[:2] + rng.normal(0, 5, 2)
        assert station(WORLDS[env].ego_lanes, x, y) == pytest.approx(route.project(x, y)[0], abs=1e-9)


@pytest.mark.parametrize(
    ("frame", "standing", "ahead", "aside", "expected"),
    [
        (10, 0, -30.0, 0.0, None),
        (10, 599, -30.0, 0.0, None),
        (10, 600, -30.0, 0.0, "standstill"),
        (3999, 0, -30.0, 0.0, None),
        (4000, 0, -30.0, 0.0, "timeout"),
        (4000, 600, -30.0, 0.0, "standstill"),
        (4000, 600, -0.9, 0.0, "arrived"),
        (10, 0, 0.0, 1.01, None),
        (10, 0, 4.9, 0.0, None),
        (10, 0, 5.1, 3.0, "passed"),
        (4000, 600, 5.1, 0.0, "passed"),
    ],
)
def test_ends_come_in_their_order(frame, standing, ahead, aside, expected):
    """At 20 Hz: 30 s of standing are 600 frames, the 200 s of an episode 4000."""
    rules, roadmap = WORLDS[LEFT].rules, LEFT.logical.roadmap
    along = roadmap.destination_direction
    x, y = roadmap.destination_point + ahead * along + aside * np.array([-along[1], along[0]])
    end = find_end(rules, frame, standing, x, y)
    assert (None if end == RUNNING else ENDS[end]) == expected


def put_scenario(world, state, b, scenario, roadmap):
    begin_episodes(world, state, np.array([b]), *npc_arrays([scenario], roadmap, state.phases.shape[2] - 1))


def test_a_slot_forgets_the_episode_before():
    """Fewer NPCs than before, other types: nothing of the larger scenario is left."""
    logical = LEFT.logical
    used, fresh = make_slots(2, 10, (10, 2), logical), make_slots(2, 10, (10, 2), logical)
    first, second = (logical.sample(np.random.default_rng(seed)) for seed in (0, 1))
    small = ScriptedScenario(logical.name, second.npcs[:2])
    put_scenario(WORLDS[LEFT], used, 1, first, logical.roadmap)
    used.numbers[1, LINE_FRAME], used.numbers[1, END], used.ego[1] = 7, 1, 99.0
    put_scenario(WORLDS[LEFT], used, 1, small, logical.roadmap)
    put_scenario(WORLDS[LEFT], fresh, 1, small, logical.roadmap)
    assert used.numbers[1, N_NPCS] == 2
    assert used.size[1, 1:3].tolist() == [list(VEHICLE_SIZES[npc.type]) for npc in small.npcs]
    for name in ("ego", "numbers", "size", "npc"):
        assert np.array_equal(getattr(used, name)[1], getattr(fresh, name)[1]), name
        assert not getattr(used, name)[0].any() or name == "numbers"
    assert used.numbers[0, END] == slots.IDLE


@given(st.integers(0, 2**32 - 1), st.lists(st.floats(0, 200), min_size=1, max_size=12))
def test_npcs_move_at_any_times_as_their_table_says(seed, times):
    logical, world = LEFT.logical, WORLDS[LEFT]
    scenario, times = logical.sample(np.random.default_rng(seed)), np.sort(times)
    state = make_slots(1, 2, (1, 2), logical)
    put_scenario(world, state, 0, scenario, logical.roadmap)
    table = motion_table(scenario, logical.roadmap, times)
    for time, rows in zip(times, table, strict=True):
        move_npcs(world.npc_routes, state.numbers, state.npc, state.npc_numbers, state.phases, 0, time)
        assert np.array_equal(state.npc[0], rows)


def test_the_reward_of_many_is_that_of_each():
    rng = np.random.default_rng(2)
    state = make_slots(60, 2, (1, 2), LEFT.logical)
    state.numbers[:, END] = rng.integers(-1, len(ENDS), 60)
    state.outcome[:, :2] = rng.normal(0, 3, (60, 2))
    state.outcome[:, 2:] = rng.integers(0, 2, (60, 2))
    weights = {name: float(rng.normal()) for name in WEIGHTS}
    active = rng.random(60) < 0.8
    many = dict(zip(TERMS, reward_terms(np.array([weights[name] for name in TERMS]), state, active), strict=True))
    for b, (progress, acceleration, touched, rear_end) in enumerate(state.outcome):
        end = ENDS[state.numbers[b, END]] if state.numbers[b, END] >= 0 else None
        one = terms_of_one(
            weights, progress=progress, acceleration=acceleration, touched=touched, end=end, rear_end=bool(rear_end)
        )
        assert {name: values[b] for name, values in many.items()} == pytest.approx(
            one if active[b] else dict.fromkeys(one, 0)
        )


def test_the_world_is_the_environment_s():
    world, roadmap = (
        make_world(IntersectionStraightEnv({"simulation_frequency": 15, "policy_frequency": 5})),
        LEFT.logical.roadmap,
    )
    assert (world.rules.substeps, world.rules.frequency, world.rules.max_frames) == (3, 15, 3000)
    assert (world.rules.min_speed, world.rules.max_speed) == (Vehicle.MIN_SPEED, Vehicle.MAX_SPEED)
    assert not world.is_meta
    limited = make_world(LaneChangeEnv({"action": {"type": "ContinuousAction", "speed_range": [0, 9]}}))
    assert (limited.rules.min_speed, limited.rules.max_speed) == (0, 9)
    meta_world = make_world(LaneChangeEnv({"action": {"type": "DiscreteMetaAction", "target_speeds": [0, 8]}}))
    assert (meta_world.is_meta, meta_world.target_speeds.tolist()) == (True, [0, 8])
    assert WORLDS[LEFT].start == pytest.approx(roadmap.start_pose)
    ends = [route.pose(route.length)[:2] for route in roadmap.npc_routes]
    assert WORLDS[LEFT].npc_ends == pytest.approx(np.array(ends))
    turning = WORLDS[LEFT].ego_lanes[1]
    assert math.hypot(*turning[3:5]) == pytest.approx(1)
    assert 1 / turning[5] == pytest.approx(-16.75)


def test_the_ego_of_the_single_environment_is_placed_as_the_kernels_have_it():
    roadmap = LEFT.logical.roadmap
    network = road_network(roadmap)
    road = Road(network, np_random=np.random.default_rng(0))
    ego = place_ego(Vehicle, road, roadmap.start_pose, network.indexes(roadmap.ego_route))
    state = make_slots(1, 2, (1, 2), LEFT.logical)
    put_scenario(WORLDS[LEFT], state, 0, ScriptedScenario(LEFT.logical.name, ()), roadmap)
    assert state.ego[0, :4].tolist() == [*ego.position, ego.heading, ego.speed]
    assert network._indexes[state.numbers[0, slots.TARGET_LANE]] == ego.lane_index
    assert (ego.LENGTH, ego.WIDTH) == EGO_SIZE
    assert not ego.collidable
