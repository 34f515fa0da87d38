import numpy as np
import pytest

from behavexplor.ads.rule.parameters import Parameters
from behavexplor.ads.rule.path import (
    ego_path,
    has_lane,
    lane_end,
    oncoming_lane,
    point_beside,
    pose_on_path,
    project_on_path,
)
from behavexplor.envs.roads import crossing, straight_road

STRAIGHT, LEFT = crossing("straight", 20, 60), crossing("left", 10, 60)
ROADS = {f"lane {i + 1}": straight_road(i, i, 10, 230) for i in range(4)}
ALL = {"S1": STRAIGHT, "S2": LEFT, **ROADS}


def path(roadmap):
    return ego_path(roadmap, Parameters())


@pytest.mark.parametrize("name", ALL)
def test_points_beside_the_path_are_projected_back(name):
    way = path(ALL[name])
    for station in np.linspace(1, ALL[name].ego_route.length - 1, 60):
        x, y, heading = pose_on_path(way, station)
        assert (x, y, heading) == pytest.approx(ALL[name].ego_route.pose(station), abs=1e-9)
        for offset in (-3.5, 0.0, 1.0):
            assert project_on_path(way, *point_beside(way, station, offset)) == pytest.approx(
                (station, offset), abs=1e-6
            )


@pytest.mark.parametrize("index", range(4))
def test_on_the_road_every_lane_but_the_present_one_is_beside(index):
    way = path(ROADS[f"lane {index + 1}"])
    assert [lane for lane in range(-5, 6) if has_lane(way, lane, 100.0)] == list(range(-index, 4 - index))
    assert oncoming_lane(way, 100.0) == -index - 1
    assert lane_end(way, 1 if index < 3 else -1, 50.0) == 230.0


def test_across_the_junction_the_lane_beside_leads_on_only_straight_ahead():
    start, end = LEFT.ego_route.bounds[1:3]
    for roadmap, inside in ((STRAIGHT, True), (LEFT, False)):
        way = path(roadmap)
        assert has_lane(way, 1, start - 20)
        assert not has_lane(way, -1, start - 20)
        assert has_lane(way, 1, start + 5) == inside
        assert has_lane(way, 1, end + 20)
    assert lane_end(path(LEFT), 1, 20.0) == pytest.approx(start, abs=1.0)
    assert lane_end(path(STRAIGHT), 1, 20.0) == path(STRAIGHT).destination


def test_the_other_direction_lies_left_of_the_legs_but_not_inside_the_junction():
    start, end = LEFT.ego_route.bounds[1:3]
    for roadmap in (STRAIGHT, LEFT):
        assert [oncoming_lane(path(roadmap), s) for s in (start - 20, start + 5, end + 20)] == [-1, 0, -1]
