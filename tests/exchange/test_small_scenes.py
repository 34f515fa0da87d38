"""Scenes and roads that are written and read without driving anything."""

import re
from datetime import UTC, datetime

import numpy as np
import pytest

from behavexplor.campaign.config import CampaignConfig
from behavexplor.campaign.store import Store
from behavexplor.commands.export import _new_files, _Scenes
from behavexplor.data.road_plan import plan_of_map
from behavexplor.errors import InputError
from behavexplor.exchange.openscenario import write_scene
from behavexplor.exchange.scene_reading import read_scene
from behavexplor.exchange.scenes import Mover, SceneFile
from behavexplor.execution.simulation import logical_scenario


@pytest.fixture
def text(tmp_path):
    """The file of a scene in which the ego drives for a second."""
    pose = np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0]])
    ego = Mover("Ego", "vehicle", (4.9, 2.1), np.array([0.0, 1.0]), pose, 5.0)
    write_scene(SceneFile("a scene", "lane-follow", movers=(ego,)), tmp_path / "a.xosc", datetime.fromtimestamp(0, UTC))
    return (tmp_path / "a.xosc").read_text()


def read(text, folder):
    (folder / "b.xosc").write_text(text)
    return read_scene(folder / "b.xosc")


def test_a_parked_vehicle_has_a_second_point_after_a_second(tmp_path):
    time = np.arange(0.0, 6.0, 0.05)
    pose = np.outer(np.minimum(time, 2.0), [3.0, 0.0, 0.0])
    ego = Mover("Ego", "vehicle", (4.9, 2.1), time, pose, 3.0)
    write_scene(SceneFile("a scene", "lane-follow", movers=(ego,)), tmp_path / "a.xosc", datetime.fromtimestamp(0, UTC))
    written = read_scene(tmp_path / "a.xosc").movers[0]
    np.testing.assert_allclose(written.time[-4:], [1.95, 2.0, 3.0, time[-1]])
    np.testing.assert_allclose(written.pose[-3:, 0], 6.0)


def test_a_count_of_vehicles_may_be_any_text(text, tmp_path):
    assert read(text, tmp_path).n_vehicles == 1
    changed = re.sub(r'(name="behavexplor:vehicles" value=")1"', rf'\g<1>{"9" * 5000}"', text)
    assert changed != text
    assert read(changed, tmp_path).n_vehicles == 0


def test_times_beyond_all_numbers_are_refused(text, tmp_path):
    changed = re.sub(r'scale="[^"]*"', 'scale="1e308"', text).replace('time="1.0"', 'time="1e308"')
    assert changed.count("1e308") == 2
    with pytest.raises(InputError, match="a trajectory whose times do not increase"):
        read(changed, tmp_path)


def test_a_later_export_leaves_the_roads_of_earlier_ones(tmp_path):
    Store.create(tmp_path / "run", CampaignConfig(env="own").to_yaml()).close()
    plans = [plan_of_map(logical_scenario(env).roadmap) for env in ("lane-follow", "intersection-left")]
    plans.append(plans[0][:1])
    written = []
    for plan, number in ((plans[0], 3), (plans[1], 4), (plans[0], 5), (plans[2], 4)):
        with _new_files(tmp_path) as made:
            scenes = _Scenes(
                tmp_path / "run",
                CampaignConfig(env="own"),
                made,
                tmp_path,
                is_ego_free=False,
                as_routes=False,
                for_carla=False,
            )
            written.append(scenes._road_file(plan, number))
    assert written == ["own.xodr", "own-000004.xodr", "own.xodr", "own-000004-2.xodr"]
    assert {path.name for path in tmp_path.glob("*.xodr")} == {*written}


def test_two_roads_of_one_export_have_files_of_their_own(tmp_path):
    Store.create(tmp_path / "run", CampaignConfig(env="own").to_yaml()).close()
    scenes = _Scenes(
        tmp_path / "run",
        CampaignConfig(env="own"),
        tmp_path,
        tmp_path / "out",
        is_ego_free=False,
        as_routes=False,
        for_carla=False,
    )
    plans = [plan_of_map(logical_scenario(env).roadmap) for env in ("lane-follow", "intersection-left")]
    assert [scenes._road_file(plan, 3) for plan in (*plans, plans[0])] == ["own.xodr", "own-000003.xodr", "own.xodr"]
