import numpy as np
import pytest

from behavexplor.ads.road.lane_arrays import (
    CURVATURE,
    is_far_from_arc,
    is_near_center_line,
    lane_array,
    offset_on_lane,
    pose_on_lane,
    project_on_lane,
)
from behavexplor.envs.functional import IntersectionStraightEnv
from tests.kernel_calls import called_alone

is_far_from_arc = called_alone(is_far_from_arc)
is_near_center_line = called_alone(is_near_center_line)
offset_on_lane = called_alone(offset_on_lane)
pose_on_lane = called_alone(pose_on_lane)
project_on_lane = called_alone(project_on_lane)

LOGICAL = IntersectionStraightEnv.logical

LANES = LOGICAL.roadmap.lanes
ARRAY = lane_array(LANES)


@pytest.mark.parametrize("index", range(len(LANES)))
def test_poses_are_those_of_the_map(index):
    for station in (-2.0, 0.0, 7.3, LANES[index].length + 3):
        assert pose_on_lane(ARRAY, index, station) == pytest.approx(LANES[index].pose(station), abs=1e-9)


@pytest.mark.parametrize("index", range(len(LANES)))
def test_projection_is_the_inverse_of_the_pose_with_an_offset_to_the_right(index):
    for station in (0.5, 6.0, 0.9 * LANES[index].length):
        x, y, heading = LANES[index].pose(station)
        for offset in (-2.5, 0.0, 1.2):
            point = x - offset * np.sin(heading), y + offset * np.cos(heading)
            assert project_on_lane(ARRAY, index, *point) == pytest.approx((station, offset), abs=1e-9)


@pytest.mark.parametrize("index", range(len(LANES)))
def test_the_offset_alone_is_that_of_the_projection_to_the_last_bit(index):
    for x, y in np.random.default_rng(index).uniform(-60, 60, size=(50, 2)):
        assert offset_on_lane(ARRAY, index, x, y) == project_on_lane(ARRAY, index, x, y)[1]


@pytest.mark.parametrize("index", np.flatnonzero(ARRAY[:, CURVATURE]))
def test_a_point_is_far_from_an_arc_if_its_offset_is_large(index):
    rng = np.random.default_rng(index)
    for x, y in rng.uniform(-60, 60, size=(50, 2)):
        offset = abs(offset_on_lane(ARRAY, index, x, y))
        for gap in (offset, offset - 1e-5, offset + 1e-5, rng.uniform(0, 60)):
            assert is_far_from_arc(ARRAY, index, x, y, gap) == (offset > gap + 1e-6)


@pytest.mark.parametrize("index", range(len(LANES)))
def test_whether_a_point_is_near_is_what_its_offset_says(index):
    """Gaps at the offset itself and around it, within and beyond the margin of the quick test for curves."""
    rng = np.random.default_rng(index)
    for _ in range(50):
        point = rng.uniform(-80, 80, 2)
        offset = abs(offset_on_lane(ARRAY, index, *point))
        for gap in (offset, *(offset + side * step for side in (-1, 1) for step in (1e-7, 1e-5, 1.0))):
            assert is_near_center_line(ARRAY, index, *point, gap) == (offset <= gap)
