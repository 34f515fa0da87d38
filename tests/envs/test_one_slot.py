"""The single environment, which is simulated by the engine, against highway-env's objects."""

import copy
import pickle
from itertools import islice

import gymnasium
import numpy as np
import pytest
from gymnasium.wrappers import RecordVideo

from behavexplor.envs.functional import IntersectionLeftEnv, IntersectionStraightEnv, LaneChangeEnv, LaneFollowEnv
from tests.envs.plain import plain

ENVS = (IntersectionStraightEnv, IntersectionLeftEnv, LaneFollowEnv, LaneChangeEnv)
META = {"type": "DiscreteMetaAction", "target_speeds": [0, 4, 8, 12]}
ACTIONS = {"continuous": {"type": "ContinuousAction"}, "discrete": {"type": "DiscreteAction"}, "meta": META}
GRID = {"type": "OccupancyGrid", "features": ["presence", "vx", "on_road"]}
OBSERVATIONS = {
    "lidar": {"type": "LidarObservation"},
    "grid": GRID,
    "times": {"type": "TimeToCollision"},
    "tuple": {"type": "TupleObservation", "observation_configs": [GRID, {"type": "Kinematics"}]},
    "gray": {
        "type": "GrayscaleObservation",
        "observation_shape": (64, 48),
        "stack_size": 2,
        "weights": [0.3, 0.5, 0.2],
        "scaling": 1.75,
    },
    "shuffled": {"type": "Kinematics", "order": "shuffled"},
}


def actions_of(env, seed):
    """Yield actions that get somewhere."""
    rng = np.random.default_rng(seed)
    while True:
        if isinstance(env.action_space, gymnasium.spaces.Discrete):
            yield int(rng.integers(env.action_space.n))
        else:
            yield rng.uniform([0.0, -0.1], [1.0, 0.1]).astype(np.float32)


def both(env_class, config, render_mode=None):
    return env_class(config, render_mode), plain(env_class)(config, render_mode)


def flat(observation):
    return np.concatenate([np.ravel(part) for part in observation]) if isinstance(observation, tuple) else observation


@pytest.mark.parametrize("observation", OBSERVATIONS.values(), ids=OBSERVATIONS)
@pytest.mark.parametrize("env_class", ENVS)
def test_observations_of_objects_are_as_before(env_class, observation):
    action = META if observation["type"] == "TimeToCollision" else ACTIONS["continuous"]
    engine, objects = both(env_class, {"observation": observation, "action": action, "duration": 8})
    one, other = engine.reset(seed=0)[0], objects.reset(seed=0)[0]
    assert np.array_equal(flat(one), flat(other))
    for given in actions_of(engine, 0):
        one, reward, *ends, info = engine.step(given)
        other, expected, *others, _ = objects.step(given)
        assert np.array_equal(flat(one), flat(other))
        assert reward == pytest.approx(expected, abs=1e-9)
        assert ends == others
        if any(ends):
            break
    assert info["trace"].end == info["end"]


@pytest.mark.parametrize("action", ACTIONS.values(), ids=ACTIONS)
@pytest.mark.parametrize("env_class", ENVS)
def test_pictures_are_as_before(env_class, action):
    config = {"action": action, "duration": 4, "screen_width": 300, "screen_height": 300, "policy_frequency": 5}
    engine, objects = both(env_class, config, "rgb_array")
    for env in (engine, objects):
        env.reset(seed=1)
    assert len(np.unique(engine.render().reshape(-1, 3), axis=0)) > 5  # something is drawn
    for given in actions_of(engine, 1):
        assert np.array_equal(engine.render(), objects.render())
        ended = [env.step(given)[2:4] for env in (engine, objects)]
        assert ended[0] == ended[1]
        if any(ended[0]):
            break
    for env in (engine, objects):
        env.close()


@pytest.mark.parametrize("action", [ACTIONS["continuous"], META], ids=["continuous", "meta"])
def test_films_show_the_frames_between_decisions_as_before(tmp_path, action, monkeypatch):
    pytest.importorskip("moviepy")
    config = {"action": action, "duration": 2, "screen_width": 200, "screen_height": 200}
    films = []
    for env in both(LaneChangeEnv, config, "rgb_array"):
        frames = []
        recorder = RecordVideo(
            env, str(tmp_path / type(env).__name__), episode_trigger=lambda _: True, disable_logger=True
        )
        env.set_record_video_wrapper(recorder)
        monkeypatch.setattr(recorder, "_capture_frame", lambda env=env, frames=frames: frames.append(env.render()))
        recorder.reset(seed=3)
        for given in actions_of(env, 3):
            *_, terminated, truncated, _ = recorder.step(given)
            if terminated or truncated:
                break
        films.append(frames)
        monkeypatch.undo()
        recorder.recording = False
        env.close()
    assert len(films[0]) == len(films[1]) > 30
    assert all(map(np.array_equal, *films))


