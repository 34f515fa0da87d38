"""The ego's situation on traces made by hand, in worlds turned by any angle and in the mirror."""

import numpy as np
import pytest

from behavexplor.judge.situation import (
    bearing_of,
    behavior_of,
    heading_before,
    leader_of,
    maneuver_of,
    motion_of,
    offset_to_right,
    route_offsets,
    speed_of,
    touched_side,
)
from tests.judge.traces import CAR, driven, turned, views

# Segments of 40, 5, 5 and 93 m, whose headings are 0, 0.64, 0.93 and 1.57.
BEND = ((0.0, 0.0), (40.0, 0.0), (44.0, 3.0), (47.0, 7.0), (47.0, 100.0))


def bent(headings, length=10.0):
    """A route of segments of equal length with these headings."""
    steps = length * np.stack([np.cos(headings), np.sin(headings)], 1)
    return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])


def at_station(route, station):
    """An ego that stands on its route."""
    ends = np.append(0.0, np.cumsum(np.hypot(*np.diff(route, axis=0).T)))
    return driven([*(np.interp(station, ends, np.asarray(route)[:, i]) for i in (0, 1)), 0.0, 0.0], route=route)


def assert_named(trace, name, expected, *arguments):
    for seen, changed in views(trace):
        assert name(seen, *arguments) == changed(expected)


@pytest.mark.parametrize(
    ("station", "expected"),
    [
        (44.9, "going-straight"),
        (45.1, "turning-right"),
        (52.0, "turning-right"),
        (59.9, "turning-right"),
        (60.1, "going-straight"),
    ],
)
def test_a_turn_begins_where_its_route_does_and_goes_on_for_ten_meters(station, expected):
    assert_named(at_station(np.array(BEND), station), maneuver_of, expected, 0)


@pytest.mark.parametrize(("station", "place"), [(45.0, (44.0, 3.0)), (60.0, (47.0, 17.0))])
def test_both_ends_of_a_turn_belong_to_it(station, place):
    assert maneuver_of(driven([*place, 0.0, 0.0], route=BEND), 0) == "turning-right"


@pytest.mark.parametrize(("angle", "expected"), [(0.49, "going-straight"), (0.52, "turning-right")])
def test_a_route_that_hardly_turns_has_no_curve(angle, expected):
    assert_named(at_station(bent([0.0, angle / 2, angle]), 25.0), maneuver_of, expected, 0)


def test_a_route_that_turns_by_just_so_much_has_a_curve():
    route = [(-10.0, 0.0), (0.0, 0.0), (np.cos(0.5), np.sin(0.5))]
    assert np.arctan2(*route[-1][::-1]) == 0.5
    assert maneuver_of(driven([np.cos(0.5), np.sin(0.5), 0.0, 0.0], route=route), 0) == "turning-right"


@pytest.mark.parametrize(
    ("station", "expected"),
    [(29.9, "going-straight"), (30.1, "turning-right"), (59.9, "turning-right"), (60.1, "going-straight")],
)
def test_a_curve_begins_and_ends_where_the_heading_has_changed_by_a_twentieth(station, expected):
    route = bent([0.0, 0.048, 0.052, 0.6, 1.2 - 0.052, 1.2 - 0.048, 1.2, 1.2])
    assert_named(at_station(route, station), maneuver_of, expected, 0)


@pytest.mark.parametrize(
    ("route", "place"),
    [
        (((-10.0, 0.0), (0.0, 0.0), (np.cos(0.05), np.sin(0.05)), (10.0, 10.0)), (1.3, 0.4)),
        (((-10.0, -10.0), (-np.cos(0.05), -np.sin(0.05)), (0.0, 0.0), (20.0, 0.0)), (9.5, 0.0)),
    ],
)
def test_a_heading_changed_by_just_a_twentieth_is_before_or_behind_the_curve(route, place):
    assert np.arctan2(np.sin(0.05), np.cos(0.05)) == 0.05
    assert maneuver_of(driven([*place, 0.0, 0.0], route=route), 0) == "going-straight"


