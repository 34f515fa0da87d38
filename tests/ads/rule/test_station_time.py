from functools import cache

import numpy as np
import pytest

from behavexplor.ads.road.path import ego_path, pose_on_path, project_on_path
from behavexplor.ads.rule.control import change_profile, keep_profile
from behavexplor.ads.rule.parameters import Parameters, numbers
from behavexplor.ads.rule.prediction import Box, box_on_path, lane_graph
from behavexplor.ads.rule.station_time import (
    HARD_HIGH,
    HARD_LOW,
    INTERVAL,
    LEADS,
    SOFT_HIGH,
    SOFT_LOW,
    empty_station_time,
    project_obstacles,
)
from behavexplor.data.conventions import EGO_SIZE, VEHICLE_SIZES
from behavexplor.data.geometry import box_corners, boxes_overlap
from behavexplor.envs.logical_scenarios import crossing, straight_road
from tests.ads.rule.world import SEDAN, scene
from tests.kernel_calls import called_alone

box_on_path = called_alone(box_on_path)
change_profile = called_alone(change_profile)
keep_profile = called_alone(keep_profile)
pose_on_path = called_alone(pose_on_path)
project_obstacles = called_alone(project_obstacles)
project_on_path = called_alone(project_on_path)

KEEP = keep_profile(0.0)
STRAIGHT, LEFT = crossing("straight", 20, 60), crossing("left", 10, 60)
MAPS = {"S1": STRAIGHT, "S2": LEFT, "S3": straight_road(2, 2, 10, 230), "S4": straight_road(1, 3, 10, 230)}


path_of = cache(ego_path)


@cache
def lanes_of(roadmap):
    return lane_graph(roadmap, path_of(roadmap))


def graph_of(roadmap, npcs, station=20.0):
    room = empty_station_time(max(len(npcs), 1))
    graph = lanes_of(roadmap)
    ego = (*roadmap.ego_route.pose(station), 5.0)
    path = path_of(roadmap)
    project_obstacles(path, KEEP, graph, scene(ego, npcs), station, -np.inf, numbers(Parameters()), room)
    return room


def boxes_on_route(roadmap, stations):
    poses = roadmap.ego_route.pose(stations)
    return box_corners(poses[:, :2], poses[:, 2], np.array(EGO_SIZE))


@pytest.mark.parametrize("roadmap", [STRAIGHT, LEFT], ids=["straight", "left"])
def test_the_path_is_the_center_line_of_the_route(roadmap):
    path = ego_path(roadmap)
    for station in np.linspace(0, roadmap.ego_route.length, 50):
        pose = pose_on_path(path, station)
        assert pose == pytest.approx(roadmap.ego_route.pose(station), abs=1e-9)
        assert project_on_path(path, pose[0], pose[1]) == pytest.approx((station, 0), abs=1e-6)


@pytest.mark.parametrize("size", [VEHICLE_SIZES["sedan"], VEHICLE_SIZES["school-bus"]])
def test_a_box_takes_up_the_stations_where_it_overlaps_the_strip(size):
    rng = np.random.default_rng(0)
    path, half = ego_path(STRAIGHT), 1.3
    touched = 0
    for _ in range(300):
        x, y, heading = rng.uniform(-6, 9), rng.uniform(-20, 60), rng.uniform(-np.pi, np.pi)
        low, high = box_on_path(path, KEEP, Box(x, y, np.cos(heading), np.sin(heading), *size), half)
        box = box_corners(np.array([x, y]), heading, np.array(size))
        strip = box_corners(np.array([1.75, 20.0]), np.array(0.0), np.array([2 * half, 200.0]))
        assert (low <= high) == bool(boxes_overlap(box, strip))
        if low <= high:
            touched += 1
            for station in np.linspace(low + 1e-3, high - 1e-3, 5):
                slice_ = box_corners(STRAIGHT.ego_route.pose(station)[:2], np.array(0.0), np.array([2 * half, 1e-6]))
                assert boxes_overlap(box, slice_)
    assert touched > 50


@pytest.mark.parametrize("roadmap", [STRAIGHT, LEFT], ids=["straight", "left"])
def test_no_contact_with_an_npc_of_constant_speed_is_missed(roadmap):
    rng = np.random.default_rng(1)
    stations = np.arange(25.0, 190.0, 1.5)
    egos = boxes_on_route(roadmap, stations)
    contacts = 0
    for _ in range(150):
        route = roadmap.npc_routes[rng.integers(len(roadmap.npc_routes))]
        start, speed = rng.uniform(70, 140), rng.uniform(0, 11)  # the ego stands at 20 m, behind all of them
        time = rng.uniform(0, 7.9)
        npc = route.pose(start + speed * time)
        room = graph_of(roadmap, [(*route.pose(start), speed, 0.0)])
        spans = room.spans[int(time / INTERVAL), : room.counts[int(time / INTERVAL)]]
        for station in stations[boxes_overlap(egos, box_corners(npc[:2], npc[2], np.array(SEDAN)))]:
            contacts += 1
            assert any(span[HARD_LOW] < station < span[HARD_HIGH] for span in spans), (route.name, start)
    assert contacts > 50


