"""Decisions become commands that keep to lanes, limits and the road."""

import numpy as np
import pytest

from behavexplor.ads.learned.deciding import (
    ACCELERATIONS,
    HOME,
    KEEP,
    LEFT,
    N_MEMORIES,
    PERIOD,
    RIGHT,
    SIDEWAYS,
    WANTED,
    begin,
    track,
)
from behavexplor.ads.scene_io import STEERING_RANGE
from tests.ads.learned.scenes import COURSES, LOGICALS, ego
from tests.kernel_calls import called_alone

begin = called_alone(begin)
track = called_alone(track)

BRAKE, COAST, GO = -6.0, 0.0, 2.0  # accelerations


def started(name, vehicle):
    scene, memory = np.array([vehicle]), np.zeros(N_MEMORIES)
    begin(COURSES[name], scene, memory)
    return scene, memory


def drive(name, vehicle, decide, steps):
    """Where the ego comes with highway-env's bicycle model, its commands held for each period."""
    scene, memory = started(name, vehicle)
    driven = []
    for step in range(steps):
        acceleration, steering = track(COURSES[name], scene, *decide(step), memory)
        assert STEERING_RANGE[0] <= steering <= STEERING_RANGE[1]
        for _ in range(4):
            _, x, y, heading, speed, *_ = scene[0]
            slip = np.arctan(np.tan(steering) / 2)
            x, y = x + speed * np.cos(heading + slip) * PERIOD / 4, y + speed * np.sin(heading + slip) * PERIOD / 4
            heading += speed * np.sin(slip) / (scene[0, 6] / 2) * PERIOD / 4
            scene[0, 1:5] = x, y, heading, speed + acceleration * PERIOD / 4
        driven.append(
            (*LOGICALS[name].roadmap.ego_route.project(scene[0, 1], scene[0, 2]), scene[0, 4], memory[WANTED])
        )
    return np.array(driven)


@pytest.mark.parametrize("name", ["intersection-straight", "intersection-left", "lane-follow"])
def test_it_keeps_to_its_route_and_its_limits(name):
    roadmap = LOGICALS[name].roadmap
    driven = drive(name, ego(name, roadmap.ego_start), lambda _: (GO, KEEP), 160)
    there = driven[:, 0] < roadmap.destination
    assert driven[-1, 0] > roadmap.destination
    assert np.abs(driven[there, 1]).max() < 0.5
    assert driven[:, 2].max() <= roadmap.speed_limit + 1e-9


def test_it_comes_from_where_it_stands_to_the_lane_of_its_route():
    roadmap = LOGICALS["lane-change"].roadmap
    driven = drive("lane-change", ego("lane-change", roadmap.ego_start, roadmap.ego_offset), lambda _: (GO, KEEP), 100)
    assert driven[0, 1] < -6.9
    assert np.abs(driven[-20:, 1]).max() < 0.3
    assert np.diff(driven[:, 1]).max() < SIDEWAYS * PERIOD * 1.5


def test_a_lane_change_ends_in_the_middle_of_the_next_lane():
    driven = drive(
        "lane-follow", ego("lane-follow", 20.0, speed=8.0), lambda step: (COAST, LEFT if step == 5 else KEEP), 60
    )
    assert driven[-1, 1] == pytest.approx(-3.5, abs=0.1)
    assert driven[:, 1].min() > -4.0


@pytest.mark.parametrize(
    ("side", "offset", "wanted"), [(LEFT, -7.0, 0.0), (RIGHT, 3.5, 0.0), (LEFT, 3.5, 0.0), (RIGHT, -7.0, -3.5)]
)
def test_a_change_leads_to_a_lane_that_is_there(side, offset, wanted):
    scene, memory = started("lane-follow", ego("lane-follow", 50.0, offset, speed=8.0))
    track(COURSES["lane-follow"], scene, COAST, side, memory)
    assert memory[WANTED] == pytest.approx(wanted)


@pytest.mark.parametrize("offset", [-7.0, -3.5, 0.0, 3.5])
def test_there_is_a_way_home_from_every_lane(offset):
    driven = drive("lane-follow", ego("lane-follow", 20.0, offset, 9.0), lambda _: (COAST, HOME), 60)
    assert driven[-1, 1] == pytest.approx(0.0, abs=0.1)
    assert driven[-1, 3] == 0.0


def test_near_the_junction_it_takes_the_lane_of_its_route():
    course = COURSES["intersection-straight"]
    before = course.path.junction_start - 10
    scene, memory = started("intersection-straight", ego("intersection-straight", before, 3.5, 5.0))
    memory[WANTED] = 3.5
    track(course, scene, COAST, RIGHT, memory)
    assert memory[WANTED] == 0.0


@pytest.mark.parametrize("speed", [0.0, 0.4, 3.0, 11.0])
def test_it_never_drives_backwards(speed):
    scene, memory = started("lane-follow", ego("lane-follow", 50.0, speed=speed))
    acceleration, _ = track(COURSES["lane-follow"], scene, BRAKE, KEEP, memory)
    assert acceleration == pytest.approx(max(-6.0, -speed / PERIOD))


def test_a_wanted_acceleration_is_reached():
    for wanted in ACCELERATIONS:
        scene, memory = started("lane-follow", ego("lane-follow", 50.0, speed=6.0))
        acceleration, _ = track(COURSES["lane-follow"], scene, wanted, KEEP, memory)
        assert acceleration == wanted