def aside(rate, begin, end):
    """An ego on a straight route that moves across it with a rate [m/s] from `begin` to `end`, before the end [s]."""
    time = np.arange(0.0, 6.01, 0.05)
    left = time[-1] - time
    moves = (left <= begin + 1e-6) & (left > end + 1e-6)
    y = np.append(0.0, np.cumsum(rate * moves[:-1] * np.diff(time)))
    ego = np.stack([8 * time, y, 0 * time, 0 * time], 1)
    return driven(ego, time=time, velocity=np.stack([0 * time + 8, rate * moves], -1)[:, None])


@pytest.mark.parametrize(
    ("rate", "begin", "end", "expected"),
    [
        (0.29, 3.0, 0.0, "going-straight"),  # 0.87 m
        (0.31, 3.0, 0.0, "changing-right"),  # 0.93 m
        (1.0, 3.0, 2.0, "changing-right"),
        (8.0, 3.2, 3.0, "going-straight"),  # earlier
        (2.0, 0.4, 0.0, "going-straight"),  # 0.8 m
        (2.0, 0.5, 0.0, "changing-right"),
    ],
)
def test_an_ego_that_has_moved_across_its_route_in_three_seconds_is_changing_lanes(rate, begin, end, expected):
    trace = aside(rate, begin, end)
    assert_named(trace, maneuver_of, expected, len(trace.time) - 1)


def test_a_drift_of_just_nine_tenths_of_a_meter_is_none():
    for rate, expected in ((0.9, "going-straight"), (0.91, "changing-right")):
        ego = [(0.0, 0.0, 0.0, 0.0), (8.0, rate, 0.0, 0.0)]
        trace = driven(ego, time=[0.0, 1.0], velocity=np.array([[[8.0, rate]], [[8.0, 50.0]]]))
        assert maneuver_of(trace, 1) == expected


def approaching(before, now, place, own_before=0.0):
    """An NPC with a heading 20 m before and another one in the end, when the ego is at the origin and heads along x."""

    def way(end, first, last):
        back = np.array([20.0, 10.0, 0.0])
        places = np.array(end) - back[:, None] * [np.cos(first), np.sin(first)]
        return np.column_stack([places, [first, first, last], [9.0] * 3])

    return driven(way((0.0, 0.0), own_before, 0.0), way(place, before, now))


@pytest.mark.parametrize(
    ("before", "now", "place", "own_before", "expected"),
    [
        (0.0, 0.0, (2.1, 1.0), 0.0, "leading"),
        (0.0, 0.0, (-2.1, 1.0), 0.0, "from-behind"),
        (0.0, 0.0, (1.9, 2.0), 0.0, "on-the-right"),
        (0.0, 0.0, (-1.9, 2.0), 0.0, "on-the-right"),
        (0.0, 0.0, (0.0, -2.0), 0.0, "on-the-left"),
        (0.0, 0.36, (5.0, 0.0), 0.0, "leading-turning"),
        (0.0, 0.34, (5.0, 0.0), 0.0, "leading"),
        (0.79, 0.79, (5.0, 0.0), 0.0, "leading"),
        (0.81, 0.81, (5.0, 0.0), 0.0, "crossing-from-left"),
        (np.pi / 2, 0.5, (-5.0, 0.0), 0.0, "from-behind-turning"),
        (np.pi / 2, np.pi / 2, (0.0, -3.0), 0.0, "crossing-from-left"),
        (-np.pi / 2, -np.pi / 2, (0.0, 3.0), 0.0, "crossing-from-right"),
        (2.3, 2.3, (5.0, 0.0), 0.0, "crossing-from-left"),
        (2.4, 2.4, (5.0, 0.0), 0.0, "oncoming"),
        (-2.4, -2.4, (5.0, 0.0), 0.0, "oncoming"),
        (np.pi, np.pi / 2, (5.0, 0.0), 0.0, "oncoming-turning"),
        (0.77, 1.6, (5.0, 1.0), 0.0, "leading-turning"),  # it came from the ego's direction
        (0.80, 1.6, (5.0, 1.0), 0.0, "crossing-from-left-turning"),
        (-0.77, -1.6, (0.0, 2.5), 0.0, "on-the-right-turning"),
        (np.pi / 2, 2.0, (5.0, 0.0), 1.5, "leading-turning"),  # the ego came from there, too, and has turned
        (2.9, 2.9, (5.0, 0.0), 1.5, "crossing-from-left"),
        (1.6, 1.6, (5.0, 0.0), -1.5, "oncoming"),
    ],
)
def test_the_other_vehicle_is_named_by_where_it_is_and_came_from(before, now, place, own_before, expected):
    assert_named(approaching(before, now, place, own_before), bearing_of, expected, 2, 1)


