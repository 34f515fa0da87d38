import numpy as np
import pytest

from behavexplor.ads.road.lane_arrays import LENGTH, project_on_lane
from behavexplor.ads.road.path import (
    ego_path,
    has_lane,
    lane_end,
    locate_on_path,
    oncoming_lane,
    point_beside,
    pose_on_path,
    project_on_path,
)
from behavexplor.envs.logical_scenarios import crossing, straight_road
from tests.kernel_calls import called_alone

has_lane = called_alone(has_lane)
lane_end = called_alone(lane_end)
locate_on_path = called_alone(locate_on_path)
oncoming_lane = called_alone(oncoming_lane)
point_beside = called_alone(point_beside)
pose_on_path = called_alone(pose_on_path)
project_on_lane = called_alone(project_on_lane)
project_on_path = called_alone(project_on_path)

STRAIGHT, LEFT = crossing("straight", 20, 60), crossing("left", 10, 60)
ROADS = {f"lane {i + 1}": straight_road(i, i, 10, 230) for i in range(4)}
ALL = {"S1": STRAIGHT, "S2": LEFT, **ROADS}


def path(roadmap):
    return ego_path(roadmap)


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


def nearest_lane(way, x, y):
    """By looking at all lanes of the route in their order."""
    found = []
    for i in range(len(way.lanes)):
        station, offset = project_on_lane(way.lanes, i, x, y)
        before = -station if i > 0 else 0.0
        behind = station - way.lanes[i, LENGTH] if i < len(way.lanes) - 1 else 0.0
        found.append((offset**2 + max(before, behind, 0.0) ** 2, i, way.bounds[i] + station, offset))
    return min(found)[1:]


@pytest.mark.parametrize("name", ["S1", "S2"])
def test_a_point_is_on_the_lane_of_the_route_that_is_nearest(name):
    way = path(ALL[name])
    joints = [pose_on_path(way, bound)[:2] for bound in way.bounds]
    anywhere = np.random.default_rng(5).uniform(-70, 70, size=(400, 2))
    lanes = set()
    for x, y in [*joints, *anywhere]:
        assert locate_on_path(way, x, y) == nearest_lane(way, x, y)
        lanes.add(locate_on_path(way, x, y)[0])
    assert lanes == set(range(len(way.lanes)))


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
