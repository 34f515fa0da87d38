"""Near misses: what nearly happened in a trace, and what it would have been called."""

from dataclasses import replace

import numpy as np
import pytest

from behavexplor.fuzz.aiming import Drive
from behavexplor.fuzz.encounters import near_misses
from behavexplor.judge.specs import Verdict, judge
from tests.fakes import make_trace

TIME = np.arange(0.0, 10.0, 0.05)


def straight(x=0.0, y=0.0, speed=8.0, heading=0.0):
    return np.stack([x + speed * TIME * np.cos(heading), y + 0 * TIME, heading + 0 * TIME], axis=1)


def found(trace, verdict=None, reach=10.0):
    """Niche, degree and partner of each near miss."""
    misses = near_misses(trace, verdict or Verdict(judge(trace).degrees, ()), Drive.of(trace), reach)
    return {miss.niche: (miss.degree, miss.partner) for miss in misses}


def drive(ego, *npcs, lines=()):
    destination = ego[-1, :2]
    return replace(make_trace(ego, npcs, lines=lines, destination=destination), end="arrived")


def test_a_vehicle_alongside_is_a_near_miss_of_a_collision():
    misses = found(drive(straight(), straight(y=3.5)))
    (degree, partner) = misses["R1/going-straight/on-the-right/car-sized/moving"]
    assert degree == pytest.approx(0.01 + 3.5 - 2.06)
    assert partner == 0


def test_every_vehicle_is_looked_at_and_far_ones_are_not_kept():
    trace = drive(straight(), straight(y=-3.5), straight(x=12.0), straight(y=40.0))
    assert {niche: partner for niche, (_, partner) in found(trace).items()} == {
        "R1/going-straight/on-the-left/car-sized/moving": 0,
        "R1/going-straight/leading/car-sized/moving": 1,
    }
    assert not found(trace, reach=0.5)


def test_an_npc_that_comes_from_behind_teaches_nothing_unless_the_ego_changes_lanes():
    follower = straight(x=-8.0)
    assert not found(drive(straight(), follower))
    change = straight(y=0.0)
    change[:, 1] = 1.2 * np.clip(TIME - 1.0, 0.0, None)
    behind = straight(x=-7.0)
    behind[:, 1] = change[:, 1]
    assert any("from-behind" in niche for niche in found(drive(change, behind)))


def test_a_standing_ego_has_no_near_misses_of_collisions():
    stands, passes = straight(speed=0.0), straight(x=-40.0, y=3.5)
    assert not any(niche.startswith("R1") for niche in found(drive(stands, passes)))


def test_lines_on_both_sides_have_niches_of_their_own():
    lines = [[[-100.0, 1.75], [300.0, 1.75]], [[-100.0, -5.25], [300.0, -5.25]]]
    misses = found(drive(straight(), lines=lines))
    assert misses["R2/going-straight/right/fast"] == (pytest.approx(0.01 + 10 * (1.75 - 1.03)), -1)
    assert misses["R2/going-straight/left/fast"] == (pytest.approx(0.01 + 10 * (5.25 - 1.03)), -1)


@pytest.mark.parametrize("side", [1, -1])
def test_lines_have_further_niches_for_a_change_of_lanes(side):
    lines = [[[-100.0, 5.25], [300.0, 5.25]], [[-100.0, -5.25], [300.0, -5.25]]]
    change = straight()
    change[:, 1] = side * 3.5 * np.clip((TIME - 3.0) / 4.0, 0.0, 1.0)
    maneuver = {1: "changing-right", -1: "changing-left"}[side]
    misses = {niche: degree for niche, (degree, _) in found(drive(change, lines=lines)).items() if "R2/" in niche}
    assert misses.keys() == {
        f"R2/{phase}/{place}/fast" for phase in ("going-straight", maneuver) for place in ("left", "right")
    }
    near, far = ("right", "left")[::side]
    assert misses[f"R2/{maneuver}/{near}/fast"] < misses[f"R2/{maneuver}/{far}/fast"]


@pytest.mark.parametrize("angle", [1.2, -2.5])
def test_near_misses_are_the_same_wherever_the_ego_heads(angle):
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    lines = np.array([[[-100.0, 1.75], [300.0, 1.75]], [[-100.0, -5.25], [300.0, -5.25]]])

    def turned(poses):
        return np.column_stack([poses[:, :2] @ turn.T, poses[:, 2] + angle])

    ego, others = straight(), (straight(y=3.5), straight(x=12.0))
    there = drive(turned(ego), *map(turned, others), lines=lines @ turn.T)
    seen = [found(replace(one, route=one.position[[0, -1], 0])) for one in (drive(ego, *others, lines=lines), there)]
    assert seen[0].keys() == seen[1].keys()
    assert len(seen[0]) == 4
    for niche, (degree, partner) in seen[0].items():
        assert seen[1][niche] == (pytest.approx(degree), partner)


