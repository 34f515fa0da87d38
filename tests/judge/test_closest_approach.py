"""The moment nearest to a collision: its time, its vehicle, and the kind of situation."""

from dataclasses import replace

import numpy as np
import pytest

from behavexplor.judge.closest_approach import LONGEST, ClosestApproach
from tests.fakes import make_trace

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
