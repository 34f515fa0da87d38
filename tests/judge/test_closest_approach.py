"""The moment nearest to a collision: its time, its vehicle, and the kind of situation."""

from dataclasses import replace

import numpy as np
import pytest

from behavexplor.judge.closest_approach import LONGEST, ClosestApproach, Nearness, known_nearness
from behavexplor.judge.specs import Verdict, judge
from tests.fakes import make_trace
from tests.judge.traces import driven, views

TIME = np.arange(0.0, 3.0, 0.05)


def moving(x=0.0, y=0.0, speed=0.0, heading=0.0):
    return np.stack([x + speed * TIME * np.cos(heading), y + speed * TIME * np.sin(heading), heading + 0 * TIME], 1)


def drive(ego, *npcs, end="timeout"):
    return replace(make_trace(ego, npcs), end=end)


def test_the_time_left_is_the_gap_over_the_closing_speed():
    nearest = ClosestApproach.of(drive(moving(speed=10.0), moving(x=60.0, speed=2.0)))
    trace = drive(moving(speed=10.0), moving(x=60.0, speed=2.0))
    length, width = trace.size[0]
    gap = 60.0 - 8.0 * TIME[-1] - 0.68 * length - 1.1 * width  # between the outer discs
    assert nearest.time_left == pytest.approx(gap / 8.0, abs=1e-6)
    assert (nearest.frame, nearest.npc) == (len(TIME) - 1, 1)


def test_it_is_the_vehicle_that_is_nearest_in_time_not_in_space():
    trace = drive(moving(speed=10.0), moving(y=4.0, speed=10.1), moving(x=70.0, speed=-10.0))
    assert ClosestApproach.of(trace).npc == 2


@pytest.mark.parametrize("npc", [moving(x=30.0, speed=20.0), moving(y=30.0, speed=10.0), moving(x=500.0, speed=-10.0)])
def test_a_vehicle_that_leaves_or_stays_beside_or_is_far_away_is_no_near_miss(npc):
    assert ClosestApproach.of(drive(moving(speed=10.0), npc)) is None


def test_vehicles_that_touch_have_no_time_left():
    assert ClosestApproach.of(drive(moving(speed=10.0), moving(x=4.0, speed=1.0))).time_left == 0.0


def test_a_collision_is_seen_one_second_before_the_contact():
    trace = drive(moving(speed=10.0), moving(x=10.0 * TIME[-1] + 4.0), moving(y=6.0, speed=9.0), end="collision")
    nearest = ClosestApproach.of(trace)
    assert (nearest.time_left, nearest.npc) == (0.0, 1)
    assert trace.time[nearest.frame] == pytest.approx(trace.time[-1] - 1.0)


def test_a_partner_that_appears_late_is_seen_when_it_is_there():
    trace = drive(moving(speed=10.0), moving(x=10.0 * TIME[-1] + 4.0), end="collision")
    present = np.ones((len(TIME), 2), dtype=bool)
    present[:-5, 1] = False
    assert ClosestApproach.of(replace(trace, present=present)).frame == len(TIME) - 5


@pytest.mark.parametrize(("place", "sector"), [((30, 0), 0), ((30, 30), 1), ((0, 30), 2), ((-30, 0), 4), ((0, -30), 6)])
def test_a_niche_has_the_sector_seen_from_the_ego(place, sector):
    for turned in (0.0, np.pi / 2, -3.0):
        x, y = (
            np.cos(turned) * place[0] - np.sin(turned) * place[1],
            np.sin(turned) * place[0] + np.cos(turned) * place[1],
        )
        trace = drive(moving(speed=1.0, heading=turned), moving(x=x, y=y, speed=1.0, heading=turned))
        assert ClosestApproach(1.0, 0, 1).niche(trace)[2] == sector


def test_a_niche_has_the_words_the_speeds_and_the_command_at_that_moment():
    trace = drive(moving(speed=15.0), moving(x=60.0, speed=3.0))
    commands = replace(trace, actions=np.array([[3.0], [1.0]]), action_frame=np.array([0, 30]))
    early, late = ClosestApproach(1.0, 29, 1).niche(commands), ClosestApproach(1.0, 30, 1).niche(commands)
    assert early == ("going-straight", "leading", 0, 2, 2, 3)
    assert late == ("going-straight", "leading", 0, 2, 2, 1)


