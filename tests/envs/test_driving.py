"""The environments as gymnasium environments, and what they do with a concrete scenario."""

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.kinematics import Vehicle
from hypothesis import given, settings
from hypothesis import strategies as st

import behavexplor
from behavexplor.data.geometry import box_corners, boxes_overlap
from behavexplor.data.npc_motion import SPEED, motion_table
from behavexplor.data.scripted import NPC, ScriptedScenario, Waypoint
from behavexplor.envs import plain_simulation as viewer
from behavexplor.envs.driving import DrivingEnv
from behavexplor.envs.functional import IntersectionStraightEnv
from behavexplor.errors import InputError
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
    return ScriptedScenario("intersection-straight", npcs)


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


def test_the_ego_is_highway_env_s_bicycle():
    """The recorded motion is that of the model in highway-env's documentation, integrated at 20 Hz."""
    env = gymnasium.make(S1, config={**SCENE, "duration": 2.0})
    env.reset(options={"scenario": scene()})
    for _ in range(20):
        *_, info = env.step(np.array([0.8, 0.1]))
    recorded = info["trace"]
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
        ({"scenario": "s1.json"}, "must be a behavexplor.data.scripted.ScriptedScenario"),
        ({"scenario": ScriptedScenario("lane-follow", ())}, "functional: this is a scenario of 'lane-follow'"),
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
        env.reset(options={"scenario": ScriptedScenario.from_dict(value)})
    assert field in str(error.value)


def test_a_step_needs_an_episode():
    made, bare = gymnasium.make(S1, config=SCENE), IntersectionStraightEnv(SCENE)
    with pytest.raises(ResetNeeded, match=r"Cannot call env\.step"):
        made.step(GO)
    with pytest.raises(ResetNeeded, match="No episode has begun: call reset before step"):
        bare.step(GO)
    bare.reset(options={"scenario": scene(crawler("south-inner-straight", 50.0))})
    while not bare.step(GO)[2]:
        pass
    time = bare.time
    with pytest.raises(ResetNeeded, match="The episode has ended: call reset before step"):
        bare.step(GO)
    assert bare.time == time
    bare.reset()
    bare.step(GO)


@pytest.mark.parametrize(
    ("action_type", "action"),
    [
        ("ContinuousAction", None),
        ("ContinuousAction", 0.5),
        ("ContinuousAction", np.zeros(3)),
        ("ContinuousAction", np.zeros((1, 2))),
        ("ContinuousAction", np.array([np.nan, 0.0])),
        ("ContinuousAction", [np.inf, 0.0]),
        ("ContinuousAction", ["a", "b"]),
        ("DiscreteMetaAction", 5),
        ("DiscreteMetaAction", -1),
        ("DiscreteMetaAction", 1.0),
        ("DiscreteMetaAction", np.array([1])),
        ("DiscreteMetaAction", None),
        ("DiscreteAction", 9),
    ],
)
def test_what_is_no_action_is_refused_and_nothing_moves(action_type, action):
    env = IntersectionStraightEnv({"action": {"type": action_type}})
    env.reset(seed=0)
    with pytest.raises(InputError, match="actions: expected finite numbers of"):
        env.step(action)
    assert (env.time, env.steps) == (0, 0)
    env.step(env.action_space.sample())


@pytest.mark.parametrize("action", [[0.5, -0.1], (0.5, -0.1), np.array([0.5, -0.1], dtype=np.float32)])
def test_an_action_may_be_any_sequence_of_numbers(action):
    env = IntersectionStraightEnv(SCENE)
    env.reset(seed=0)
    env.step(np.array([0.5, -0.1]))
    expected = env.vehicle.position
    env.reset(seed=0)
    env.step(action)
    assert env.vehicle.position == pytest.approx(expected, abs=1e-6)


def test_actions_beyond_the_box_are_clipped():
    env = IntersectionStraightEnv(SCENE)
    states = []
    for action in ([5.0, 0.0], [1.0, 0.0]):
        env.reset(seed=0)
        env.step(np.array(action))
        states.append((env.vehicle.speed, *env.vehicle.position))
    assert states[0] == states[1]


