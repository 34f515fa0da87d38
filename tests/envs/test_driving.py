"""The environments as gymnasium environments, and what they do with a concrete scenario."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.kinematics import Vehicle
from hypothesis import given, settings
from hypothesis import strategies as st

import behavexplor
from behavexplor.envs import viewer
from behavexplor.envs.driving import DrivingEnv
from behavexplor.envs.npc import SPEED, motion_table
from behavexplor.errors import InputError
from behavexplor.geometry import box_corners, boxes_overlap
from behavexplor.scenario import NPC, Scenario, Waypoint
from tests.strategies import seeds

S1 = "behavexplor/intersection-straight-v0"
IDS = [f"behavexplor/{name}-v0" for name in behavexplor.FUNCTIONAL_SCENARIOS]
CONTINUOUS = {"type": "ContinuousAction", "acceleration_range": [-8.0, 4.0], "steering_range": [-0.6, 0.6]}
SCENE = {"observation": {"type": "Scene"}, "action": CONTINUOUS}
GO, HOLD, BRAKE = (np.array([a, 0.0]) for a in (1.0, 1 / 3, -1.0))


@pytest.fixture(scope="module")
def env():
    env = gymnasium.make(S1, config=SCENE)
    yield env.unwrapped
    env.close()


def drive(env, scenario, policy):
    """Drive to the end of the episode; `policy` maps the ego's speed to an action."""
    env.reset(options={"scenario": scenario})
    while True:
        *_, terminated, truncated, info = env.step(policy(env.vehicle.speed))
        if terminated or truncated:
            return info["trace"], terminated, truncated


def cruise(speed):
    return GO if speed < 10 else HOLD


def scene(*npcs):
    return Scenario("intersection-straight", npcs)


def crawler(route, start, speed=0.2, kind="sedan"):
    """A vehicle that crawls at constant speed on its first lane."""
    lanes = behavexplor_logical().position_ranges(behavexplor_logical().roadmap.routes[route])
    waypoints = [Waypoint(max(float(low), start if high >= start else 0.0), speed) for low, high in lanes]
    waypoints[-1] = Waypoint(waypoints[-1].position, 0.0)
    return NPC(kind, route, tuple(waypoints))


def behavexplor_logical():
    return gymnasium.make(S1).unwrapped.logical


@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize(
    "config",
    [
        {},
        SCENE,
        {"observation": {"type": "OccupancyGrid"}},
        {"observation": {"type": "Kinematics"}, "action": {"type": "DiscreteMetaAction"}, "policy_frequency": 1},
    ],
    ids=["default", "scene", "grid", "meta"],
)
@pytest.mark.filterwarnings("ignore:.*Box observation space:UserWarning")
def test_gymnasium_accepts_it(env_id, config):
    env = gymnasium.make(env_id, config=config, render_mode="rgb_array")
    check_env(env.unwrapped)
    env.close()


@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.filterwarnings("ignore:Your observation:UserWarning")
def test_stable_baselines3_accepts_it(env_id):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    env = gymnasium.make(env_id)
    checker.check_env(env.unwrapped)
    env.close()


def test_without_traffic_the_ego_arrives(env):
    trace, terminated, truncated = drive(env, scene(), cruise)
    assert (trace.end, terminated, truncated) == ("arrived", True, False)
    assert trace.destination_distance <= 1.0
    assert trace.duration == pytest.approx(160 / 10, rel=0.1)


def test_a_slow_car_ahead_is_hit(env):
    trace, terminated, _ = drive(env, scene(crawler("south-inner-straight", 50.0)), cruise)
    assert (trace.end, terminated) == ("collision", True)
    boxes = box_corners(trace.position[-2:], trace.heading[-2:], trace.size)
    assert boxes_overlap(boxes[-1, 0], boxes[-1, 1])
    assert not boxes_overlap(boxes[-2, 0], boxes[-2, 1])


