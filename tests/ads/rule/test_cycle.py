"""What the planner remembers, decision by decision."""

import numpy as np
import pytest

from behavexplor.ads.road.path import ego_path
from behavexplor.ads.rule import Parameters, RulePlanner
from behavexplor.ads.rule.decision import (
    CRUISE,
    EMERGENCY,
    FOLLOW,
    GO,
    STANDING,
    YIELD,
    can_wait,
    decision_code,
    passed,
    waiting_station,
)
from behavexplor.ads.rule.lane_choice import ABORT, CHANGE, KEEP, EgoState
from behavexplor.ads.rule.memory import as_records
from behavexplor.ads.rule.parameters import numbers
from behavexplor.ads.rule.planner import SHARP_WAY, STUCK, _remember
from behavexplor.ads.rule.speed_search import SpeedPlan
from behavexplor.ads.rule.station_time import N_INTERVALS
from behavexplor.data.conventions import EGO_SIZE
from behavexplor.envs.logical_scenarios import crossing, straight_road
from tests.ads.rule.world import memory_with, scene
from tests.kernel_calls import called_alone

_remember = called_alone(_remember)
can_wait = called_alone(can_wait)
decision_code = called_alone(decision_code)
passed = called_alone(passed)
waiting_station = called_alone(waiting_station)

P = numbers(Parameters())
ROAD, JUNCTION = (ego_path(roadmap) for roadmap in (straight_road(2, 2, 10, 230), crossing("left", 10, 60)))
HALF = EGO_SIZE[0] / 2


def remembered(station=50.0, offset=0.0, speed=5.0, path=ROAD, **known):
    """The memory brought up to date."""
    memory = memory_with(**{"started": 1.0, **known})
    _remember(path, EgoState(station, offset, speed, HALF, 1.03), memory)
    return memory


@pytest.mark.parametrize(("offset", "lane"), [(0.2, 0), (-3.4, -1), (-7.1, -2), (3.6, 1)])
def test_at_first_it_is_in_the_lane_where_it_stands(offset, lane):
    memory = remembered(offset=offset, started=0.0)
    assert (memory.lane, memory.origin, memory.started) == (lane, lane, 1.0)


def test_a_lane_change_ends_at_its_end():
    before = remembered(64.9, -3.5, lane=-1, change_start=50.0, change_length=15.0, maneuver=CHANGE, since=3.0)
    assert (before.change_length, before.maneuver) == (15.0, CHANGE)
    after = remembered(65.0, -3.5, lane=-1, change_start=50.0, change_length=15.0, maneuver=CHANGE, since=3.0)
    assert (after.change_length, after.maneuver, after.since) == (0.0, KEEP, 0.0)


@pytest.mark.parametrize(("offset", "ends"), [(-3.0, True), (-1.0, False)])
def test_who_gets_stuck_in_the_lane_changed_to_decides_anew(offset, ends):
    known = {"lane": -1, "change_start": 50.0, "change_length": 15.0, "maneuver": ABORT}
    assert remembered(55.0, offset, 0.0, stood=STUCK, **known).change_length == 15.0
    assert (remembered(55.0, offset, 0.0, stood=STUCK + 0.1, **known).change_length == 0.0) == ends


def test_standing_and_waiting_are_counted_and_forgotten():
    waiting = remembered(speed=STANDING / 2, stood=2.0, decision=YIELD)
    assert (waiting.stood, waiting.waited) == pytest.approx((2.1, 0.1))
    assert remembered(speed=STANDING / 2, stood=2.0, decision=FOLLOW).waited == 0.0
    assert remembered(speed=STANDING, stood=2.0, decision=YIELD).stood == 0.0


def test_a_sharp_change_and_an_overtaking_are_over_after_a_while():
    assert remembered(50.0 + SHARP_WAY, change_start=50.0, sharp=1.0).sharp == 1.0
    assert remembered(50.1 + SHARP_WAY, change_start=50.0, sharp=1.0).sharp == 0.0
    assert remembered(overtaking=1.0, lane=-1).overtaking == 1.0
    assert remembered(overtaking=1.0, lane=0).overtaking == 0.0


@pytest.mark.parametrize("speed", [0.0, 4.0, 10.0])
def test_it_can_wait_while_firm_braking_stops_it_a_little_behind_the_line(speed):
    braking, line = speed**2 / (2 * P.firm_braking), JUNCTION.junction_start - HALF
    last = line + P.line_overrun - braking
    assert can_wait(JUNCTION, last - 0.01, speed, HALF, P)
    assert not can_wait(JUNCTION, last + 0.01, speed, HALF, P)
    assert waiting_station(JUNCTION, last - 30.0, speed, HALF, P) == line - P.stop_line_gap
    assert waiting_station(JUNCTION, last - 0.5, speed, HALF, P) == pytest.approx(last - 0.5 + braking)
    assert waiting_station(JUNCTION, last + 9.0, speed, HALF, P) == line + P.line_overrun


def test_a_road_without_a_junction_is_passed():
    assert passed(ROAD, 0.0, HALF)
    assert not passed(JUNCTION, JUNCTION.junction_end, HALF)
    assert passed(JUNCTION, JUNCTION.junction_end + HALF, HALF)


@pytest.mark.parametrize(
    ("station", "survived", "free", "yields", "code"),
    [
        (30.0, N_INTERVALS, True, False, CRUISE),
        (30.0, N_INTERVALS, False, False, FOLLOW),
        (30.0, N_INTERVALS, True, True, YIELD),
        (100.0, N_INTERVALS, True, False, GO),
        (100.0, 11, False, True, EMERGENCY),
    ],
)
def test_the_log_says_what_a_plan_amounts_to(station, survived, free, yields, code):
    plan = SpeedPlan(0.0, survived, station + 40.0, 5.0, 0.0, 0.0, free, 0.0)
    assert decision_code(JUNCTION, plan, station, HALF, yields) == code


def test_a_plan_depends_on_nothing_that_earlier_rows_left_in_its_room():
    roadmap = crossing("left", 10, 60)
    planner = RulePlanner(roadmap, Parameters())
    rng = np.random.default_rng(9)
    rows = []
    for _ in range(30):
        cars = [
            (
                *roadmap.npc_routes[rng.integers(len(roadmap.npc_routes))].pose(rng.uniform(40, 120)),
                rng.uniform(0, 11),
                0.0,
            )
            for _ in range(4)
        ]
        rows.append(scene((*roadmap.ego_route.pose(rng.uniform(60, 130)), rng.uniform(0, 9)), cars))
    scenes = np.array(rows)
    forwards, backwards = planner.predict(scenes)[1], planner.predict(scenes[::-1])[1]
    np.testing.assert_array_equal(forwards, backwards[::-1])
    assert len(np.unique(as_records(forwards)["decision"])) > 2
