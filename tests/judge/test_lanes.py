"""What lanes tell of an ego and of its partner: bounds in time, place and angle, in worlds turned by any angle."""

from dataclasses import replace

import numpy as np
import pytest

from behavexplor.data.trace import ELSEWHERE, OBSTACLE, ON_ITS_WAY, WAYS
from behavexplor.judge.lanes import had_crashed, has_entered_ring, has_lane_signals, lane_change, maneuver, relation
from tests.judge.traces import CAR, driven, views

FRAMES = 41  # at 10 Hz


def way_of(*kinds):
    """The signal of the ego's ways, each from its time on [s]."""
    values = np.zeros(FRAMES)
    for begin, kind in kinds:
        values[round(10 * begin) :] = WAYS.index(kind)
    return values


def changing(**when):
    values = np.zeros(FRAMES)
    for side, (begin, end) in when.items():
        values[round(10 * begin) : round(10 * end) + 1] = 1 if side == "right" else -1
    return values


def lanes(way=None, changes=None, where=ELSEWHERE, lane=0, npcs=((60.0, 0.0, 0.0),), partner=1, **fields):
    """An ego that stands at the origin; its vehicles stand as given, and the first of them is the partner."""
    signals = {
        "way": way_of((0, "going-straight")) if way is None else way,
        "changing_lanes": np.zeros(FRAMES) if changes is None else changes,
        "partner": np.broadcast_to(np.asarray(where, dtype=float), FRAMES),
        "partner_lanes": np.broadcast_to(np.asarray(lane, dtype=float), FRAMES),
        **fields.pop("signals", {}),
    }
    rows = [np.tile([*npc, 0.0], (FRAMES, 1)) for npc in ((0.0, 0.0, 0.0), *npcs)]
    return driven(*rows, signals=signals, partner=partner, end="collision", **fields)


def test_only_a_trace_that_says_its_lanes_is_told_by_them():
    plain, told = driven(np.zeros((3, 4))), lanes()
    old = driven(np.zeros((3, 4)), signals={"crashed": np.zeros(3)})
    assert [has_lane_signals(one) for one in (plain, told, old)] == [False, True, False]


@pytest.mark.parametrize(
    ("frame", "seconds", "side"),
    [
        (9, 9.0, ""),
        (10, 0.0, "left"),
        (20, 0.9, "left"),  # from 1.1 s on
        (20, 0.8, ""),
        (25, 9.0, "right"),
        (40, 1.5, "right"),
        (40, 1.4, ""),
    ],
)
def test_the_last_lane_change_is_one_of_the_last_seconds(frame, seconds, side):
    """Left from 1.0 s to 1.1 s, right from 2.3 s to 2.5 s."""
    trace = lanes(changes=changing(left=(1.0, 1.1), right=(2.3, 2.5)))
    assert lane_change(trace, frame, seconds) == side


def test_a_ring_was_entered_if_the_way_of_the_last_seconds_says_so():
    trace = lanes(way_of((0, "entering-the-ring"), (2, "driving-in-the-ring")))
    assert has_entered_ring(trace, 19, 0.0)
    assert has_entered_ring(trace, 39, 2.0)  # 3.9 - 2.0 = 1.9
    assert not has_entered_ring(trace, 39, 1.9)


@pytest.mark.parametrize(
    ("way", "changes", "expected"),
    [
        (((0, "going-straight"),), {"left": (3.0, 3.0)}, "changing-left"),
        (((0, "going-straight"),), {"left": (2.0, 2.9)}, "having-changed-left"),
        (((0, "going-straight"),), {"right": (2.0, 2.9), "left": (3.5, 3.6)}, "changing-left"),
        (((0, "going-straight"),), {"right": (1.0, 2.0)}, "having-changed-right"),
        (((0, "going-straight"),), {"right": (1.0, 1.9)}, "going-straight"),
        (((0, "turning-left"), (3.0, "going-straight")), {}, "going-straight"),
        (((0, "turning-left"), (3.1, "going-straight")), {}, "turning-left"),
        (((0, "turning-right"), (3.1, "going-straight")), {"left": (1.0, 2.5)}, "turning-right"),
        (((0, "entering-the-ring"), (3.2, "leaving-the-ring"), (3.9, "going-straight")), {}, "leaving-the-ring"),
        (((0, "entering-the-ring"), (3.2, "driving-in-the-ring")), {}, "entering-the-ring"),
        (((0, "going-straight"), (4.0, "driving-in-the-ring")), {}, "driving-in-the-ring"),
    ],
)
def test_the_maneuver_is_that_of_the_last_second_and_a_lane_change_is_said_longer(way, changes, expected):
    assert maneuver(lanes(way_of(*way), changing(**changes)), 40, 2.0) == expected


