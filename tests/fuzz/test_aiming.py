"""Aimed vehicles: where they meet a recorded drive, and which meetings do not count."""

from dataclasses import replace

import numpy as np
import pytest

from behavexplor.data.npc_motion import HEADING, X, Y, motion_on_route, motion_table
from behavexplor.data.scripted import ScriptedScenario
from behavexplor.envs.functional import IntersectionLeftEnv, LaneChangeEnv
from behavexplor.fuzz.aiming import INTERVAL, Aiming, AimingOptions, Drive
from tests.fakes import LOGICAL, make_trace

LOGICALS = [LOGICAL, IntersectionLeftEnv.logical, LaneChangeEnv.logical]


def drive_along(logical, speed=8.0, seconds=30.0):
    """The drive of an ego along its route with constant speed."""
    time = np.arange(0.0, seconds, 0.05)
    return Drive.of(make_trace(logical.roadmap.ego_route.pose(logical.roadmap.ego_start + speed * time)))


def nearest(logical, npc, drive):
    """Distance of the centers, and the row of the drive, where a vehicle is nearest to the ego."""
    motion = motion_table(ScriptedScenario(logical.name, (npc,)), logical.roadmap, drive.time)[:, 0]
    gap = np.hypot(*(motion[:, [X, Y]] - drive.pose[:, :2]).T)
    return gap.min(), int(gap.argmin()), motion


@pytest.mark.parametrize("logical", LOGICALS, ids=lambda logical: logical.name)
def test_an_aimed_vehicle_meets_the_drive(logical):
    drive, aiming = drive_along(logical), Aiming(logical, AimingOptions())
    npcs = [aiming.aim(np.random.default_rng(seed), drive, []) for seed in range(20)]
    found = [npc for npc in npcs if npc is not None]
    assert len(found) >= 15
    for npc in found:
        logical.check(ScriptedScenario(logical.name, (npc,)))
        assert nearest(logical, npc, drive)[0] < AimingOptions().reach


def test_uniform_vehicles_meet_it_seldom():
    """Otherwise the test above would show nothing."""
    drive, rng = drive_along(LOGICAL), np.random.default_rng(0)
    met = [nearest(LOGICAL, LOGICAL.sample_npc(rng), drive)[0] < AimingOptions().reach for _ in range(200)]
    assert np.mean(met) < 0.4


@pytest.mark.parametrize(("logical", "seconds"), [(LaneChangeEnv.logical, 30.0), (IntersectionLeftEnv.logical, 20.0)])
def test_a_vehicle_from_behind_in_the_ego_s_lane_is_not_taken(logical, seconds):
    """Whichever way the ego goes: to the east, or to the north up to the intersection."""
    drive, aiming = drive_along(logical, 3.0, seconds), Aiming(logical, AimingOptions(changing_share=0.0))
    found = [aiming.aim(np.random.default_rng(seed), drive, []) for seed in range(40)]
    assert found.count(None) < 20
    for npc in filter(None, found):
        _, row, motion = nearest(logical, npc, drive)
        (x, y), heading = motion[row, [X, Y]] - drive.pose[row, :2], drive.pose[row, 2]
        ahead, right = x * np.cos(heading) + y * np.sin(heading), y * np.cos(heading) - x * np.sin(heading)
        assert not (ahead < 0 and abs(right) < 1.75 and np.cos(motion[row, HEADING] - heading) > 0.7)


def test_a_standing_ego_cannot_be_met():
    drive = drive_along(LOGICAL, speed=0.0)
    assert Aiming(LOGICAL, AimingOptions()).aim(np.random.default_rng(0), drive, []) is None


def test_an_aimed_vehicle_can_start_beside_others():
    drive, aiming, rng = drive_along(LOGICAL), Aiming(LOGICAL, AimingOptions()), np.random.default_rng(3)
    npcs = []
    for _ in range(LOGICAL.n_npcs):
        npc = aiming.aim(rng, drive, npcs)
        npcs += [] if npc is None else [npc]
    assert len(npcs) == LOGICAL.n_npcs
    LOGICAL.check(ScriptedScenario(LOGICAL.name, tuple(npcs)))


def changing_lanes():
    """A drive whose lateral place changes from 8 s to 12 s, and so its drift from 8 s to 15 s."""
    time = np.arange(0.0, 30.0, 0.05)
    y = 3.5 * np.clip((time - 8.0) / 4.0, 0.0, 1.0)
    return Drive.of(make_trace(np.stack([8.0 * time, y, 0 * time], axis=1)))


