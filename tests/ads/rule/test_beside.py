"""Vehicles beside the ego's path, against the boxes that they take up on it."""

import math

import numpy as np
import pytest

from behavexplor.ads.road.lane_arrays import LENGTH, direction_on_lane
from behavexplor.ads.road.path import ego_path
from behavexplor.ads.rule.control import LateralProfile, keep_profile
from behavexplor.ads.rule.prediction import Box, box_on_path, is_beside, lane_graph
from behavexplor.data.conventions import VEHICLE_SIZES
from behavexplor.envs.logical_scenarios import crossing, straight_road
from tests.kernel_calls import called_alone

box_on_path = called_alone(box_on_path)
direction_on_lane = called_alone(direction_on_lane)
is_beside = called_alone(is_beside)
keep_profile = called_alone(keep_profile)

MAPS = {
    "S1": crossing("straight", 20, 60),
    "S2": crossing("left", 10, 60),
    "S3": straight_road(2, 2, 10, 230),
    "S4": straight_road(1, 3, 10, 230),
}
HALF_STRIP = 1.3


def random_profile(rng):
    first, last = 3.5 * rng.integers(-1, 2, 2)
    if first == last:
        return keep_profile(last)
    return LateralProfile(rng.uniform(0, 200), rng.uniform(15, 40), first, rng.uniform(-0.1, 0.1), last)


@pytest.mark.parametrize("name", MAPS)
def test_no_vehicle_that_is_beside_the_path_takes_up_a_stretch_of_it(name):
    roadmap, rng = MAPS[name], np.random.default_rng(0)
    path = ego_path(roadmap)
    graph = lane_graph(roadmap, path)
    sizes = list(VEHICLE_SIZES.values())
    is_near = ~np.isposinf(graph.beside[:-1, 0, 0])
    beside, taken = 0, 0
    for _ in range(4000):
        lane = rng.choice(np.flatnonzero(is_near))
        station, profile = rng.uniform(0, graph.lanes[lane, LENGTH] + 100), random_profile(rng)
        size = sizes[rng.integers(len(sizes))]
        stretch = box_on_path(path, profile, Box(*direction_on_lane(graph.lanes, lane, station), *size), HALF_STRIP)
        if is_beside(graph.beside[lane, int(station)], profile, *size, HALF_STRIP):
            beside += 1
            assert stretch == (math.inf, -math.inf)
        taken += stretch[0] <= stretch[1]
    assert beside > 1000
    assert taken > 200