@pytest.mark.parametrize(
    ("place", "expected"), [((2.0, 2.0), "on-the-right"), ((-2.0, 2.0), "on-the-right"), ((1.0, 0.0), "on-the-left")]
)
def test_a_vehicle_just_at_half_a_length_is_beside(place, expected):
    assert bearing_of(approaching(0.0, 0.0, place), 2, 1) == expected


@pytest.mark.parametrize(
    ("now", "before", "expected"),
    [
        (0.8, 0.8, "crossing-from-left"),  # just as much as a rear end is not
        (0.45, 0.1, "leading"),  # just as much as a turn is not
    ],
)
def test_an_angle_just_at_a_bound_is_named_as_documented(now, before, expected):
    trace = approaching(before, now, (5.0, 0.0))
    exact = np.column_stack([[0.0] * 3, [before, before, now]])
    assert bearing_of(driven_like(trace, exact), 2, 1) == expected


def driven_like(trace, heading):
    rows = [np.column_stack([trace.position[:, i], heading[:, i], [9.0] * 3]) for i in (0, 1)]
    return driven(*rows)


@pytest.mark.parametrize("length", [0.7, 1.1, 7.0])
def test_an_earlier_heading_is_the_first_one_of_the_last_thirty_meters(length):
    """Backwards, 30 m before a frame; in a world where others drive, too."""
    frames = np.arange(80)
    own = np.column_stack([length * frames, 0 * frames, 0.01 * frames, 0 * frames])
    trace = driven(np.zeros((80, 4)), own)
    for frame in (0, 1, 20, 79):
        left = length * (frame - frames)
        expected = frames[(left < 30.0) & (left >= 0)][0]
        for angle in (0.0, 1.0):
            assert heading_before(turned(trace, angle), frame, 1) == pytest.approx(0.01 * expected + angle)
        assert heading_before(trace, frame, 0) == 0.0


@pytest.mark.parametrize(
    ("place", "heading", "expected"),
    [
        ((3.9, 0.0), 0.0, "front"),
        ((3.9, 1.2), 0.0, "front"),
        ((-3.9, -0.5), 0.0, "rear"),
        ((-3.9, 1.2), 0.0, "rear"),
        ((0.0, 1.9), 0.0, "right"),
        ((0.5, -1.9), 0.0, "left"),
        ((1.5, 2.9), np.pi / 2, "right"),  # struck near its front, yet at the side
        ((1.5, -2.9), -np.pi / 2, "left"),
        ((2.9, 0.9), np.pi / 2, "front"),
        ((-2.9, 0.9), np.pi / 2, "rear"),
        ((3.6, 1.6), np.pi / 4, "front"),
        ((1.0, 2.4), 0.3, "right"),
    ],
)
def test_the_touched_side_is_where_the_boxes_overlap(place, heading, expected):
    trace = driven(
        [0.0, 0.0, 0.0, 5.0], [50.0, 0.0, 0.0, 0.0], [*place, heading, 5.0], sizes=[CAR, (9.0, 3.0), (4.2, 1.9)]
    )
    assert_named(trace, touched_side, expected, 0, 2)


@pytest.mark.parametrize(
    ("place", "size", "is_leader"),
    [
        ((18.9, 0.0), CAR, True),  # 14.9 m between bumpers
        ((19.1, 0.0), CAR, False),
        ((19.0, 0.0), CAR, False),
        ((21.4, 0.0), (9.0, 3.0), True),
        ((21.6, 0.0), (9.0, 3.0), False),
        ((10.0, 2.7), CAR, True),  # 1.75 m to the side of its middle
        ((10.0, 2.8), CAR, False),
        ((10.0, 2.75), CAR, False),
        ((10.0, 3.2), (9.0, 3.0), True),
        ((10.0, 3.3), (9.0, 3.0), False),
        ((0.1, 2.2), CAR, True),
        ((0.0, 2.2), CAR, False),
        ((-0.1, 0.5), CAR, False),
        ((-10.0, 0.0), CAR, False),
    ],
)
def test_a_leader_is_close_ahead_and_in_the_way(place, size, is_leader):
    trace = driven([0.0, 0.0, 0.0, 5.0], [*place, 0.0, 5.0], sizes=[CAR, size])
    assert leader_of(trace, 0) == (1 if is_leader else None)
    is_on_a_bound = place in ((19.0, 0.0), (10.0, 2.75), (0.0, 2.2))
    for seen, _ in views(trace) if not is_on_a_bound else ():
        assert leader_of(seen, 0) == (1 if is_leader else None)


