"""Commands: the circle that leads back to the path, within the vehicle's limits."""

import math

import numpy as np
import pytest

from behavexplor.ads.road.path import ego_path, point_beside, pose_on_path
from behavexplor.ads.rule.control import PERIOD, accelerate, change_profile, keep_profile, offset_at, steer
from behavexplor.ads.rule.parameters import Parameters, numbers
from behavexplor.ads.scene_io import ACCELERATION_RANGE, STEERING_RANGE
from behavexplor.data.conventions import EGO_SIZE
from behavexplor.envs.logical_scenarios import crossing, straight_road
from tests.ads.rule.world import memory_with, scene
from tests.kernel_calls import called_alone

accelerate = called_alone(accelerate)
change_profile = called_alone(change_profile)
keep_profile = called_alone(keep_profile)
offset_at = called_alone(offset_at)
point_beside = called_alone(point_beside)
pose_on_path = called_alone(pose_on_path)
steer = called_alone(steer)

AT_ONCE = Parameters(steering_rate=1e3)  # no limit of the change
PATHS = {"road": ego_path(straight_road(2, 2, 10, 230)), "turn": ego_path(crossing("left", 10, 60))}


def command(path, profile, pose, speed, station, parameters=AT_ONCE, last=0.0):
    memory = memory_with(last_steering=last)
    bits = np.zeros(2, np.int64)
    return steer(path, profile, scene((*pose, speed)), station, memory, bits, numbers(parameters))


def nearest_approach(pose, steering, point, steps=20000):
    """How close highway-env's bicycle model comes to a point with a steering angle that is held [m]."""
    slip = math.atan(0.5 * math.tan(steering))
    length = 1e-3 * np.arange(steps)
    headings = pose[2] + slip + length * math.sin(slip) / (EGO_SIZE[0] / 2)
    x = pose[0] + np.cumsum(np.cos(headings)) * 1e-3
    y = pose[1] + np.cumsum(np.sin(headings)) * 1e-3
    return np.hypot(x - point[0], y - point[1]).min()


@pytest.mark.parametrize("name", PATHS)
@pytest.mark.parametrize(
    "profile", [keep_profile(0.0), change_profile(88.0, 0.3, 0.0, 3.5, 25.0)], ids=["keep", "change"]
)
def test_the_circle_leads_through_a_point_ahead_on_the_path(name, profile):
    path, p = PATHS[name], AT_ONCE
    rng = np.random.default_rng(3)
    for _ in range(12):
        station, speed = rng.uniform(80.0, 120.0), rng.uniform(1.0, 8.0)
        _, _, along = pose_on_path(path, station)
        offset = offset_at(profile, station) + rng.uniform(-0.3, 0.3)
        pose = (*point_beside(path, station, offset), along + rng.uniform(-0.1, 0.1))
        there = station + p.look_ahead + p.look_ahead_time * speed
        steering = command(path, profile, pose, speed, station)
        assert STEERING_RANGE[0] < steering < STEERING_RANGE[1]
        assert nearest_approach(pose, steering, point_beside(path, there, offset_at(profile, there))) < 0.01


@pytest.mark.parametrize("side", [-1, 1])
def test_steering_changes_no_faster_than_it_can_and_not_beyond_its_range(side):
    path, p = PATHS["road"], Parameters()
    x, y, heading = pose_on_path(path, 50.0)
    off = (*point_beside(path, 50.0, -side * 4.0), heading)
    first = command(path, keep_profile(0.0), off, 3.0, 50.0, p)
    assert first == pytest.approx(side * p.steering_rate * PERIOD)
    later = command(path, keep_profile(0.0), off, 3.0, 50.0, p, last=side * STEERING_RANGE[1])
    assert later == pytest.approx(side * STEERING_RANGE[1])
    assert command(path, keep_profile(0.0), (x, y, heading), 3.0, 50.0, p) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ("wanted", "last", "speed", "at_once", "expected"),
    [
        (2.0, 0.0, 5.0, False, 1.0),
        (-3.0, 0.0, 5.0, False, -1.0),
        (-3.0, 0.0, 5.0, True, -3.0),
        (-20.0, -8.0, 5.0, True, ACCELERATION_RANGE[0]),
        (9.0, 4.0, 5.0, False, ACCELERATION_RANGE[1]),
        (-8.0, -8.0, 0.2, True, -2.0),
        (-8.0, -8.0, 0.0, True, 0.0),
        (0.5, 0.0, 0.0, False, 0.5),
    ],
)
def test_acceleration_changes_within_its_limits_and_never_leads_into_reverse(wanted, last, speed, at_once, expected):
    assert accelerate(wanted, last, speed, at_once, numbers(Parameters())) == pytest.approx(expected)