def test_standing_for_half_a_minute_ends_the_episode(env):
    trace, terminated, truncated = drive(env, scene(), lambda _: HOLD)
    assert (trace.end, terminated, truncated) == ("standstill", False, True)
    assert trace.duration == pytest.approx(30, abs=0.11)


def test_driving_past_the_destination_ends_the_episode(env):
    env.reset(options={"scenario": scene()})
    env.vehicle.position = env.logical.roadmap.destination_point + (2.0, 6.0)
    for _ in range(30):
        *_, terminated, _, info = env.step(GO)
        if terminated:
            break
    assert info["end"] == "passed"
    assert -80.6 < info["trace"].position[-1, 0, 1] < -80.0


def test_the_time_limit_cuts_the_episode():
    env = gymnasium.make(S1, config={**SCENE, "duration": 2.0}).unwrapped
    trace, terminated, truncated = drive(env, scene(), cruise)
    assert (trace.end, terminated, truncated) == ("timeout", False, True)
    assert trace.duration == pytest.approx(2.0)


ENVS = {env_id: gymnasium.make(env_id, config=SCENE).unwrapped for env_id in IDS}


@pytest.mark.parametrize("env_id", IDS)
@settings(max_examples=12, deadline=None)
@given(seed=seeds)
def test_every_scenario_runs_to_its_end(env_id, seed):
    env = ENVS[env_id]
    scenario = env.logical.sample(np.random.default_rng(seed))
    trace, terminated, truncated = drive(env, scenario, cruise)
    assert terminated or truncated
    table = motion_table(scenario, env.logical.roadmap, trace.time)
    assert trace.position[:, 1:] == pytest.approx(table[..., :2], abs=1e-9)
    assert np.hypot(*np.moveaxis(trace.velocity[:, 1:], -1, 0)) == pytest.approx(table[..., SPEED], abs=1e-8)
    assert np.diff(trace.time) == pytest.approx(0.05)
    assert np.array_equal(trace.action_frame, np.arange(0, len(trace.time) - 1, 2))


def test_the_same_scenario_gives_the_same_trace(env):
    scenario = env.logical.sample(np.random.default_rng(1))
    first, *_ = drive(env, scenario, cruise)
    drive(env, scene(), lambda _: BRAKE)
    assert drive(env, scenario, cruise)[0].to_bytes() == first.to_bytes()
    other = gymnasium.make(S1, config=SCENE).unwrapped
    assert drive(other, scenario, cruise)[0].to_bytes() == first.to_bytes()


def test_without_a_scenario_the_seed_decides(env):
    first = env.reset(seed=4)[1]["scenario"]
    second = env.reset()[1]["scenario"]
    assert first != second
    assert env.reset(seed=4)[1]["scenario"] == first
    assert env.reset()[1]["scenario"] == second


def test_the_ego_is_highway_env_s_bicycle(env):
    """The recorded motion is that of the model in highway-env's documentation, integrated at 20 Hz."""
    env.reset(options={"scenario": scene()})
    for _ in range(20):
        env.step(np.array([0.8, 0.1]))
    recorded = env._recorder.trace("timeout")
    x, y, heading, speed = *recorded.position[0, 0], recorded.heading[0, 0], 0.0
    acceleration, steering = -8 + 12 * 0.9, 0.06
    slip = np.arctan(0.5 * np.tan(steering))
    for frame in range(1, 41):
        x, y = x + 0.05 * speed * np.cos(heading + slip), y + 0.05 * speed * np.sin(heading + slip)
        heading += 0.05 * speed * np.sin(slip) / (4.70 / 2)
        speed += 0.05 * acceleration
        assert recorded.position[frame, 0] == pytest.approx([x, y], abs=1e-6)
        assert recorded.heading[frame, 0] == pytest.approx(heading, abs=1e-6)
        expected = speed * np.array([np.cos(heading + slip), np.sin(heading + slip)])
        assert recorded.velocity[frame, 0] == pytest.approx(expected, abs=1e-6)


