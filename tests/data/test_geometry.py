"""Distances and overlaps against shapely."""

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from behavexplor.data.geometry import (
    box_corners,
    box_distance,
    box_segment_distance,
    boxes_overlap,
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


@given(boxes, points, points)
def test_box_segment_distance_is_shapelys(box, start, end):
    box, segment = corners(box), np.array([start, end])
    expected = shapely.Polygon(box).distance(shapely.LineString(segment))
    assert float(box_segment_distance(box, segment)) == pytest.approx(expected, abs=1e-9)


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
    assert float(box_segment_distance(corners(((0, 0), 0.0, (4, 2))), segment)) == 0


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