def test_gymnasium_s_wrappers_take_it(tmp_path):
    pytest.importorskip("moviepy")
    env = gymnasium.make(S1, config={"duration": 2.0}, render_mode="rgb_array", max_episode_steps=30)
    env = gymnasium.wrappers.RecordVideo(env, str(tmp_path / "videos"), episode_trigger=lambda _: True)
    env = gymnasium.wrappers.RecordEpisodeStatistics(gymnasium.wrappers.TimeLimit(env, 7))
    env.reset(seed=0)
    results = [env.step(np.zeros(2)) for _ in range(7)]
    assert [truncated for *_, truncated, _ in results] == [False] * 6 + [True]
    info = results[-1][-1]
    assert (info["episode"]["l"], "trace" in info) == (7, False)  # cut by the wrapper: the episode itself goes on
    assert info["episode"]["r"] == pytest.approx(sum(reward for _, reward, *_ in results))
    env.close()
    assert len(list((tmp_path / "videos").glob("*.mp4"))) == 1


def test_environments_in_processes_bring_their_traces():
    def make():
        return gymnasium.make(S1, config={"duration": 1.0})

    envs = gymnasium.vector.AsyncVectorEnv([make] * 2, autoreset_mode=gymnasium.vector.AutoresetMode.SAME_STEP)
    envs.reset(seed=3)
    for _ in range(10):
        *_, truncated, infos = envs.step(np.zeros((2, 2)))
    envs.close()
    assert truncated.all()
    traces = infos["final_info"]["trace"]
    assert [(trace.end, trace.duration) for trace in traces] == [("timeout", 1.0)] * 2
    assert traces[0].to_bytes() != traces[1].to_bytes()  # seeds 3 and 4


@pytest.mark.parametrize("theirs", ["intersection-v0", "intersection-v1", "highway-v0"])
@pytest.mark.filterwarnings("ignore:.*is out of date:DeprecationWarning")
def test_a_policy_of_highway_env_drives_here_to_an_end(theirs):
    """With its own observation, action and frequencies, the same numbers at the same places of the observation."""
    import highway_env  # noqa: F401, PLC0415 - registers its environments

    original = gymnasium.make(theirs).unwrapped
    keys = ("observation", "action", "simulation_frequency", "policy_frequency")
    env = IntersectionStraightEnv({key: original.config[key] for key in keys})
    observation, _ = env.reset(seed=1)
    shown = type(original.observation_type)(env, **original.config["observation"])
    rng = np.random.default_rng(0)
    weights = rng.normal(0, 1, (observation.size, gymnasium.spaces.flatdim(env.action_space)))
    while True:
        scores = observation.ravel() @ weights
        discrete = isinstance(env.action_space, gymnasium.spaces.Discrete)
        observation, _, terminated, truncated, info = env.step(int(scores.argmax()) if discrete else np.tanh(scores))
        assert np.array_equal(observation, shown.observe())
        if terminated or truncated:
            break
    assert info["trace"].duration == pytest.approx(len(info["trace"].actions), abs=1)  # decides once a second


def test_configure_gives_up_the_episode():
    env = IntersectionStraightEnv(SCENE)
    env.reset(seed=0)
    env.configure({"action": {"type": "DiscreteMetaAction"}, "policy_frequency": 2})
    with pytest.raises(ResetNeeded):
        env.step(3)
    assert env.reset(seed=0)[0].shape == (6, 8)
    env.step(3)
    assert env.steps == 10
    assert env.vehicle.target_speed > 0


def test_the_configuration_of_one_environment_makes_another():
    first = IntersectionStraightEnv({**SCENE, "duration": 7.0, "logical": {"n_npcs": 3}, "reward": {"step": -1.0}})
    second = gymnasium.make(S1, config=first.config).unwrapped
    assert second.config == first.config
    assert second.logical == first.logical
    assert second.reset(seed=1)[1] == first.reset(seed=1)[1]