@pytest.mark.parametrize("name", MAPS)
@pytest.mark.parametrize("speed", [0.0, 0.2, 3.0, 11.0])
def test_on_every_route_an_npc_in_the_way_is_seen_where_it_is(name, speed):
    roadmap = MAPS[name]
    stations = np.arange(roadmap.ego_start + 8, roadmap.ego_route.length, 2.0)
    ego = boxes_on_route(roadmap, stations)
    seen = 0
    for route in roadmap.npc_routes:
        for start in np.arange(3.0, route.length - 5, 7.0):
            pose = route.pose(start)
            npc = box_corners(pose[:2], pose[2], np.array(SEDAN))
            met = stations[boxes_overlap(ego, npc)]
            if not len(met):
                continue
            seen += 1
            room = graph_of(roadmap, [(*pose, speed, 0.0)], station=roadmap.ego_start)
            now = room.spans[0, : room.counts[0]]
            for station in met:
                assert any(span[HARD_LOW] < station < span[HARD_HIGH] for span in now), (route.name, start)
    assert seen > 15


def test_in_a_lane_change_those_in_both_lanes_are_seen_and_those_behind_in_the_new_one_are_not_forgotten():
    roadmap = MAPS["S3"]
    change = change_profile(50.0, 0.0, 0.0, 3.5, 30.0)

    def spans(station, lane, speed, profile):
        x, y, heading = roadmap.ego_route.pose(station)
        observation = scene((*roadmap.ego_route.pose(50.0), 8.0), [(x, y + 3.5 * lane, heading, speed, 0.0)])
        path, graph = path_of(roadmap), lanes_of(roadmap)
        room = empty_station_time(1)
        project_obstacles(path, profile, graph, observation, 50.0, -np.inf, numbers(Parameters()), room)
        return room

    assert spans(58.0, 0, 5.0, change).spans[0, 0, LEADS] == 1
    assert spans(90.0, 1, 5.0, change).spans[0, 0, LEADS] == 1
    assert spans(90.0, 1, 5.0, KEEP).counts.max() == 0
    assert spans(90.0, 0, 0.0, change).counts.max() == 0
    behind = spans(40.0, 1, 11.0, change)
    assert behind.counts[0] == 0
    assert behind.counts.max() == 1
    assert behind.spans[20, 0, LEADS] == 0
    assert spans(40.0, 0, 11.0, change).counts.max() == 0


def test_those_ahead_lead_those_behind_are_left_out_and_those_far_aside_too():
    ahead, behind = STRAIGHT.ego_route.pose(60.0), STRAIGHT.ego_route.pose(2.0)
    aside = STRAIGHT.routes["south-outer-straight"].pose(50.0)
    assert graph_of(STRAIGHT, [(*ahead, 3.0, 0.0)]).spans[0, 0, LEADS] == 1
    assert graph_of(STRAIGHT, [(*behind, 3.0, 0.0)]).counts.max() == 0
    assert graph_of(STRAIGHT, [(*aside, 3.0, 0.0)]).counts[:8].max() == 0


def test_an_absent_npc_takes_up_nothing():
    observation = scene((1.75, 85.0, -np.pi / 2, 5.0), [(*STRAIGHT.ego_route.pose(40.0), 0.0, 0.0)])
    room = empty_station_time(1)
    graph, path = lanes_of(STRAIGHT), path_of(STRAIGHT)
    project_obstacles(path, KEEP, graph, observation, 20.0, -np.inf, numbers(Parameters()), room)
    assert room.counts.min() > 0
    observation[1, 0] = 0.0
    project_obstacles(path, KEEP, graph, observation, 20.0, -np.inf, numbers(Parameters()), room)
    assert room.counts.max() == 0


def test_what_is_said_of_all_spans_of_an_interval_holds_for_each():
    npcs = [(*STRAIGHT.routes[name].pose(station), 6.0, 0.0) for name in STRAIGHT.routes for station in (40.0, 70.0)]
    room = graph_of(STRAIGHT, npcs)
    assert room.counts.max() > 2
    for count, spans, (least, greatest) in zip(room.counts, room.spans, room.reaches, strict=True):
        now = spans[:count]
        assert least == now[:, [HARD_LOW, SOFT_LOW]].min(initial=np.inf)
        assert greatest == now[:, [HARD_HIGH, SOFT_HIGH]].max(initial=-np.inf)
