"""The planner in closed loop: what a person would expect of a careful driver."""

import numpy as np
import pytest

from behavexplor.ads.rule import Parameters
from behavexplor.ads.rule.decision import CRUISE, STOP, YIELD
from behavexplor.envs.roads import crossing
from behavexplor.geometry import box_corners, box_distance, box_segment_distance, project_on_polyline
from behavexplor.logical import EGO_SIZE
from tests.ads.rule.world import SEDAN, drive

STRAIGHT, LEFT = crossing("straight", 20, 60), crossing("left", 10, 60)
TIME, X, Y, HEADING, SPEED, ACCELERATION, STEERING = range(7)
LINE = STRAIGHT.ego_route.bounds[1]


def stations(roadmap, frames):
    line = roadmap.ego_route.polyline(0.0, roadmap.ego_route.length, 0.02)
    return project_on_polyline(frames[:, [X, Y]], line)[0]


def boxes(frames):
    return box_corners(frames[:, [X, Y]], frames[:, HEADING], np.array(EGO_SIZE))


@pytest.mark.parametrize("roadmap", [STRAIGHT, LEFT], ids=["straight", "left"])
def test_alone_it_arrives_on_its_centre_line_within_all_limits(roadmap):
    frames, decisions = drive(roadmap)
    along = stations(roadmap, frames)
    offset = np.hypot(*(frames[:, [X, Y]] - roadmap.ego_route.pose(along)[:, :2]).T)
    assert along[-1] == pytest.approx(roadmap.destination, abs=2.5)
    assert 15 < frames[-1, TIME] < 21
    assert offset.max() < 0.3
    assert box_segment_distance(boxes(frames)[:, None], roadmap.illegal_lines[None]).min() > 0.4
    assert frames[:, SPEED].max() <= roadmap.speed_limit + 1e-6
    assert frames[:, SPEED].min() >= 0
    assert np.abs(np.diff(frames[:, ACCELERATION])).max() <= Parameters().jerk * 0.1 + 1e-9
    assert np.abs(np.diff(frames[:, STEERING])).max() <= Parameters().steering_rate * 0.1 + 1e-9
    assert roadmap is LEFT or set(decisions) <= {CRUISE, 3}


def test_curves_are_driven_as_slowly_as_their_lateral_acceleration_asks():
    frames, _ = drive(LEFT)
    along = stations(LEFT, frames)
    bounds = LEFT.ego_route.bounds
    inside = (along > bounds[1] + 1) & (along < bounds[2] - 1)
    lateral = frames[inside, SPEED] ** 2 * abs(LEFT.ego_route.lanes[1].curvature)
    assert lateral.max() < 1.1 * Parameters().lateral_acceleration


@pytest.mark.parametrize("gap", [20.0, 30.0, 45.0])
def test_it_stops_behind_a_standing_car_with_the_wanted_gap(gap):
    car = STRAIGHT.ego_route.pose(STRAIGHT.ego_start + gap)
    frames, decisions = drive(STRAIGHT, lambda _: [(*car, 0.0, 0.0)], seconds=25)
    left = frames[-1, Y] - car[1] - EGO_SIZE[0] / 2 - SEDAN[0] / 2
    assert frames[-1, SPEED] == pytest.approx(0, abs=1e-9)
    assert left == pytest.approx(Parameters().stop_gap, abs=0.3)
    assert frames[:, SPEED].min() >= -1e-12
    assert frames[:, ACCELERATION].min() >= -5
    assert decisions[-1] == STOP


def test_it_waits_before_the_junction_while_the_way_out_is_blocked():
    car = STRAIGHT.ego_route.pose(STRAIGHT.ego_route.bounds[2] + 4)
    frames, decisions = drive(STRAIGHT, lambda _: [(*car, 0.0, 0.0)], seconds=25)
    front = stations(STRAIGHT, frames)[-1] + EGO_SIZE[0] / 2
    assert frames[-1, SPEED] == pytest.approx(0, abs=1e-9)
    assert 0 <= LINE - front <= Parameters().stop_line_gap + 0.3
    assert decisions[-1] == YIELD


CROSSING = ["west-inner-straight", "east-outer-straight", "north-inner-left", "west-outer-right"]


@pytest.mark.parametrize("route", CROSSING)
@pytest.mark.parametrize("start", [20.0, 40.0, 55.0, 70.0])
def test_it_crosses_without_contact_or_standing_inside_among_crossing_traffic(route, start):
    way = STRAIGHT.routes[route]

    def npcs(time):
        return [(*way.pose(start - gap + 7 * time), 7.0, 0.0) for gap in (0.0, 15.0, 45.0)]

    frames, _ = drive(STRAIGHT, npcs)
    ego, along = boxes(frames), stations(STRAIGHT, frames)
    assert along[-1] == pytest.approx(STRAIGHT.destination, abs=2.5)
    for i, time in enumerate(frames[:, TIME]):
        for x, y, heading, *_ in npcs(time):
            other = box_corners(np.array([x, y]), np.array(heading), np.array(SEDAN))
            assert box_distance(ego[i], other) > 0.3
    inside = (along > LINE) & (along < STRAIGHT.ego_route.bounds[2])
    assert frames[inside, SPEED].min() > 1.0


def test_it_brakes_fully_when_a_car_appears_close_ahead():
    car = STRAIGHT.ego_route.pose(52.0)
    frames, _ = drive(STRAIGHT, lambda _: [(*car, 0.0, 0.0)], seconds=5, speed=11.0, station=35.0)
    assert frames[:, ACCELERATION].min() == pytest.approx(-8)
    assert frames[-1, SPEED] == pytest.approx(0, abs=1e-9)
    assert box_distance(boxes(frames)[-1], box_corners(car[:2], car[2], np.array(SEDAN))) > 0


def test_off_its_path_it_returns_without_swinging():
    frames, _ = drive(STRAIGHT, seconds=6, speed=8.0, offset=0.6)
    offset = frames[:, X] - 1.75
    assert offset[0] == pytest.approx(0.6)
    assert offset.min() > -0.1
    assert np.abs(offset[30:]).max() < 0.02
    assert np.abs(np.diff(frames[:, STEERING])).max() <= Parameters().steering_rate * 0.1 + 1e-9