def test_the_leader_is_the_one_with_the_least_gap_in_that_frame():
    """A long vehicle's rear is nearer than a car's whose center is."""
    far, car, bus, behind = [9.0, 5.0, 0.0, 0.0], [11.0, 0.5, 0.0, 0.0], [12.0, 0.0, 0.0, 0.0], [-6.0, 0.0, 0.0, 0.0]
    trace = driven([0.0, 0.0, 0.0, 5.0], far, car, bus, behind, sizes=[CAR, CAR, CAR, (9.0, 2.0), CAR])
    later = driven(*([[0.0] * 4, row] for row in ([0.0, 0.0, 0.0, 5.0], far, car, bus, behind)), sizes=trace.size)
    for seen, _ in views(later):
        assert leader_of(seen, 1) == 3


@pytest.mark.parametrize(
    ("speed", "motion"),
    [(0.0, "standing"), (0.29, "standing"), (0.3, "creeping"), (1.0, "creeping"), (1.99, "creeping"), (2.0, "")],
)
def test_who_is_slow_stands_or_creeps(speed, motion):
    trace = driven([0.0, 0.0, 0.0, 30.0], [9.0, 9.0, 0.0, speed])
    assert motion_of(trace, 0, 1) == motion
    assert motion_of(trace, 0, 0) == ""
    assert speed_of(turned(trace, 2.5), 0, 1) == pytest.approx(speed)
    assert behavior_of(driven([0.0, 0.0, 0.0, speed]), 0) == motion


@pytest.mark.parametrize(
    ("speeds", "expected"),
    [
        ((5.0, 5.0, 3.0), ""),  # just 2 m/s2
        ((5.0, 5.0, 2.9), "braking"),
        ((9.0, 5.0, 3.1), ""),  # what was earlier does not count
        ((3.0, 3.0, 9.0), ""),
        ((9.0, 3.5, 1.4), "braking"),
        ((9.0, 3.0, 1.4), "creeping"),
        ((9.0, 9.0, 0.2), "standing"),
    ],
)
def test_an_ego_brakes_if_it_has_lost_two_meters_per_second_in_the_last_second(speeds, expected):
    rows = np.column_stack([np.zeros((4, 3)), [speeds[0], *speeds]])
    trace = driven(rows, rows[::-1], time=[0.0, 0.88, 0.95, 1.95])
    assert behavior_of(trace, 3) == expected
    is_on_a_bound = speeds == (5.0, 5.0, 3.0)
    for seen, _ in views(trace) if not is_on_a_bound else ():
        assert behavior_of(seen, 3) == expected


def test_offsets_from_the_route_are_positive_to_the_right():
    """On a route with a right angle, and before its start."""
    route = ((0.0, 0.0), (90.0, 0.0), (90.0, 90.0))
    places = [(30.0, 1.5), (40.0, -2.0), (88.5, 50.0), (92.0, 60.0), (-3.0, 1.0)]
    trace = driven([(*place, 0.0, 0.0) for place in places], np.zeros((5, 4)), route=route)
    expected = np.array([1.5, -2.0, 1.5, -2.0, 1.0])
    for seen, changed in views(trace):
        sign = 1 if changed is str else -1
        assert route_offsets(seen) == pytest.approx(sign * expected)


def test_an_offset_to_the_right_is_across_the_heading():
    assert offset_to_right(np.array([3.0, 2.0]), 0.0) == 2.0
    assert offset_to_right(np.array([3.0, 2.0]), np.pi / 2) == pytest.approx(-3.0)
    assert offset_to_right(np.array([1.0, 1.0]), np.pi / 4) == pytest.approx(0.0)
