"""Distances and overlaps against shapely."""

import numpy as np
import pytest
import shapely
from hypothesis import assume, given
from hypothesis import strategies as st

from behavexplor.data.geometry import (
    box_corners,
    box_distance,
    boxes_overlap,
    changed_frames,
    distances_from_first,
    distances_from_segments,
    gaps_from_lines,
    near_segments,
    point_box_distance,
    point_segment_distances,
    project_on_polyline,
)

coordinates = st.integers(-30_000_000, 30_000_000).map(lambda micrometers: micrometers / 1e6)
boxes = st.tuples(
    st.tuples(coordinates, coordinates), st.floats(-7, 7), st.tuples(st.floats(0.5, 10), st.floats(0.5, 4))
)
points = st.tuples(coordinates, coordinates)


def corners(box):
    position, heading, size = box
    return box_corners(np.array(position), np.array(heading), np.array(size))


def test_corners_of_a_turned_box():
    quarter_turn = box_corners(np.array([10.0, 20.0]), np.array(np.pi / 2), np.array([4.0, 2.0]))
    assert quarter_turn == pytest.approx(np.array([[9, 22], [11, 22], [11, 18], [9, 18]]))


@given(points, boxes)
def test_point_box_distance_is_shapelys(point, box):
    position, heading, size = map(np.array, box)
    expected = shapely.Polygon(corners(box)).distance(shapely.Point(point))
    assert float(point_box_distance(np.array(point), position, heading, size)) == pytest.approx(expected, abs=1e-9)


@given(boxes, boxes)
def test_box_distance_is_shapelys(a, b):
    a, b = corners(a), corners(b)
    expected = shapely.Polygon(a).distance(shapely.Polygon(b))
    assert float(box_distance(a, b)) == pytest.approx(expected, abs=1e-9)


def segment_distance(box, segment):
    """Return the distance of one box from one segment."""
    position, heading, size = box
    poses = np.array([position], dtype=float), np.array([heading], dtype=float), np.array(size, dtype=float)
    return distances_from_segments(*poses, segment[None], np.array([0])).item()


@given(boxes, points, points)
def test_distance_from_a_segment_is_shapelys(box, start, end):
    segment = np.array([start, end])
    expected = shapely.Polygon(corners(box)).distance(shapely.LineString(segment))
    assert segment_distance(box, segment) == pytest.approx(expected, abs=1e-9)


def random_motion(seed, frames, vehicles):
    rng = np.random.default_rng(seed)
    position, heading = rng.normal(0, 4, (frames, vehicles, 2)), rng.normal(0, 3, (frames, vehicles))
    return position, heading, rng.uniform(1, 5, (vehicles, 2))


@pytest.mark.parametrize("seed", range(5))
def test_distances_from_the_first_vehicle_are_those_of_the_boxes(seed):
    position, heading, size = random_motion(seed, 30, 4)
    frame, vehicle = np.divmod(np.arange(90), 3)
    all_corners = box_corners(position, heading, size)
    expected = box_distance(all_corners[frame, 0], all_corners[frame, vehicle + 1])
    assert np.array_equal(distances_from_first(position, heading, size, frame, vehicle + 1), expected)
    assert 0 < np.count_nonzero(expected == 0) < 90


@pytest.mark.parametrize("seed", range(5))
def test_pairs_that_are_left_out_are_not_the_nearest(seed):
    rng = np.random.default_rng(seed)
    points, segments = np.cumsum(rng.normal(0, 1, (50, 2)), axis=0), rng.normal(0, 20, (6, 2, 2))
    heading, size = rng.normal(0, 3, 50), np.array([5.0, 2.0])
    point, segment = np.divmod(np.arange(300), 6)
    exact = distances_from_segments(points[point], heading[point], size, segments, segment).reshape(50, 6)
    found_point, found_segment, upper = near_segments(points, segments, np.hypot(5, 2) / 2, 1.0)
    assert 0 < len(found_point) < 300
    assert len(set(zip(found_point.tolist(), found_segment.tolist(), strict=True))) == len(found_point)
    assert exact[found_point, found_segment].min() == exact.min() <= upper