def test_without_a_vehicle_near_there_is_nothing():
    assert ClosestApproach.of(drive(moving(speed=10.0), moving(x=10.0 * LONGEST + 100.0))) is None


def discs(place, heading, size):
    """The centers of a vehicle's three discs, shape (3, 2), and their radius."""
    along = np.array([[-0.34], [0.0], [0.34]]) * size[0] * np.array([np.cos(heading), np.sin(heading)])
    return place + along, 0.55 * size[1]


def first_touch(trace, npc):
    """The first time within `LONGEST` at which the discs of ego and NPC touch, by trying many; None if they do not."""
    (own, own_radius), (other, radius) = (
        discs(trace.position[0, i], trace.heading[0, i], trace.size[i]) for i in (0, npc)
    )
    times = np.linspace(0.0, LONGEST, 5_001)[:, None, None, None]
    apart = other[None] - own[:, None] + times * (trace.velocity[0, npc] - trace.velocity[0, 0])
    touching = (np.hypot(apart[..., 0], apart[..., 1]) < own_radius + radius).any(axis=(1, 2))
    return float(times[touching.argmax(), 0, 0, 0]) if touching.any() else None


def test_the_time_left_is_that_after_which_discs_touch_wherever_the_vehicles_are_and_head():
    rng, touches = np.random.default_rng(0), 0
    for _ in range(200):
        vehicles = [
            moving(*rng.uniform(-18, 18, 2), speed=rng.uniform(0, 25), heading=rng.uniform(-np.pi, np.pi))
            for _ in range(3)
        ]
        trace = make_trace(vehicles[0][:1], [one[:1] for one in vehicles[1:]])
        speeds = np.array([np.subtract(one[1, :2], one[0, :2]) / (TIME[1] - TIME[0]) for one in vehicles])
        trace = replace(trace, velocity=speeds[None])
        times = {npc: first_touch(trace, npc) for npc in (1, 2)}
        touched = {npc: time for npc, time in times.items() if time is not None}
        nearest = ClosestApproach.of(trace)
        touches += bool(touched)
        assert (nearest is not None) == bool(touched)
        if nearest is not None:
            assert nearest.time_left == pytest.approx(min(touched.values()), abs=2e-3)
            assert touched[nearest.npc] == min(touched.values())
    assert touches > 30


@pytest.mark.parametrize(
    ("gap", "speed", "time_left"),
    [(79.9, -20.0, (79.9 - 4.92) / 40), (80.0, -20.0, (80.0 - 4.92) / 40), (80.2, -20.0, None)],
)
def test_a_vehicle_is_looked_at_up_to_eighty_meters(gap, speed, time_left):
    """Two vehicles of 4 m times 2 m, whose outer discs lie 0.68 times 4 m and 1.1 times 2 m nearer than they."""
    trace = driven([0.0, 0.0, 0.0, 20.0], [gap, 0.0, 0.0, speed])
    nearest = ClosestApproach.of(trace)
    assert (nearest and nearest.time_left) == (time_left and pytest.approx(time_left))


@pytest.mark.parametrize(("gap", "is_near"), [(54.8, True), (55.0, False)])
def test_only_less_than_five_seconds_count(gap, is_near):
    """At 10 m/s, that is a gap of 50 m and 4.92 m."""
    assert (ClosestApproach.of(driven([0.0, 0.0, 0.0, 10.0], [gap, 0.0, 0.0, 0.0])) is not None) == is_near
    assert LONGEST == 5.0


@pytest.mark.parametrize(("speed", "is_near"), [(0.0, False), (0.099, False), (0.101, True)])
def test_vehicles_that_hardly_move_to_each_other_never_touch(speed, is_near):
    found = [ClosestApproach.of(driven([0.0] * 4, [x, 0.0, 0.0, -speed])) for x in (3.0, 5.0)]
    assert [one is not None for one in found] == [is_near, is_near]