def test_highway_env_pushes_nobody_apart(env):
    """Its own collision response never takes part: vehicles keep their paths and are not flagged."""
    drive(env, scene(crawler("south-inner-straight", 50.0)), cruise)
    assert not any(vehicle.crashed for vehicle in env.road.vehicles)


def test_nothing_global_is_left_behind(env):
    before = (Vehicle.LENGTH, Vehicle.WIDTH, Vehicle.MAX_SPEED, IDMVehicle.DISTANCE_WANTED, dict(DrivingEnv.metadata))
    env.reset()
    env.step(GO)
    after = (Vehicle.LENGTH, Vehicle.WIDTH, Vehicle.MAX_SPEED, IDMVehicle.DISTANCE_WANTED, dict(DrivingEnv.metadata))
    assert before == after


def test_the_scene_shows_every_vehicle(env):
    scenario = scene(crawler("west-inner-left", 20.0, kind="school-bus"), crawler("east-outer-right", 40.0))
    observation, _ = env.reset(options={"scenario": scenario})
    assert observation.shape == (6, 8)
    assert observation[:, 0].tolist() == [1, 1, 1, 0, 0, 0]
    assert observation[0, 1:] == pytest.approx([1.75, 85.0, -np.pi / 2, 0.0, 0.0, 4.70, 2.06])
    assert observation[1, 1:] == pytest.approx([-115.0, 1.75, 0.0, 0.2, 0.0, 9.21, 3.26])
    assert not observation[3:].any()


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ({"observatoin": {}}, "did you mean 'observation'"),
        ({"simulation_frequency": 15}, "simulation_frequency 15 must be a multiple of policy_frequency 10"),
    ],
)
def test_a_wrong_config_is_refused(config, message):
    with pytest.raises(InputError, match=message):
        gymnasium.make(S1, config=config)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"scenari": None}, "did you mean 'scenario'"),
        ({"scenario": "s1.json"}, "must be a behavexplor.scenario.Scenario"),
        ({"scenario": Scenario("lane-follow", ())}, "functional: this is a scenario of 'lane-follow'"),
    ],
)
def test_wrong_reset_options_are_refused(env, options, message):
    with pytest.raises(InputError, match=message):
        env.reset(options=options)


def test_a_picture_shows_lines_routes_and_vehicles():
    env = gymnasium.make(S1, config=SCENE, render_mode="rgb_array")
    env.reset(options={"scenario": scene(crawler("north-inner-straight", 100.0))})
    picture = env.render()
    env.close()
    assert picture.shape == (800, 800, 3)
    colors = {tuple(color) for color in picture.reshape(-1, 3)[::3].tolist()}
    assert {viewer.YELLOW, viewer.CURB, viewer.EGO} <= colors


@pytest.mark.parametrize("env_id", IDS)
@settings(max_examples=40, deadline=None)
@given(seed=seeds, data=st.data())
def test_every_broken_scenario_is_refused_by_name_before_the_episode(env_id, seed, data):
    env = ENVS[env_id]
    value = env.logical.sample(np.random.default_rng(seed)).to_dict()
    npc = data.draw(st.integers(0, len(value["npcs"]) - 1))
    waypoint = data.draw(st.integers(0, len(value["npcs"][npc]["waypoints"]) - 1))
    breaks = {
        "type": lambda: value["npcs"][npc].update(type="tank"),
        "route": lambda: value["npcs"][npc].update(route="nowhere"),
        "waypoints": value["npcs"][npc]["waypoints"].pop,
        "position": lambda: value["npcs"][npc]["waypoints"][-1].__setitem__(0, 9999.0),
        "speed": lambda: value["npcs"][npc]["waypoints"][waypoint].__setitem__(1, 50.0),
        "functional": lambda: value.update(functional="elsewhere"),
        "npcs": lambda: value["npcs"].extend(value["npcs"]),
    }
    field = data.draw(st.sampled_from(sorted(breaks)))
    breaks[field]()
    with pytest.raises(InputError) as error:
        env.reset(options={"scenario": Scenario.from_dict(value)})
    assert field in str(error.value)