@given(boxes, points, points)
def test_gap_from_a_line_bounds_the_distance_from_its_segments(box, start, end):
    assume(np.hypot(*np.subtract(end, start)) > 1e-3)
    position, heading, size = box
    segment = np.array([[start, end]])
    poses = np.array([position], dtype=float), np.array([heading]), np.array(size)
    gap = gaps_from_lines(*poses, segment, np.array([0])).item()
    line = shapely.LineString(np.array(start) + np.subtract(end, start)[None] * [[-1e6], [1e6]])
    assert max(gap, 0.0) == pytest.approx(shapely.Polygon(corners(box)).distance(line), abs=1e-5)


def test_frames_in_which_the_first_vehicle_changes():
    position, heading = np.zeros((6, 2, 2)), np.zeros((6, 2))
    position[2:, 0, 0] = 1.0
    heading[4:, 0] = 0.1
    position[5, 1] = 3.0  # another vehicle
    assert changed_frames(position, heading).tolist() == [0, 2, 4]


@given(points, points, points)
def test_point_segment_distance_is_shapelys(point, start, end):
    expected = shapely.Point(point).distance(shapely.LineString([start, end]))
    found = point_segment_distances(np.array([point]), np.array([[start, end]]))
    assert found.item() == pytest.approx(expected, abs=1e-9)


def test_a_box_inside_another_is_at_distance_zero():
    outer, inner = corners(((0, 0), 0.3, (10, 4))), corners(((0.5, 0.1), 1.0, (1, 1)))
    assert boxes_overlap(outer, inner)
    assert float(box_distance(outer, inner)) == 0


def test_a_segment_inside_a_box_is_at_distance_zero():
    segment = np.array([[-0.5, 0.0], [0.5, 0.1]])
    assert segment_distance(((0, 0), 0.0, (4, 2)), segment) == 0


def test_boxes_that_only_touch_overlap():
    left, right = corners(((0, 0), 0.0, (4, 2))), corners(((4, 0), 0.0, (4, 2)))
    assert boxes_overlap(left, right)
    assert not boxes_overlap(left, right + np.array([1e-6, 0.0]))


def test_distances_broadcast_over_leading_axes():
    rng = np.random.default_rng(0)
    a = box_corners(rng.normal(0, 9, (5, 1, 2)), rng.normal(0, 1, (5, 1)), np.array([4.0, 2.0]))
    b = box_corners(rng.normal(0, 9, (5, 3, 2)), rng.normal(0, 1, (5, 3)), np.array([4.0, 2.0]))
    table = box_distance(a, b)
    assert table.shape == (5, 3)
    assert table[2, 1] == box_distance(a[2, 0], b[2, 1])


def test_projection_on_a_bent_polyline():
    polyline = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0]])
    station, heading = project_on_polyline(np.array([[4.0, 1.0], [12.0, 5.0], [20.0, 30.0]]), polyline)
    assert station == pytest.approx([4, 15, 20])
    assert heading == pytest.approx([0, np.pi / 2, np.pi / 2])


@pytest.mark.parametrize("seed", range(10))
def test_the_nearest_vertex_is_found_on_any_polyline(seed):
    rng = np.random.default_rng(seed)
    turns = np.cumsum(rng.normal(0, 0.3 if seed % 2 else 0.0, 200))  # winding, or straight
    polyline = np.cumsum(np.column_stack([np.cos(turns), np.sin(turns)]), axis=0)
    points = polyline[rng.integers(0, 200, 300)] + rng.normal(0, 1 + 5 * (seed % 3), (300, 2))
    station, _ = project_on_polyline(points, polyline)
    vertex = np.hypot(*(points[:, None] - polyline).T).T.argmin(1)
    for point, nearest, found in zip(points, vertex, station, strict=True):
        around = np.clip(np.arange(nearest - 2, nearest + 2), 0, 198)
        places = [shapely.LineString(polyline[i : i + 2]) for i in around]
        best = min(range(4), key=lambda i: places[i].distance(shapely.Point(point)))
        assert found == pytest.approx(around[best] + places[best].project(shapely.Point(point)), abs=1e-6)
