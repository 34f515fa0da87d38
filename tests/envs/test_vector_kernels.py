"""The kernels of the vector environment, one by one, against shapely, highway-env and the single environment."""

import math

import highway_env.utils
import numpy as np
import pytest
from highway_env.road.road import Road
from highway_env.vehicle.controller import MDPVehicle
from highway_env.vehicle.kinematics import Vehicle
from hypothesis import given
from hypothesis import strategies as st
from shapely import LineString, Point, Polygon

from behavexplor.data import box_kernels
from behavexplor.data.box_kernels import boxes_touch, line_distance, line_meets_box
from behavexplor.data.conventions import EGO_SIZE, MANEUVERS, VEHICLE_SIZES
from behavexplor.data.npc_motion import motion_table
from behavexplor.data.scripted import ScriptedScenario
from behavexplor.data.trace import ENDS
from behavexplor.envs.engine import lane_keeping
from behavexplor.envs.engine.bicycle import _limit_commands
from behavexplor.envs.engine.contact import touches_line
from behavexplor.envs.engine.lane_geometry import lane_coordinates
from behavexplor.envs.engine.state import TRAITS, VEHICLE
from behavexplor.envs.functional import IntersectionLeftEnv, IntersectionStraightEnv, LaneChangeEnv
from behavexplor.envs.road_objects import MetaEgoVehicle, place_ego, road_network
from behavexplor.envs.tasks import scripted_slots as slots
from behavexplor.envs.tasks import scripted_step as step
from behavexplor.envs.tasks.scripted_outcome import POSE
from behavexplor.envs.tasks.scripted_slots import RUN, RUNNING, begin_episodes, make_slots, move_npcs, npc_arrays
from behavexplor.envs.tasks.scripted_world import make_world
from tests.kernel_calls import called_alone

boxes_touch = called_alone(boxes_touch)
corners_of = called_alone(box_kernels.corners)
line_distance = called_alone(line_distance)
line_meets_box = called_alone(line_meets_box)
move_npcs = called_alone(move_npcs)
touches_line = called_alone(touches_line)
take_maneuver = called_alone(lane_keeping.take_maneuver)
not_zero = called_alone(lane_keeping.not_zero)
nearest_speed = called_alone(lane_keeping.nearest_speed)
keep_lane_and_speed = called_alone(lane_keeping.keep_lane_and_speed)
lane_coordinates = called_alone(lane_coordinates)
limit_commands = called_alone(_limit_commands)
find_end = called_alone(step._update_end)
station = called_alone(step._station)

LEFT, CHANGE = IntersectionLeftEnv(), LaneChangeEnv()
WORLDS = {env: make_world(env) for env in (LEFT, CHANGE)}
CLEAR = 1e-6  # distances below that are not judged: rounding decides there [m]

places = st.integers(-1200, 1200).map(lambda n: n / 100)  # shapely takes tinier lines for points at infinity
boxes = st.tuples(places, places, st.floats(-7, 7), st.floats(0.5, 10), st.floats(0.5, 4))
segments = st.tuples(places, places, places, places)


def corners(x, y, heading, length, width):
    return corners_of(x, y, math.cos(heading), math.sin(heading), length, width)


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
        assert touches_line(lines, x, y, math.cos(heading), math.sin(heading)) == (min(gaps) == 0)


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
        row, steps = np.zeros(1, VEHICLE)[0], WORLDS[env].routes[0]
        (row.x, row.y), row.heading, row.speed = vehicle.position, vehicle.heading, vehicle.speed
        row.target_lane, row.speed_index, row.target_speed = target, 1, 4.5
        row.route_position, row.route_length = done, len(route)
        take_maneuver(network, speeds, row, steps, maneuver)
        place = lane_coordinates(network.lanes[row.target_lane], row.x, row.y)
        keep_lane_and_speed(network, row, steps, EGO_SIZE[0], *place)
        vehicle.act(MANEUVERS[maneuver])
        assert row.speed_index == vehicle.speed_index
        assert road_network(env.logical.roadmap)._indexes[row.target_lane] == tuple(vehicle.target_lane_index)
        assert row.acceleration == vehicle.action["acceleration"]
        assert row.steering == vehicle.action["steering"]
        changed.add((maneuver, bool(row.target_lane != target)))
    assert {(lane_keeping.LANE_LEFT, True), (lane_keeping.LANE_RIGHT, True), (lane_keeping.IDLE, False)} <= changed