@pytest.mark.parametrize(
    ("place", "lane", "expected"),
    [
        ((0.1, 0.0, 0.0), 0, "leading"),
        ((0.0, 0.0, 0.0), 0, "behind"),
        ((-9.0, 0.0, 0.0), 0, "behind"),
        ((3.9, 4.0, 0.0), 1, "on-the-right"),
        ((4.1, 4.0, 0.0), 1, "ahead-on-the-right"),
        ((4.0, 4.0, 0.0), 1, "ahead-on-the-right"),
        ((-3.9, 8.0, 0.0), 2, "on-the-right"),
        ((-4.1, 8.0, 0.0), 2, "behind-on-the-right"),
        ((-4.1, -4.0, 0.0), -1, "behind-on-the-left"),
        ((30.0, -4.0, 0.0), -1, "ahead-on-the-left"),
        ((-1.0, 9.0, 1.0), 0, "leading"),  # in a bend to the right
        ((-1.0, -9.0, -1.0), 0, "leading"),
        ((-4.0, 9.0, 1.0), 1, "on-the-right"),  # 0.8 m ahead along the chord
        ((1.0, 9.0, 1.0), 1, "ahead-on-the-right"),  # 5.2 m
    ],
)
def test_a_partner_on_the_ego_s_way_is_ahead_beside_or_behind_along_the_chord(place, lane, expected):
    trace = lanes(where=ON_ITS_WAY, lane=lane, npcs=[place])
    assert relation(trace, 40, 1) == expected
    is_on_a_bound = place[0] in (0.0, 4.0)
    for seen, changed in views(trace) if not is_on_a_bound else ():
        told = {**seen.signals, "partner_lanes": np.full(FRAMES, lane if changed is str else -lane)}
        assert relation(replace(seen, signals=told), 40, 1) == changed(expected)


def test_short_vehicles_may_be_hardly_ahead_and_not_beside():
    for x, expected in ((0.6, "ahead-on-the-right"), (0.4, "on-the-right"), (-0.6, "behind-on-the-right")):
        trace = lanes(where=ON_ITS_WAY, lane=1, npcs=[(x, 4.0, 0.0)], sizes=[(0.5, 0.5)] * 2)
        assert relation(trace, 40, 1) == expected


@pytest.mark.parametrize(
    ("place", "expected"),
    [
        ((20.0, 0.0, 2.4), "oncoming"),
        ((20.0, 0.0, -2.4), "oncoming"),
        ((20.0, 0.0, 2.3), "crossing-from-left"),
        ((20.0, 0.0, 0.8), "crossing-from-left"),
        ((20.0, 0.0, -0.8), "crossing-from-right"),
        ((20.0, 2.1, 0.77), "merging-from-right"),
        ((20.0, -2.1, -0.77), "merging-from-left"),
        ((20.0, 1.9, 0.0), "leading"),
        ((-20.0, 1.9, 0.0), "behind"),
        ((20.0, 2.0, 0.0), "merging-from-right"),
    ],
)
def test_a_partner_on_another_road_is_named_by_its_heading(place, expected):
    trace = lanes(npcs=[place])
    assert relation(trace, 40, 1) == expected
    for seen, changed in views(trace) if place[1] != 2.0 else ():
        assert relation(seen, 40, 1) == changed(expected)


def test_a_partner_is_seen_one_second_before_or_when_it_appears():
    trace = lanes(where=ON_ITS_WAY, npcs=[(-20.0, 0.0, 0.0)])
    position = trace.position.copy()
    position[31:, 1, 0] = 20.0
    trace = replace(trace, position=position)
    assert relation(trace, 40, 1) == "behind"
    present = np.ones((FRAMES, 2), dtype=bool)
    present[:31, 1] = False
    assert relation(replace(trace, present=present), 40, 1) == "leading"


def test_an_obstacle_a_wreck_and_another_vehicle_than_the_partner():
    wrecks = np.zeros((FRAMES, 3))
    wrecks[39:, 2] = 1.0
    npcs = [(20.0, 0.0, 0.0), (20.0, 4.0, 0.0)]
    trace = lanes(where=OBSTACLE, npcs=npcs, sizes=[CAR] * 3, signals={"wrecks": wrecks})
    assert relation(trace, 40, 1) == "obstacle"
    assert relation(trace, 40, 2) == "crashed-before"
    assert relation(trace, 39, 2) == "merging-from-right"  # it crashes in that frame
    assert [had_crashed(trace, frame, 2) for frame in (38, 39, 40)] == [False, False, True]
    assert not had_crashed(trace, 40, 1)
    assert not had_crashed(lanes(), 40, 1)
    assert relation(lanes(where=ON_ITS_WAY, lane=1, npcs=npcs, sizes=[CAR] * 3), 40, 2) == "merging-from-right"
