"""The tables of a course agree with the map."""

import numpy as np
import pytest
from shapely import LineString, Polygon

from behavexplor.ads.learned.observation import lanes_beside
from behavexplor.ads.learned.route_table import CAR, END, IN, OUT, SIDE_GAP, START
from behavexplor.ads.road.path import SPACING, row_at
from behavexplor.data.conventions import EGO_SIZE
from behavexplor.data.geometry import box_corners
from tests.ads.learned.scenes import COURSES, LOGICALS
from tests.kernel_calls import called_alone

lanes_beside = called_alone(lanes_beside)
row_at = called_alone(row_at)

EVERYWHERE = pytest.mark.parametrize("name", COURSES)


@EVERYWHERE
def test_speed_limits_can_be_kept_by_gentle_braking(name):
    limit = COURSES[name].path.limits
    assert (limit <= LOGICALS[name].roadmap.speed_limit).all()
    assert (limit[:-1] ** 2 - limit[1:] ** 2 <= 2 * 2.0 * SPACING + 1e-9).all()
    curved = COURSES[name].curvature != 0
    assert (limit[curved] ** 2 * np.abs(COURSES[name].curvature[curved]) <= 2.5 + 1e-9).all()


@pytest.mark.parametrize(
    ("name", "station", "left", "right"),
    [
        ("lane-follow", 50.0, 2, 1),
        ("lane-change", 50.0, 3, 0),
        ("intersection-straight", 50.0, 0, 1),
        ("intersection-straight", 89.9, 0, 1),
        ("intersection-straight", 90.0, 0, 0),
        ("intersection-straight", 119.9, 0, 0),
        ("intersection-straight", 120.0, 0, 1),
        ("intersection-left", 150.0, 0, 1),
    ],
)
def test_lanes_beside_the_route_are_counted(name, station, left, right):
    row = row_at(COURSES[name].path, station)
    assert lanes_beside(COURSES[name], row, 0.0) == (left, right)


def test_seen_from_another_lane_other_lanes_lie_beside():
    course = COURSES["lane-follow"]
    found = [lanes_beside(course, 50, lane * course.path.lane_width) for lane in (-2, -1, 1)]
    assert found == [(0, 3), (1, 2), (3, 0)]


def test_lanes_beside_end_at_the_junction():
    course = COURSES["intersection-straight"]
    assert course.side_by_side[60] == pytest.approx(course.path.junction_start - 60.0)
    after = int(course.path.junction_end) + 5
    assert course.side_by_side[after] == pytest.approx(course.path.bounds[-1] - after)


def tails(name):
    """Every way on, as the sequence of lanes of one NPC's route from one lane on, with its zone."""
    roadmap = LOGICALS[name].roadmap
    lanes = list({lane.name: lane for route in roadmap.npc_routes for lane in route.lanes}.values())
    index = {lane.name: i for i, lane in enumerate(lanes)}
    sequences = {tuple(index[lane.name] for lane in route.lanes) for route in roadmap.npc_routes}
    ways = sorted({sequence[i:] for sequence in sequences for i in range(len(sequence))})
    return [([lanes[i] for i in way], zone) for way, zone in zip(ways, COURSES[name].zones, strict=True)]


def touches_the_path(name, way, station, swath):
    for lane in way:
        if station <= lane.length:
            break
        station -= lane.length
    x, y, heading = lane.pose(station)
    return Polygon(box_corners(np.array([[x, y]]), np.array([heading]), np.array([CAR]))[0]).intersects(swath)


@EVERYWHERE
def test_zones_are_where_a_car_touches_the_egos_path(name):
    route = LOGICALS[name].roadmap.ego_route
    swath = LineString(route.polyline(0.0, route.length, 0.25)).buffer(EGO_SIZE[1] / 2 + SIDE_GAP, cap_style="flat")
    crossing = 0
    for way, zone in tails(name):
        length = sum(lane.length for lane in way)
        stations = np.arange(0.0, length, 2.0)
        touching = np.array([touches_the_path(name, way, station, swath) for station in stations])
        inside = (stations >= zone[IN] - 2.0) & (stations <= zone[OUT] + 2.0)
        assert not (touching & ~inside).any()
        if np.isinf(zone[IN]):
            continue
        crossing += 1
        assert touching[np.abs(stations - (zone[IN] + zone[OUT]) / 2).argmin()]
        assert zone[START] < zone[END]
    assert crossing > 0