def test_a_long_stand_is_a_near_miss_of_a_standstill():
    ego = straight()
    ego[:, 0] = 8.0 * np.clip(TIME, 0.0, 2.0)
    leader = straight(x=22.0, speed=0.0)
    degree, _ = found(drive(ego, leader))["R3/going-straight/ended-by-standstill/behind-a-standing-vehicle"]
    assert degree == pytest.approx(0.01 + 1 - 8.0 / 30.0, abs=0.02)


@pytest.mark.parametrize(("frames", "counts"), [(6, False), (7, True)])
def test_a_stand_of_less_than_two_seconds_is_none(frames, counts):
    """The ego stands for so many frames, which are 0.3 s long, so that it is looked at in all of them."""
    step = np.arange(30)
    x = 2.0 * np.minimum(step, 10) + 2.0 * np.maximum(step - 11 - frames, 0)
    ego = np.stack([x, 0 * x, 0 * x], axis=1)
    trace = replace(make_trace(ego, time=0.3 * step, destination=ego[-1, :2]), end="arrived")
    misses = found(trace)
    assert any("ended-by-standstill" in niche for niche in misses) is counts
    if counts:
        ((degree, _),) = misses.values()
        assert degree == pytest.approx(0.01 + 1 - 2.1 / 30)


@pytest.mark.parametrize(("seconds", "degree"), [(40.0, None), (40.05, 0.01 + 1 - 40.05 / 200), (60.0, 0.71)])
def test_a_drive_of_more_than_a_fifth_of_the_longest_is_a_near_miss_of_a_timeout(seconds, degree):
    time = np.arange(0.0, seconds + 0.01, 0.05)
    ego = np.stack([2.0 * time, 0 * time, 0 * time], axis=1)
    degrees = [one for niche, (one, _) in found(drive(ego)).items() if "ended-by-timeout" in niche]
    assert degrees == ([] if degree is None else [pytest.approx(degree)])


def test_a_return_to_the_lane_is_a_near_miss_of_passing_the_destination():
    ego = straight()
    ego[:, 1] = -3.5 * np.clip(3.0 - np.abs(TIME - 4.0), 0.0, 1.0)
    passed = {niche: degree for niche, (degree, _) in found(drive(ego)).items() if "passed-it" in niche}
    left = np.hypot(8.0 * (9.95 - 6.45), 3.5 * 0.55)  # to the destination, from where half a lane was left [m]
    assert passed == {"R3/changing-right/passed-it-on-the-left/having-left-its-lane": pytest.approx(0.01 + left / 200)}


def test_a_violation_is_kept_alone_with_degree_0():
    ego = straight()
    trace = make_trace(ego, [straight(x=4.5)], destination=ego[-1, :2])
    hit = replace(trace, end="collision")
    verdict = judge(hit)
    assert verdict.violated == ("collision",)
    assert found(hit, verdict) == {"R1/going-straight/leading/car-sized/moving": (0.0, 0)}


def test_a_collision_that_the_npc_caused_and_an_error_are_not_kept():
    ego, rammed = straight(speed=5.0), straight(x=-4.6 - 3.0 * TIME[-1], speed=8.0)
    trace = replace(make_trace(ego, [rammed], destination=ego[-1, :2]), end="collision")
    verdict = judge(trace)
    assert verdict.violated == ("collision",)
    assert not found(trace, verdict)
    assert not found(trace, Verdict(verdict.degrees, ("error",)))


def test_a_spec_of_a_user_has_a_niche_with_its_own_degree():
    trace = drive(straight())
    misses = found(trace, Verdict({**judge(trace).degrees, "no-hard-braking": 2.5}, ()))
    assert misses["no-hard-braking/going-straight/ended-by-arrived"] == (0.01 + 2.5, -1)


def test_the_partner_for_a_spec_of_a_user_is_the_vehicle_that_is_nearest_in_the_end():
    """The other one was nearer until then, and is nearer to the center line, beside which the ego drives."""
    left, right = straight(y=4.5), straight(y=-6.0)
    left[-1, 1], right[-1, 1] = -3.0, 4.0
    misses = found(drive(straight(y=1.0), left, right), Verdict({"own": -1.0}, ()), reach=0.0)
    assert misses == {"own/going-straight/ended-by-arrived": (0.01, 1)}
