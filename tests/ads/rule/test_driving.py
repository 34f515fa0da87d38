"""The planner in closed loop: what a person would expect of a careful driver."""

import numpy as np
import pytest

from behavexplor.ads.rule import Parameters
from behavexplor.ads.rule.decision import CREEP, CRUISE, STOP, YIELD
from behavexplor.ads.rule.lane_choice import ABORT
from behavexplor.data.conventions import EGO_SIZE
from behavexplor.data.geometry import box_corners, box_distance, distances_from_segments, project_on_polyline
from behavexplor.envs.logical_scenarios import crossing, straight_road
from tests.ads.rule.world import SEDAN, drive

STRAIGHT, LEFT = crossing("straight", 20, 60), crossing("left", 10, 60)
TIME, X, Y, HEADING, SPEED, ACCELERATION, STEERING = range(7)
LINE = STRAIGHT.ego_route.bounds[1]


def stations(roadmap, frames):
    line = roadmap.ego_route.polyline(0.0, roadmap.ego_route.length, 0.02)
    return project_on_polyline(frames[:, [X, Y]], line)[0]


def standing(roadmap, station, lane=0):
    """Pose in a lane counted from the route's to the right."""
    x, y, heading = roadmap.ego_route.pose(station)
    return x - 3.5 * lane * np.sin(heading), y + 3.5 * lane * np.cos(heading), heading


def boxes(frames):
    return box_corners(frames[:, [X, Y]], frames[:, HEADING], np.array(EGO_SIZE))


def line_distance(frames, roadmap):
    """Return the least distance of the ego from an illegal line."""
    lines = roadmap.illegal_lines
    frame, line = np.divmod(np.arange(len(frames) * len(lines)), len(lines))
    poses = frames[frame][:, [X, Y]], frames[frame, HEADING]
    return distances_from_segments(*poses, np.array(EGO_SIZE, dtype=float), lines, line).min()


@pytest.mark.parametrize("roadmap", [STRAIGHT, LEFT], ids=["straight", "left"])
def test_alone_it_arrives_on_its_center_line_within_all_limits(roadmap):
    frames, decisions = drive(roadmap)
    along = stations(roadmap, frames)
    offset = np.hypot(*(frames[:, [X, Y]] - roadmap.ego_route.pose(along)[:, :2]).T)
    assert along[-1] == pytest.approx(roadmap.destination, abs=2.5)
    assert 15 < frames[-1, TIME] < 21
    assert offset.max() < 0.3
    assert line_distance(frames, roadmap) > 0.4
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
def test_it_stops_behind_a_standing_car_when_the_lane_beside_is_taken_too(gap):
    cars = [(*standing(STRAIGHT, STRAIGHT.ego_start + gap, lane), 0.0, 0.0) for lane in (0, 1)]
    frames, decisions = drive(STRAIGHT, lambda _: cars, seconds=18)
    left = frames[-1, Y] - cars[0][1] - EGO_SIZE[0] / 2 - SEDAN[0] / 2
    assert frames[-1, SPEED] == pytest.approx(0, abs=1e-9)
    assert left == pytest.approx(Parameters().stop_gap, abs=0.3)
    assert frames[:, SPEED].min() >= -1e-12
    assert frames[:, ACCELERATION].min() >= -5
    assert decisions[-1] == STOP


def test_after_a_long_wait_it_creeps_so_that_it_never_stands_for_ever():
    cars = [(*standing(STRAIGHT, LINE + 5, lane), 0.0, 0.0) for lane in (0, 1)]
    frames, decisions = drive(STRAIGHT, lambda _: cars, seconds=90)
    stops = np.flatnonzero(frames[:, SPEED] > 0.3)
    assert CREEP in decisions
    assert np.diff(stops).max() < 300
    front = stations(STRAIGHT, frames)[-1] + EGO_SIZE[0] / 2
    assert front < LINE + Parameters().line_overrun


@pytest.mark.parametrize("speed", [0.0, 1.0, 4.0])
@pytest.mark.parametrize("lanes", [(2, 2), (3, 3), (1, 3)], ids=["lane 3", "lane 4", "lane 2 to 4"])
def test_it_overtakes_a_slow_car_and_is_back_in_time(speed, lanes):
    roadmap = straight_road(*lanes, 10, 230)

    def car(time):
        return [(*standing(roadmap, 45 + speed * time, lanes[0] - lanes[1]), speed, 0.0)]

    frames, _ = drive(roadmap, car, seconds=60)
    assert np.hypot(*(frames[-1, [X, Y]] - roadmap.destination_point)) < 2.5
    assert frames[-1, TIME] < 35
    assert line_distance(frames, roadmap) > 0.3
    for frame, ego in zip(frames, boxes(frames), strict=True):
        x, y, heading, *_ = car(frame[TIME])[0]
        assert box_distance(ego, box_corners(np.array([x, y]), np.array(heading), np.array(SEDAN))) > 0.2


def test_it_waits_behind_a_slow_car_where_there_is_no_room_to_come_back():
    roadmap = straight_road(2, 2, 10, 230)
    frames, _ = drive(
        roadmap, lambda time: [(*standing(roadmap, 222 + 0.8 * time, 0), 0.8, 0.0)], station=185.0, seconds=40
    )
    assert np.abs(frames[:, Y] - roadmap.destination_point[1]).max() < 0.05
    assert np.hypot(*(frames[-1, [X, Y]] - roadmap.destination_point)) < 2.5


def test_it_does_not_change_lanes_into_the_way_of_a_faster_car():
    roadmap = straight_road(2, 3, 10, 230)

    def npcs(time):
        return [(*standing(roadmap, 10 - gap + 11 * time, 0), 11.0, 0.0) for gap in (20.0, 50.0)]

    frames, _ = drive(roadmap, npcs, seconds=50)
    assert np.hypot(*(frames[-1, [X, Y]] - roadmap.destination_point)) < 2.5
    for frame, ego in zip(frames, boxes(frames), strict=True):
        for x, y, heading, *_ in npcs(frame[TIME]):
            assert box_distance(ego, box_corners(np.array([x, y]), np.array(heading), np.array(SEDAN))) > 0.5


def test_it_aborts_a_lane_change_when_a_car_comes_up_suddenly():
    roadmap = straight_road(2, 3, 10, 230)

    def npcs(time):  # as fast as the ego at first, then it accelerates past
        since = max(time - 0.3, 0.0)
        gained = 2 * since**2 if since < 0.5 else 0.5 + 2 * (since - 0.5)
        return [
            (*standing(roadmap, 21.8 + 9 * time + gained, 0), 9 + min(4 * since, 2.0), 4.0 if 0 < since < 0.5 else 0.0)
        ]

    frames, _, state = drive(roadmap, npcs, seconds=50, speed=9.0, station=30.0, states=True)
    assert ABORT in state["manoeuvre"]
    for frame, ego in zip(frames, boxes(frames), strict=True):
        x, y, heading, *_ = npcs(frame[TIME])[0]
        assert box_distance(ego, box_corners(np.array([x, y]), np.array(heading), np.array(SEDAN))) > 0.0
    assert np.hypot(*(frames[-1, [X, Y]] - roadmap.destination_point)) < 2.5


def test_it_waits_before_the_junction_while_the_way_out_is_blocked():
    cars = [(*standing(STRAIGHT, STRAIGHT.ego_route.bounds[2] + 4, lane), 0.0, 0.0) for lane in (0, 1)]
    frames, decisions = drive(STRAIGHT, lambda _: cars, seconds=20)
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
