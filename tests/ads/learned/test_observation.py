"""What a learned policy sees is what is there."""

import numpy as np
import pytest

from behavexplor.ads.learned.observation import HORIZON, N_CONFLICT, N_CONFLICTS, N_EGO, N_FEATURES, N_LANE, RANGE, see
from behavexplor.ads.learned.route_table import END, IN, OUT, START
from tests.ads.learned.scenes import COURSES, LOGICALS, ego, on_route
from tests.kernel_calls import called_alone

see = called_alone(see)

LIMIT = 11.176


def seen(name, *vehicles, wanted=0.0):
    out = np.full(N_FEATURES, np.nan)
    see(COURSES[name], np.array(vehicles, dtype=np.float64), wanted, out)
    return out


def lanes(values):
    return values[N_EGO : N_EGO + 3 * N_LANE].reshape(3, N_LANE)


def conflicts(values):
    return values[N_EGO + 3 * N_LANE :].reshape(N_CONFLICTS, N_CONFLICT)


def test_an_empty_road_is_free_as_far_as_one_sees():
    values = seen("lane-follow", ego("lane-follow", 30.0, speed=5.0))
    assert values[:6] == pytest.approx([5 / LIMIT, 0, 0, 0, 1, 1], abs=1e-9)
    assert values[6:8] == pytest.approx([1.0, 1.0])  # 200 m to the destination
    assert lanes(values) == pytest.approx(np.tile([1, 1, 1, 1, 0, 0], (3, 1)))
    assert conflicts(values) == pytest.approx(np.tile([1, 1, 1, 1, 0, 0, 0], (N_CONFLICTS, 1)))


def test_vehicles_ahead_and_behind_are_told_by_their_lanes():
    values = seen(
        "lane-follow",
        ego("lane-follow", 60.0, speed=8.0),
        on_route("lane-follow", "lane-3", 90.0, 4.0, -2.0, size=(4.3, 2.0)),
        on_route("lane-follow", "lane-3", 99.0, 1.0),
        on_route("lane-follow", "lane-2", 40.0, 10.0, 3.0, size=(4.3, 2.0)),
        on_route("lane-follow", "lane-4", 62.0, 7.0, size=(4.3, 2.0)),
        on_route("lane-follow", "lane-1", 61.0, 7.0),
    )
    left, own, right = lanes(values)
    assert own == pytest.approx([1, (30 - 4.5) / RANGE, 4 / LIMIT, 1, 0, -2 / 4])
    assert left == pytest.approx([1, 1, 1, (20 - 4.5) / RANGE, 10 / LIMIT, 0])
    assert right == pytest.approx([1, (2 - 4.5) / RANGE, 7 / LIMIT, 1, 0, 0])


def test_there_is_no_lane_beyond_the_edge():
    leftmost, rightmost = (seen("lane-change", ego("lane-change", 40.0, offset)) for offset in (-10.5, 0.0))
    assert (lanes(leftmost)[0, 0], lanes(leftmost)[2, 0]) == (0, 1)
    assert (lanes(rightmost)[0, 0], lanes(rightmost)[2, 0]) == (1, 0)


def test_offsets_are_from_the_route_and_from_the_wanted_lane():
    values = seen("lane-change", ego("lane-change", 40.0, -7.0), wanted=-3.5)
    assert values[1:4] == pytest.approx([-2.0, -1.0, 0.0], abs=1e-9)


def test_a_crossing_vehicle_is_told_by_when_and_where_it_is_on_the_path():
    name, route = "intersection-straight", "west-inner-straight"
    course, roadmap = COURSES[name], LOGICALS[name].roadmap
    approach = roadmap.routes[route].lanes[0]
    values = seen(name, ego(name, 60.0, speed=10.0), on_route(name, route, 80.0, speed=8.0, acceleration=1.0))
    found = conflicts(values)
    found = found[found[:, 0] < 1]
    zones = course.zones[np.isfinite(course.zones[:, IN])]
    expected = [
        [
            (zone[IN] - 80) / 8 / HORIZON,
            min((zone[OUT] - 80) / 8, HORIZON) / HORIZON,
            min((zone[START] - 60) / RANGE, 1),
            min((zone[END] - 60) / RANGE, 1),
            8 / LIMIT,
            min((zone[START] - 60 - 2.35) / 10, HORIZON) / HORIZON,
            1 / 4,
        ]
        for zone in zones
    ]
    assert approach.length < 160
    assert len(found) == 2  # straight on and left
    for row in found:
        assert np.abs(np.array(expected) - row).max(axis=1).min() < 1e-9
    assert found[0, 0] <= found[1, 0]


def test_a_vehicle_that_stands_is_in_conflict_only_where_it_stands_on_the_path():
    name, route = "intersection-straight", "west-inner-straight"
    zone = min((zone for zone in COURSES[name].zones if zone[IN] < 200), key=lambda zone: zone[OUT])
    waiting = conflicts(seen(name, ego(name, 60.0), on_route(name, route, 100.0)))
    assert (waiting[:, 0] == 1).all()
    assert zone[OUT] > 0
    inside = LOGICALS[name].roadmap.routes[route]
    blocking = next(
        conflicts(seen(name, ego(name, 60.0), on_route(name, route, station)))
        for station in np.arange(inside.bounds[1] + 5, inside.bounds[2])
        if conflicts(seen(name, ego(name, 60.0), on_route(name, route, station)))[0, 0] == 0
    )
    assert blocking[0, 1] == 1.0  # it stays


def test_conflicts_are_sorted_and_the_latest_are_left_out():
    name = "intersection-straight"
    routes = [f"{leg}-inner-{way}" for leg in ("west", "east", "north") for way in ("straight", "left")]
    npcs = [on_route(name, route, 40.0 + 9 * i, speed=11.0) for i, route in enumerate(routes)]
    begins = conflicts(seen(name, ego(name, 70.0, speed=9.0), *npcs))[:, 0]
    assert (np.diff(begins) >= 0).all()
    assert (begins < 1).sum() >= 4


@pytest.mark.parametrize("name", COURSES)
def test_everything_seen_is_about_one_in_size(name):
    logical, generator = LOGICALS[name], np.random.default_rng(0)
    for _ in range(200):
        scenario = logical.sample(generator)
        npcs = [on_route(name, npc.route, generator.uniform(0, 200), generator.uniform(0, 11)) for npc in scenario.npcs]
        length = logical.roadmap.ego_route.length
        values = seen(
            name, ego(name, generator.uniform(0, length), generator.normal(), generator.uniform(0, 11)), *npcs
        )
        assert np.isfinite(values).all()
        assert np.abs(values).max() < 7
