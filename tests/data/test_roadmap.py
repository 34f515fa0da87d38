"""Lanes, routes and the map of the crossing."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from behavexplor.data.roadmap import CURB, DOUBLE_YELLOW, Lane, Route
from behavexplor.envs.functional import IntersectionStraightEnv
from behavexplor.envs.logical_scenarios import crossing

LOGICAL = IntersectionStraightEnv.logical

ROADMAP = LOGICAL.roadmap


def test_pose_along_an_arc():
    radius = 10.0
    lane = Lane("arc", "a", "b", 0.0, 0.0, 0.0, radius * math.pi / 2, 3.5, curvature=1 / radius)
    quarter = lane.pose([0.0, lane.length])
    assert quarter == pytest.approx(np.array([[0, 0, 0], [radius, radius, math.pi / 2]]))


def test_routes_are_continued_beyond_their_ends():
    route = Route("r", (Lane("a", "0", "1", 0, 0, 0, 10, 3.5), Lane("b", "1", "2", 10, 0, 0, 5, 3.5)))
    assert route.pose([-2.0, 4.0, 10.0, 17.0])[:, 0] == pytest.approx([-2, 4, 10, 17])
    assert route.length == 15


@pytest.mark.parametrize("route", ROADMAP.npc_routes, ids=lambda route: route.name)
def test_routes_are_smooth(route):
    assert route.lanes[0].name.endswith(route.name.split("-")[1])
    for before, after in zip(route.lanes[:-1], route.lanes[1:], strict=True):
        assert before.target == after.origin
        jump = before.pose(before.length) - after.pose(0.0)
        assert jump[:2] == pytest.approx([0, 0], abs=1e-9)
        assert math.remainder(jump[2], 2 * math.pi) == pytest.approx(0, abs=1e-9)
    headings = route.pose(np.arange(0, route.length, 0.5))[:, 2]
    turned = math.remainder(headings[-1] - headings[0], 2 * math.pi)
    assert turned == pytest.approx(
        {"left": -math.pi / 2, "straight": 0, "right": math.pi / 2}[route.name.split("-")[2]]
    )


def test_lengths_are_those_of_the_paper_s_map():
    lengths = {lane.name.split("-")[2]: lane.length for lane in ROADMAP.lanes if lane.junction}
    assert 28 <= lengths["straight"] <= 31
    assert 26 <= lengths["left"] <= 29
    assert 14 <= lengths["right"] <= 18
    assert 150 <= ROADMAP.destination - ROADMAP.ego_start <= 170
    assert len(ROADMAP.routes) == 16


@pytest.mark.parametrize("movement", ["straight", "left"])
def test_the_ego_s_route_touches_no_illegal_line(movement):
    roadmap = crossing(movement, 20.0, 60.0)
    route = roadmap.ego_route.polyline(roadmap.ego_start, roadmap.destination, spacing=0.5)
    for start, end in roadmap.illegal_lines:
        along = (end - start) / np.hypot(*(end - start))
        ahead = np.clip((route - start) @ along, 0, np.hypot(*(end - start)))
        assert np.hypot(*(route - start - ahead[:, None] * along).T).min() > 1.03 + 0.6


def test_double_yellow_lines_part_the_directions_and_curbs_bound_the_road():
    kinds = np.array(ROADMAP.line_kinds)
    yellow, curbs = ROADMAP.illegal_lines[kinds == DOUBLE_YELLOW], ROADMAP.illegal_lines[kinds == CURB]
    assert len(yellow) == 4
    assert (np.abs(yellow).min(axis=2) == 0).all()  # on the axes
    assert np.abs(yellow).max(axis=2).min() == 15  # from the stop lines outwards
    corner_gaps = np.hypot(np.abs(curbs[..., 0]) - 15, np.abs(curbs[..., 1]) - 15)
    assert corner_gaps.min() == pytest.approx(8)  # rounded corners
    assert np.abs(curbs).min() == pytest.approx(7)


def test_the_destination_lies_on_the_exit_lane():
    assert ROADMAP.destination_point == pytest.approx([1.75, -75.0])
    assert ROADMAP.start_pose == pytest.approx([1.75, 85.0, -math.pi / 2])


@given(st.sampled_from(ROADMAP.npc_routes), st.floats(0, 1), st.floats(-3, 3))
def test_projection_is_the_inverse_of_the_pose(route, share, offset):
    station = share * route.length
    x, y, heading = route.pose(station)
    found = route.project(x - offset * math.sin(heading), y + offset * math.cos(heading))
    assert found == pytest.approx((station, offset), abs=1e-6)


def test_projection_beyond_the_ends_of_a_route():
    route = ROADMAP.routes["south-inner-straight"]
    x, y, _ = route.pose(-12.0)
    assert route.project(x, y) == pytest.approx((-12, 0), abs=1e-9)
    x, y, _ = route.pose(route.length + 7.5)
    assert route.project(x, y) == pytest.approx((route.length + 7.5, 0), abs=1e-9)