@given(st.floats(-50, 50), st.lists(st.floats(0.5, 5), min_size=1, max_size=1), st.integers(2, 6))
def test_the_nearest_target_speed_is_highway_env_s(speed, steps, count):
    speeds = 1.0 + steps[0] * np.arange(count)
    vehicle = MDPVehicle(None, [0, 0], target_speeds=speeds)
    assert nearest_speed(speeds, speed) == vehicle.speed_to_index(speed)


@pytest.mark.parametrize("speed", [-3.0, 5.0, 15.0, 25.0, 29.0, 99.0])
def test_between_two_target_speeds_highway_env_s_is_the_nearest(speed):
    speeds = np.array([0.0, 10.0, 20.0, 30.0])
    assert nearest_speed(speeds, speed) == MDPVehicle(None, [0, 0], target_speeds=speeds).speed_to_index(speed)


@pytest.mark.parametrize("value", [0.0, -0.0, 0.005, -0.005, 0.01, -0.01, 0.02, -0.02])
def test_a_denominator_is_kept_from_zero_as_in_highway_env(value):
    assert not_zero(value) == highway_env.utils.not_zero(value)


@given(st.floats(-60, 60), st.floats(-10, 10))
def test_speeds_are_kept_within_limits_as_highway_env_does(speed, acceleration):
    vehicle = Vehicle(None, [0, 0], speed=speed)
    vehicle.act({"steering": 0.0, "acceleration": acceleration})
    vehicle.clip_actions()
    row, traits = np.zeros(1, VEHICLE)[0], np.zeros(1, TRAITS)[0]
    row.speed, row.acceleration = speed, acceleration
    traits.min_speed, traits.max_speed = Vehicle.MIN_SPEED, Vehicle.MAX_SPEED
    limit_commands(row, traits)
    assert row.acceleration == vehicle.action["acceleration"]


@pytest.mark.parametrize("env", [LEFT, CHANGE], ids=["left", "change"])
def test_stations_on_the_route_are_the_map_s(env):
    rng = np.random.default_rng(1)
    route = env.logical.roadmap.ego_route
    for _ in range(300):
        x, y = route.pose(rng.uniform(-20, route.length + 20))[:2] + rng.normal(0, 5, 2)
        assert station(WORLDS[env].ego_route, x, y) == pytest.approx(route.project(x, y)[0], abs=1e-9)


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
    roadmap = LEFT.logical.roadmap
    along = roadmap.destination_direction
    x, y = roadmap.destination_point + ahead * along + aside * np.array([-along[1], along[0]])
    run, pose = np.zeros(1, RUN)[0], np.zeros(1, POSE)[0]
    run.frame, run.standing, run.end, pose.x, pose.y = frame, standing - 1, RUNNING, x, y
    find_end(WORLDS[LEFT].rules[0], run, pose)
    assert (None if run.end == RUNNING else ENDS[run.end]) == expected
    pose.vx = 0.31
    run.end = RUNNING
    find_end(WORLDS[LEFT].rules[0], run, pose)
    assert run.standing == 0


def put_scenario(world, state, b, scenario, roadmap):
    begin_episodes(world, state, np.array([b]), *npc_arrays([scenario], roadmap, state.phases.shape[2] - 1))


def test_a_slot_forgets_the_episode_before():
    """Fewer NPCs than before, other types: nothing of the larger scenario is left."""
    logical = LEFT.logical
    used, fresh = make_slots(2, 10, (10, 2), logical), make_slots(2, 10, (10, 2), logical)
    first, second = (logical.sample(np.random.default_rng(seed)) for seed in (0, 1))
    small = ScriptedScenario(logical.name, second.npcs[:2])
    put_scenario(WORLDS[LEFT], used, 1, first, logical.roadmap)
    used.runs[1].line_frame, used.runs[1].end, used.state.vehicles[1, 0].speed = 7, 1, 99.0
    put_scenario(WORLDS[LEFT], used, 1, small, logical.roadmap)
    put_scenario(WORLDS[LEFT], fresh, 1, small, logical.roadmap)
    assert used.state.episodes[1].n_vehicles == 3
    traits = used.state.traits[1, 1:3]
    assert [(size.length, size.width) for size in traits] == [VEHICLE_SIZES[npc.type] for npc in small.npcs]
    assert used.state.vehicles[1, :3].tobytes() == fresh.state.vehicles[1, :3].tobytes()
    assert used.state.traits[1, :3].tobytes() == fresh.state.traits[1, :3].tobytes()
    for i in range(3):
        length = used.state.vehicles[1, i].route_length
        routes = used.state.routes[1, i, :length], fresh.state.routes[1, i, :length]
        assert routes[0].tobytes() == routes[1].tobytes()
    assert (used.state.episodes[1], used.runs[1]) == (fresh.state.episodes[1], fresh.runs[1])
    assert used.runs[0].end == slots.IDLE