def test_a_drive_has_the_ego_s_motion_every_quarter_of_a_second():
    time = np.arange(0.0, 2.01, 0.05)
    trace = make_trace(np.stack([4.0 * time, 3.0 * time, 0.1 * time], axis=1))
    drive = Drive.of(trace)
    assert drive.time == pytest.approx(np.arange(0.0, 2.01, 0.25))
    assert drive.frame.tolist() == [0, 5, 10, 15, 20, 25, 30, 35, 40]
    assert drive.pose == pytest.approx(np.stack([4.0 * drive.time, 3.0 * drive.time, 0.1 * drive.time], axis=1))
    assert drive.speed == pytest.approx(np.full(9, 5.0))


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_a_share_of_the_vehicles_is_aimed_at_the_change_of_lanes(share):
    drive, times = changing_lanes(), []

    def watched(roadmap, route, waypoints, part):
        times.append(len(part))
        return motion_on_route(roadmap, route, waypoints, part)

    aiming, rng = Aiming(LOGICAL, AimingOptions(draws=1, changing_share=share), watched), np.random.default_rng(0)
    for _ in range(60):
        aiming.aim(rng, drive, [])
    assert set(times) <= {len(drive.time), len(drive.changing.time)}
    assert np.mean(np.array(times) == len(drive.changing.time)) == pytest.approx(share, abs=0.08)


def test_a_drive_is_sampled_evenly_and_knows_where_the_ego_changed_lanes():
    drive = changing_lanes()
    np.testing.assert_allclose(np.diff(drive.time), INTERVAL, atol=0.051)
    assert drive.drift.max() == pytest.approx(3.5 * 3 / 4, abs=0.1)  # three of the four seconds of the change
    assert 8.0 < drive.changing.time.min() < drive.changing.time.max() < 15.0


@pytest.mark.parametrize("slowest", [0.0, 0.2])
def test_drawn_vehicles_are_valid_and_often_slow(slowest):
    logical = replace(LOGICAL, min_speed=slowest)
    aiming = Aiming(logical, AimingOptions(draws=400))
    route = logical.roadmap.npc_routes[0]
    waypoints = aiming._draw(np.random.default_rng(0), route)
    low, high = logical.position_ranges(route).T
    assert ((waypoints[..., 0] >= low) & (waypoints[..., 0] <= high)).all()
    assert (np.diff(waypoints[..., 0], axis=1) >= 0).all()
    assert (waypoints[:, -1, 1] == 0).all()
    speed = waypoints[:, :-1, 1]
    assert ((speed >= logical.speed_range[0]) & (speed <= logical.speed_range[1])).all()
    if slowest:
        assert np.mean(speed < 2.0) > 0.3


def test_half_of_the_vehicles_have_uniform_speeds_and_a_quarter_one_speed_of_any_magnitude():
    logical = replace(LOGICAL, min_speed=0.2)
    route, (slowest, fastest) = logical.roadmap.npc_routes[0], logical.speed_range
    aiming, rng = Aiming(logical, AimingOptions(draws=1000)), np.random.default_rng(0)
    waypoints = np.concatenate([aiming._draw(rng, route) for _ in range(4)])
    flat = [1 / 2, 1 / np.sqrt(12)]  # mean and deviation of what is uniform in [0, 1]
    low, high = logical.position_ranges(route)[0]
    first, speed = (waypoints[:, 0, 0] - low) / (high - low), waypoints[:, :-1, 1]
    assert [first.mean(), first.std()] == pytest.approx(flat, abs=0.02)
    is_one = np.ptp(speed, axis=1) == 0
    assert is_one.mean() == pytest.approx(1 / 4, abs=0.02)
    magnitude = np.log(speed / slowest) / np.log(fastest / slowest)
    assert [magnitude[is_one, 0].mean(), magnitude[is_one, 0].std()] == pytest.approx(flat, abs=0.03)
    for limit in (1.0, 3.0, 6.0):  # of the others, two thirds are uniform
        below = (limit - slowest) / (fastest - slowest), np.log(limit / slowest) / np.log(fastest / slowest)
        assert (speed[~is_one] < limit).mean() == pytest.approx(2 / 3 * below[0] + 1 / 3 * below[1], abs=0.02)
