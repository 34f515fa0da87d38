"""Aimed vehicles: where they meet a recorded drive, and which meetings do not count."""

from dataclasses import replace

import numpy as np
import pytest

from behavexplor.data.npc_motion import HEADING, X, Y, motion_table
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


def test_a_vehicle_from_behind_in_the_ego_s_lane_is_not_taken():
    logical = LaneChangeEnv.logical
    drive, aiming = drive_along(logical, speed=3.0), Aiming(logical, AimingOptions(changing_share=0.0))
    for seed in range(40):
        npc = aiming.aim(np.random.default_rng(seed), drive, [])
        if npc is None:
            continue
        _, row, motion = nearest(logical, npc, drive)
        x, y = motion[row, [X, Y]] - drive.pose[row, :2]
        assert not (x < 0 and abs(y) < 1.75 and abs(motion[row, HEADING]) < 0.8)


def test_a_standing_ego_cannot_be_met():
    drive = drive_along(LOGICAL, speed=0.0)
    assert Aiming(LOGICAL, AimingOptions()).aim(np.random.default_rng(0), drive, []) is None


def test_an_aimed_vehicle_can_start_beside_others():
    drive, aiming, rng = drive_along(LOGICAL), Aiming(LOGICAL, AimingOptions()), np.random.default_rng(3)
    npcs = []
    for _ in range(LOGICAL.n_npcs):
        npc = aiming.aim(rng, drive, npcs)
        npcs += [] if npc is None else [npc]
    LOGICAL.check(ScriptedScenario(LOGICAL.name, tuple(npcs)))


def test_a_drive_is_sampled_evenly_and_knows_where_the_ego_changed_lanes():
    time = np.arange(0.0, 20.0, 0.05)
    y = 3.5 * np.clip((time - 8.0) / 4.0, 0.0, 1.0)
    drive = Drive.of(make_trace(np.stack([8.0 * time, y, 0 * time], axis=1)))
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