def test_the_nearest_is_the_first_vehicle_of_the_first_frame_with_the_least_time():
    rows = np.tile([0.0, 0.0, 0.0, 10.0], (3, 1))
    npcs = [np.array([[x, 0.0, 0.0, 0.0] for x in places]) for places in ((30, 20, 20), (30, 20, 20), (30, 30, 21))]
    assert ClosestApproach.of(driven(rows, *npcs)) == ClosestApproach(pytest.approx((20 - 4.92) / 10), 1, 1)


@pytest.mark.parametrize(
    ("own", "npc", "kinds"),
    [
        (0.0, 3.99, (0, 0)),
        (0.0, 4.0, (1, 0)),
        (0.0, 9.99, (1, 0)),
        (0.0, 10.0, (2, 0)),
        (5.99, 5.99, (0, 0)),
        (6.0, 6.0, (0, 1)),
        (13.99, 13.99, (0, 1)),
        (14.0, 14.0, (0, 2)),
        (21.99, 21.99, (0, 2)),
        (22.0, 22.0, (0, 3)),
        (8.0, -1.9, (1, 1)),
    ],
)
def test_a_niche_has_kinds_of_speeds_with_their_lower_bounds(own, npc, kinds):
    trace = driven([0.0, 0.0, 0.0, own], [30.0, 0.0, 0.0, npc])
    assert ClosestApproach(1.0, 0, 1).niche(trace) == ("going-straight", "leading", 0, *kinds)


def test_a_niche_is_told_alike_wherever_the_ego_heads():
    """Only left and right differ in the mirror, and sectors are counted to the right."""
    trace = driven([0.0, 0.0, 0.3, 15.0], [20.0, 30.0, -1.6, 9.0], actions=[[0.6, -1.4]], action_frame=[0])
    for seen, changed in views(trace):
        sector = 1 if changed is str else 7
        words = [changed(word) for word in ("going-straight", "crossing-from-right")]
        assert ClosestApproach(1.0, 0, 1).niche(seen) == (*words, sector, 2, 2, 1, -1)


def test_an_execution_is_as_near_as_its_closest_approach():
    near = driven([0.0, 0.0, 0.0, 10.0], [34.92, 0.0, 0.0, 0.0], destination=[0.0, 0.0])
    apart = driven([0.0, 0.0, 0.0, 10.0], [34.92, 9.0, 0.0, 0.0], destination=[0.0, 0.0])
    niche = ("going-straight", "leading", 0, 2, 1)
    assert Nearness.of(near, judge(near)) == (pytest.approx(3.0), niche)
    assert Nearness.of(apart, judge(apart)) == (5.0, None)
    missed = replace(near, destination=np.array([99.0, 0.0]))
    kind = "R3/going-straight/ended-by-timeout/nobody-ahead"
    assert Nearness.of(missed, judge(missed)) == (pytest.approx(3.0), (kind,))
    assert Nearness.of(apart, Verdict({}, ("error",))) == (5.0, ("error",))
    struck = driven([0.0, 0.0, 0.0, 10.0], [3.0, 0.0, 0.0, 0.0], end="collision")
    assert Nearness.of(struck, judge(struck)) == (0.0, niche)


def test_what_another_process_has_computed_is_taken():
    known = {**known_nearness(1.5, ["a", 2]), "end": "timeout"}
    trace = driven([0.0] * 4)
    vars(trace).update(known)
    assert Nearness.of(trace, judge(trace)) == (1.5, ("a", 2))
    assert known_nearness(5.0, None)["_nearness"] == (5.0, None)


def test_the_moment_before_a_contact_is_that_one_second_earlier_or_the_first():
    for frames, expected in ((31, 20), (11, 0), (6, 0)):
        rows = np.zeros((frames, 4))
        trace = driven(rows, rows + [3.0, 0.0, 0.0, 0.0], end="collision")
        assert ClosestApproach.of(trace) == ClosestApproach(0.0, expected, 1)
        elsewhere = driven(rows, rows + [9.0, 0.0, 0.0, 0.0], end="collision")  # with nothing that stands there
        assert ClosestApproach.of(elsewhere) is None
