"""The motion of NPCs: exact between waypoints, never impossible, and parked in the end."""

import numpy as np
import pytest
from hypothesis import given

from behavexplor.data.npc_motion import ACCELERATION, HEADING, MAX_ACCELERATION, MIN_ACCELERATION, SPEED, motion_table
from behavexplor.data.scripted import NPC, ScriptedScenario, Waypoint
from behavexplor.envs.functional import IntersectionStraightEnv
from tests.strategies import scenarios

LOGICAL = IntersectionStraightEnv.logical

ROADMAP = LOGICAL.roadmap
TIME = np.arange(4001) / 20


def motion(waypoints, time=TIME, route="west-inner-straight"):
    npc = NPC("sedan", route, tuple(Waypoint(*pair) for pair in waypoints))
    return motion_table(ScriptedScenario("x", (npc,)), ROADMAP, np.asarray(time, dtype=float))[:, 0]


def stations(table):
    """Of a vehicle that drives east from x = -135 m, where its route begins."""
    return table[:, 0] + 135.0


def test_constant_acceleration_between_waypoints():
    # from 2 to 4 m/s in 12 m: v^2 grows by 12 in 12 m, so a = 0.5 m/s2, for 4 s; then 4 m/s for 2 s
    table = motion([(10, 2), (22, 4), (30, 4), (100, 4)], time=[0, 1, 2, 4, 5, 6])
    assert stations(table) == pytest.approx([10, 12.25, 15, 22, 26, 30])
    assert table[:, SPEED] == pytest.approx([2, 2.5, 3, 4, 4, 4])
    assert table[[0, 1, 2, 3, 4], ACCELERATION] == pytest.approx([0.5, 0.5, 0.5, 0, 0])


def test_a_speed_out_of_reach_is_approached_at_the_limit():
    # 2 m/s, 3 m to go: at 4 m/s2 the speed becomes sqrt(4 + 24)
    faster = motion([(10, 2), (13, 11), (100, 11)], time=[0, (28**0.5 - 2) / 4])
    assert faster[0, ACCELERATION] == MAX_ACCELERATION
    assert faster[1, SPEED] == pytest.approx(28**0.5)
    slower = motion([(10, 10), (12, 1), (100, 1)], time=[0, (10 - 68**0.5) / 8])
    assert slower[0, ACCELERATION] == MIN_ACCELERATION
    assert slower[1, SPEED] == pytest.approx(68**0.5)


def test_it_parks_at_the_last_waypoint():
    table = motion([(10, 5), (20, 5), (40, 0)])
    assert stations(table)[-1] == pytest.approx(40)
    assert table[-1, SPEED] == table[-1, ACCELERATION] == 0


def test_too_fast_for_the_last_waypoint_it_brakes_as_hard_as_it_may():
    table = motion([(10, 8), (30, 8), (30, 0)])
    assert stations(table)[-1] == pytest.approx(30 + 8**2 / 16)
    assert table[-1, SPEED] == 0


def test_waypoints_at_one_place():
    table = motion([(10, 5), (10, 3), (10, 7), (40, 0)])
    assert table[0, SPEED] == 5
    assert stations(table)[-1] == pytest.approx(40)


@given(scenarios(LOGICAL))
def test_motion_is_possible(scenario):
    table = motion_table(scenario, ROADMAP, TIME)
    step = np.hypot(*np.moveaxis(np.diff(table[..., :2], axis=0), -1, 0))
    before, after = table[:-1, :, SPEED], table[1:, :, SPEED]
    dt = 0.05
    # a chord is no longer than what was driven, and no acceleration exceeds the limits
    assert (step <= np.maximum(before, after) * dt + MAX_ACCELERATION * dt**2 + 1e-9).all()
    assert (after - before <= MAX_ACCELERATION * dt + 1e-9).all()
    assert (after - before >= MIN_ACCELERATION * dt - 1e-9).all()
    assert (table[..., SPEED] >= 0).all()
    assert (table[..., SPEED] <= ROADMAP.speed_limit + 1e-9).all()
    turn = np.abs(np.diff(np.unwrap(table[..., HEADING], axis=0), axis=0))
    assert (turn <= step / 9.75 * 1.01 + 1e-9).all()  # the tightest lane has a radius of 9.75 m


@given(scenarios(LOGICAL))
def test_motion_passes_the_waypoints(scenario):
    table = motion_table(scenario, ROADMAP, np.arange(20_001) / 10)
    for i, npc in enumerate(scenario.npcs):
        route = ROADMAP.routes[npc.route]
        assert table[0, i, :3] == pytest.approx(route.pose(npc.waypoints[0].position))
        assert table[0, i, SPEED] == npc.waypoints[0].speed
        parked = table[-1, i]
        if parked[SPEED] == 0:
            overrun = np.hypot(*(parked[:2] - route.pose(npc.waypoints[-1].position)[:2]))
            assert overrun <= ROADMAP.speed_limit**2 / 16 + 1e-9


def test_motion_depends_on_nothing_but_the_scenario():
    scenario = LOGICAL.sample(np.random.default_rng(3))
    every, some = motion_table(scenario, ROADMAP, TIME), motion_table(scenario, ROADMAP, TIME[::7])
    assert np.array_equal(every[::7], some)
