"""Pictures: what is drawn is where the map and the scenario say."""

import copy
import pickle

import numpy as np
import pytest

from behavexplor.data.scripted import ScriptedScenario
from behavexplor.envs import plain_simulation as viewer
from behavexplor.envs.functional import IntersectionLeftEnv, LaneChangeEnv
from behavexplor.errors import InputError

VIEW = {"screen_width": 600, "screen_height": 300, "scaling": 10.0, "centering_position": [0.5, 0.5]}


@pytest.fixture
def env():
    env = IntersectionLeftEnv(VIEW, render_mode="rgb_array")
    env.reset(options={"scenario": ScriptedScenario("intersection-left", ())})
    yield env
    env.close()


def at(env, picture, x, y):
    """The color at a place of the world."""
    dx, dy = np.array([x, y]) - env.vehicle.position
    scale, (width, height) = env.config["scaling"], (picture.shape[1], picture.shape[0])
    return tuple(picture[round(height / 2 + dy * scale), round(width / 2 + dx * scale)].tolist())


def test_lines_and_the_ego_are_where_the_map_says(env):
    picture = env.render()
    assert picture.shape == (300, 600, 3)
    x, y = env.vehicle.position
    assert (x, y) == pytest.approx((1.75, 95.0))
    yellow = [at(env, picture, offset, y) == viewer.YELLOW for offset in (-0.5, -0.15, 0.15, 0.5)]
    assert yellow == [False, True, True, False]  # two lines, 0.3 m apart
    assert at(env, picture, 7.0, y) == viewer.CURB
    assert at(env, picture, -7.0, y) == viewer.CURB
    assert at(env, picture, x, y + 1.0) == viewer.EGO


def test_the_picture_follows_the_ego(env):
    before = env.render()
    for _ in range(20):
        env.step(np.array([1.0, 0.0]))
    after = env.render()
    assert not np.array_equal(before, after)
    assert at(env, after, *env.vehicle.position + (0, 1.0)) == viewer.EGO


def test_the_destination_is_drawn(env):
    env.vehicle.position = env.logical.roadmap.destination_point + (0.0, 8.0)
    picture = env.render()
    x, y = env.logical.roadmap.destination_point
    ring = [at(env, picture, x + 0.9 * np.cos(angle), y + 0.9 * np.sin(angle)) for angle in np.linspace(0, 6.28, 12)]
    assert ring.count(viewer.DESTINATION) >= 10


def test_each_npc_and_its_route_have_a_color_of_their_own():
    env = LaneChangeEnv({**VIEW, "screen_width": 1600, "scaling": 4.0}, render_mode="rgb_array")
    scenarios = [env.reset(seed=seed)[1]["scenario"] for seed in (1, 2)]
    for scenario in scenarios:
        env.reset(options={"scenario": scenario})
        picture = env.render()
        for i, vehicle in enumerate(env.road.vehicles[1:]):
            if abs(vehicle.position[0] - env.vehicle.position[0]) < 190:
                assert at(env, picture, *vehicle.position) == viewer.NPCS[i]
    env.close()


def test_the_window_of_a_human(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env = LaneChangeEnv(VIEW, render_mode="human")
    env.reset(seed=0)
    env.step(np.array([1.0, 0.0]))
    assert env.render() is None
    assert env.viewer.screen.get_size() == (600, 300)
    env.close()
    assert env.done


def test_other_render_modes_are_refused():
    with pytest.raises(InputError, match="render_mode: expected None, human or rgb_array, got 'ansi'"):
        LaneChangeEnv(render_mode="ansi")


def test_a_copy_of_a_rendered_environment_opens_its_own_picture(env):
    env.step(np.array([0.5, 0.1]))
    expected = env.render()
    for other in (copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
        assert np.array_equal(other.render(), expected)
        assert np.array_equal(
            other.step(np.array([0.5, 0.1]))[0], pickle.loads(pickle.dumps(env)).step(np.array([0.5, 0.1]))[0]
        )