@given(st.integers(0, 2**32 - 1), st.lists(st.floats(0, 200), min_size=1, max_size=12))
def test_npcs_move_at_any_times_as_their_table_says(seed, times):
    logical, world = LEFT.logical, WORLDS[LEFT]
    scenario, times = logical.sample(np.random.default_rng(seed)), np.sort(times)
    state = make_slots(1, 2, (1, 2), logical)
    put_scenario(world, state, 0, scenario, logical.roadmap)
    table = motion_table(scenario, logical.roadmap, times)
    for time, rows in zip(times, table, strict=True):
        vehicles = state.state.vehicles[0]
        move_npcs(world.npc_routes, vehicles, state.scripts[0], state.phases[0], len(scenario.npcs), time)
        moved = vehicles[1:][["x", "y", "heading", "speed", "acceleration"]]
        assert np.array_equal(np.array(moved.tolist()), rows)


def test_the_world_is_the_environment_s():
    world, roadmap = (
        make_world(IntersectionStraightEnv({"simulation_frequency": 15, "policy_frequency": 5})),
        LEFT.logical.roadmap,
    )
    rules = world.rules[0]
    assert (rules.substeps, rules.frequency, rules.max_frames) == (3, 15, 3000)
    assert (rules.min_speed, rules.max_speed) == (Vehicle.MIN_SPEED, Vehicle.MAX_SPEED)
    assert not rules.is_meta
    limited = make_world(LaneChangeEnv({"action": {"type": "ContinuousAction", "speed_range": [0, 9]}}))
    assert (limited.rules[0].min_speed, limited.rules[0].max_speed) == (0, 9)
    meta_world = make_world(LaneChangeEnv({"action": {"type": "DiscreteMetaAction", "target_speeds": [0, 8]}}))
    assert (meta_world.rules[0].is_meta, meta_world.target_speeds.tolist()) == (True, [0, 8])
    assert WORLDS[LEFT].start == pytest.approx(roadmap.start_pose)
    ends = [route.pose(route.length)[:2] for route in roadmap.npc_routes]
    lanes = road_network(roadmap).lanes_list()
    last = [steps[n - 1] for steps, n in zip(WORLDS[LEFT].routes, WORLDS[LEFT].route_lengths, strict=True)][1:]
    for end, step_ in zip(ends, last, strict=True):
        lane = lanes[WORLDS[LEFT].network.roads[step_.road].first_lane + step_.number]
        assert lane.position(lane.length, 0) == pytest.approx(end)
    turning = WORLDS[LEFT].ego_route[1]
    assert math.hypot(turning.cos, turning.sin) == pytest.approx(1)
    assert 1 / turning.curvature == pytest.approx(-16.75)


def test_the_ego_of_the_single_environment_is_placed_as_the_kernels_have_it():
    roadmap = LEFT.logical.roadmap
    network = road_network(roadmap)
    road = Road(network, np_random=np.random.default_rng(0))
    ego = place_ego(Vehicle, road, roadmap.start_pose, network.indexes(roadmap.ego_route))
    state = make_slots(1, 2, (1, 2), LEFT.logical)
    put_scenario(WORLDS[LEFT], state, 0, ScriptedScenario(LEFT.logical.name, ()), roadmap)
    row = state.state.vehicles[0, 0]
    assert [row.x, row.y, row.heading, row.speed] == [*ego.position, ego.heading, ego.speed]
    assert network._indexes[row.target_lane] == ego.lane_index
    assert (ego.LENGTH, ego.WIDTH) == EGO_SIZE
    assert not ego.collidable