@pytest.mark.parametrize("action", ACTIONS.values(), ids=ACTIONS)
def test_vehicles_show_the_episode(action):
    """Also those that were asked for before: they are the same objects until the next episode."""
    engine, objects = both(IntersectionStraightEnv, {"action": action, "duration": 10})
    for env in (engine, objects):
        env.reset(seed=2)
    held = list(engine.road.vehicles)
    for given in islice(actions_of(engine, 2), 60):
        ended = [env.step(given)[2:4] for env in (engine, objects)]
        for one, other in zip(held, objects.road.vehicles, strict=True):
            assert np.allclose(one.position, other.position, atol=1e-9)
            assert (one.heading, one.speed) == pytest.approx((other.heading, other.speed), abs=1e-9)
            assert one.action == pytest.approx(other.action, abs=1e-9)
            assert one.lane_index == other.lane_index
            assert (one.LENGTH, one.WIDTH, one.crashed) == (other.LENGTH, other.WIDTH, other.crashed)
            for name in ("target_lane_index", "speed_index", "target_speed", "route"):
                assert getattr(one, name, None) == getattr(other, name, None)
        assert (engine.steps, engine.time) == (objects.steps, objects.time)
        if any(ended[0]):
            break
    assert engine.vehicle is held[0]
    assert engine.steps > 40
    engine.reset()
    assert engine.vehicle is not held[0]


@pytest.mark.parametrize("action", [ACTIONS["continuous"], META], ids=["continuous", "meta"])
def test_what_a_user_changes_of_the_ego_counts(action):
    engine, objects = both(LaneChangeEnv, {"action": action})
    for env in (engine, objects):
        env.reset(seed=0)
        env.step(1 if action is META else np.zeros(2))
    for env in (engine, objects):
        env.vehicle.position = env.vehicle.position + (20.0, 1.0)
        env.vehicle.speed, env.vehicle.heading = 6.0, 0.1
    seen = [env.step(1 if action is META else np.array([0.5, 0.0]))[0] for env in (engine, objects)]
    assert np.allclose(*seen, atol=1e-6)
    assert engine.vehicle.speed > 5.0


def test_copies_go_on_by_themselves():
    env = LaneFollowEnv()
    env.reset(seed=0)
    env.step(np.array([1.0, 0.0]))
    copies = [copy.deepcopy(env), pickle.loads(pickle.dumps(env))]
    expected = [env.step(np.array([0.5, 0.0]))[0] for _ in range(5)]
    for other in copies:
        assert np.array_equal([other.step(np.array([0.5, 0.0]))[0] for _ in range(5)], expected)
    assert other.vehicle.position == pytest.approx(env.vehicle.position)


class OwnReward(LaneFollowEnv):
    def _reward(self, action):
        return 7.0


class OwnEnd(LaneFollowEnv):
    def _find_end(self):
        return "timeout"


def test_a_subclass_with_its_own_reward_is_compiled(caplog):
    env = OwnReward()
    env.reset(seed=0)
    assert env.step(np.zeros(2))[1] == 7.0
    assert not caplog.records


def test_a_subclass_that_overrides_a_method_is_simulated_on_objects_and_says_so_once(caplog):
    env = OwnEnd()
    for _ in range(2):
        env.reset(seed=0)
        assert env.step(np.zeros(2))[3]
    assert [record.message for record in caplog.records] == [
        "OwnEnd is simulated on highway-env's objects, many times as slow as compiled: the engine does not support "
        "the method OwnEnd._find_end"
    ]


def test_a_method_that_is_replaced_in_an_environment_is_called():
    env = LaneFollowEnv()
    env._reward = lambda action: 3.0
    env.reset(seed=0)
    assert env.step(np.zeros(2))[1] == 3.0
    del env._reward
    env.reset(seed=0)
    assert env.step(np.zeros(2))[1] != 3.0
