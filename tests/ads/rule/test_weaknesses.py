"""Each weakness at its module: what it does when its gate is open, and that it does nothing when it is closed."""

import numpy as np
import pytest

from behavexplor.ads.road.path import ego_path
from behavexplor.ads.rule import Parameters
from behavexplor.ads.rule.control import change_profile, keep_profile, steer
from behavexplor.ads.rule.lane_choice import EgoState, accepts_gap, choose_lane, gap_share, wrong_side
from behavexplor.ads.rule.parameters import numbers
from behavexplor.ads.rule.station_time import false_motion, true_motion, weaknesses_of_motion
from behavexplor.ads.rule.traffic import locate
from behavexplor.ads.rule.weaknesses import (
    R1_1,
    R1_2,
    R1_4,
    R1_5,
    R1_7,
    R2_1,
    R2_3,
    R2_4,
    R3_1,
    R3_2,
    R3_3,
    REACHED,
    TRIGGERED,
)
from behavexplor.data.conventions import EGO_SIZE, VEHICLE_SIZES
from behavexplor.envs.logical_scenarios import crossing, straight_road
from tests.ads.rule.world import memory_with, scene
from tests.kernel_calls import called_alone

accepts_gap = called_alone(accepts_gap)
change_profile = called_alone(change_profile)
choose_lane = called_alone(choose_lane)
false_motion = called_alone(false_motion)
gap_share = called_alone(gap_share)
keep_profile = called_alone(keep_profile)
locate = called_alone(locate)
steer = called_alone(steer)
true_motion = called_alone(true_motion)
weaknesses_of_motion = called_alone(weaknesses_of_motion)
wrong_side = called_alone(wrong_side)

ROAD, CHANGE = straight_road(2, 2, 10, 230), straight_road(1, 3, 10, 230)
STRAIGHT, LEFT = crossing("straight", 20, 60), crossing("left", 10, 60)


class Situation:
    """The ego on a route among vehicles in its lane (0) or beside it, each (station, lane, speed)."""

    def __init__(self, roadmap, station, speed, npcs, *, lane=0, **weaknesses):
        self.p = numbers(Parameters(**weaknesses))
        self.path = ego_path(roadmap)
        rows = []
        for at, beside, v in npcs:
            x, y, heading = roadmap.ego_route.pose(at)
            rows.append((x - 3.5 * beside * np.sin(heading), y + 3.5 * beside * np.cos(heading), heading, v, 0.0))
        self.scene = scene((*roadmap.ego_route.pose(station), speed), rows)
        self.others = np.empty((len(npcs), 6))
        locate(self.path, self.scene, self.others)
        self.ego = EgoState(station, 3.5 * lane, speed, EGO_SIZE[0] / 2, EGO_SIZE[1] / 2)
        self.memory = memory_with(lane=lane, since=10.0)
        self.bits = np.zeros(2, np.int64)

    def lane(self):
        return choose_lane(self.path, self.others, self.ego, self.memory, self.bits, self.p)

    def borrows(self):
        return wrong_side(self.path, self.others, self.ego, self.memory, self.bits, self.p)

    def accepts(self, lane):
        return accepts_gap(self.path, self.others, self.ego, lane, self.bits, self.p)


def motion(npc, size="sedan", others=(), **weaknesses):
    """Bits of the weaknesses whose gates the first NPC opens, and how it is predicted, truly and falsely."""
    p = numbers(Parameters(**weaknesses))
    view = scene((0.0, 0.0, 0.0, 5.0), [npc, *others])
    view[1, 6:8] = VEHICLE_SIZES[size]
    true = true_motion(ego_path(ROAD), view, 1, p)
    weak = weaknesses_of_motion(view, 1, true, p)
    return weak, true, false_motion(true, weak, p)


def test_r1_1_a_hidden_vehicle_is_taken_for_a_standing_one():
    hiding = (20.0, 0.0, 0.0, 5.0, 0.0)
    weak, true, false = motion((40.0, 0.5, 0.0, 7.0, 1.0), others=[hiding], occlusion=0.5)
    assert weak == R1_1
    assert (true.speed, false.speed, false.acceleration) == (7.0, 0.0, 0.0)
    assert motion((40.0, 30.0, 0.0, 7.0, 1.0), others=[hiding], occlusion=0.5)[0] == 0


def test_r1_2_a_slow_vehicle_is_taken_for_a_standing_one():
    weak, _, false = motion((40.0, 0.0, 0.0, 1.5, 0.0), static_speed=2.0)
    assert (weak, false.speed) == (R1_2, 0.0)
    assert motion((40.0, 0.0, 0.0, 2.5, 0.0), static_speed=2.0)[0] == 0
    assert motion((40.0, 0.0, 0.0, 0.0, 0.0), static_speed=2.0)[0] == 0


def test_r1_4_a_sudden_change_is_not_predicted():
    weak, true, false = motion((40.0, 0.0, 0.0, 5.0, -6.0), weak_braking=4.0)
    assert (weak, false.memory) == (R1_4, 0.0)
    assert true.memory > 0
    assert motion((40.0, 0.0, 0.0, 5.0, -1.0), weak_braking=4.0)[0] == 0


def test_r1_7_a_bus_shrinks_towards_a_car_on_curves_only():
    bus = VEHICLE_SIZES["school-bus"]
    for severity in (0.5, 1.0):
        weak, _, false = motion((40.0, 0.0, 0.0, 5.0, 0.0), "school-bus", narrow_bus=severity)
        assert weak == R1_7
        assert (false.length, false.width) == bus
        expected = [size - severity * (size - car) for size, car in zip(bus, (4.6, 1.9), strict=True)]
        assert (false.turning_length, false.turning_width) == pytest.approx(expected)
    assert motion((40.0, 0.0, 0.0, 5.0, 0.0), narrow_bus=1.0)[0] == 0


def test_without_weaknesses_prediction_is_the_true_one():
    weak, true, false = motion((40.0, 0.5, 0.0, 1.0, -6.0), "school-bus", others=[(20.0, 0.0, 0.0, 5.0, 0.0)])
    assert weak == 0
    assert false == true


@pytest.mark.parametrize(("gap", "share"), [(14.0, 0.28), (25.0, 1.31)])
def test_gaps_are_measured_by_distance_and_closing_speed(gap, share):
    at = Situation(ROAD, 100.0, 3.0, [(100 - gap, 1, 8.0)])
    bumpers = gap - (EGO_SIZE[0] + VEHICLE_SIZES["sedan"][0]) / 2
    assert gap_share(at.path, at.others, at.ego, 1, at.p) == pytest.approx(bumpers / (3 + 4 * 5))
    assert at.accepts(1) == (bumpers / 23 >= 1.0)
    assert share > 0


def test_r1_5_smaller_gaps_are_accepted():
    behind = [(80.0, 1, 8.0)]
    assert not Situation(ROAD, 100.0, 3.0, behind).accepts(1)
    weak = Situation(ROAD, 100.0, 3.0, behind, cut_in=0.5)
    assert weak.accepts(1)
    assert weak.bits[TRIGGERED] == R1_5
    wide = Situation(ROAD, 100.0, 3.0, [], cut_in=0.5)
    assert wide.accepts(1)
    assert wide.bits[REACHED] == 0


def test_a_slow_leader_is_overtaken_and_r3_1_follows_it():
    slow = [(70.0, 0, 1.0)]
    assert Situation(ROAD, 40.0, 5.0, slow).lane() in (-1, 1)
    weak = Situation(ROAD, 40.0, 5.0, slow, no_overtaking=2.0)
    assert weak.lane() == 0
    assert weak.bits[TRIGGERED] == R3_1
    standing = Situation(ROAD, 40.0, 5.0, [(70.0, 0, 0.0)], no_overtaking=2.0)
    assert standing.lane() in (-1, 1)
    assert standing.bits[REACHED] == 0


def test_r3_2_overtakes_without_room_to_come_back():
    near = [(215.0, 0, 1.0)]
    assert Situation(ROAD, 190.0, 5.0, near).lane() == 0
    weak = Situation(ROAD, 190.0, 5.0, near, no_room=0.6)
    assert weak.lane() != 0
    assert weak.bits[TRIGGERED] == R3_2


def test_r3_3_puts_off_a_needed_change_behind_a_slow_leader():
    slow = [(60.0, -2, 3.0)]
    assert Situation(CHANGE, 40.0, 5.0, slow, lane=-2).lane() == -1
    weak = Situation(CHANGE, 40.0, 5.0, slow, lane=-2, late_change=0.8)
    assert weak.lane() == -2
    assert weak.bits[TRIGGERED] == R3_3
    assert Situation(CHANGE, 205.0, 5.0, [(225.0, -2, 3.0)], lane=-2, late_change=0.8).lane() == -1
    assert Situation(CHANGE, 40.0, 5.0, [(60.0, -2, 9.0)], lane=-2, late_change=0.8).lane() == -1


def test_r2_3_takes_the_other_directions_lane_and_the_careful_planner_never_does():
    slow = [(40.0, 0, 0.5)]
    assert Situation(STRAIGHT, 30.0, 2.0, slow).borrows() == 0
    weak = Situation(STRAIGHT, 30.0, 2.0, slow, wrong_side=2.0)
    assert weak.borrows() == -1
    assert weak.bits[TRIGGERED] == R2_3
    assert Situation(STRAIGHT, 30.0, 2.0, [(40.0, 0, 3.0)], wrong_side=2.0).borrows() == 0
    assert Situation(STRAIGHT, 30.0, 7.0, slow, wrong_side=2.0).borrows() == 0
    assert Situation(ROAD, 30.0, 2.0, slow, wrong_side=2.0).borrows() == 0


def steering(roadmap, station, speed, profile, turned=0.0, last=0.0, memories=(), **weaknesses):
    x, y, heading = roadmap.ego_route.pose(station)
    bits = np.zeros(2, np.int64)
    memory = memory_with(last_steering=last, **dict.fromkeys(memories, 1.0))
    view = scene((x, y, heading + turned, speed))
    p = numbers(Parameters(**weaknesses))
    return steer(ego_path(roadmap), profile, view, station, memory, bits, p), bits


def test_r2_1_steers_back_with_less_than_it_takes():
    change = change_profile(90.0, 3.5, 0.0, 0.0, 30.0)  # back to the left, now to be straightened
    careful, _ = steering(ROAD, 119.0, 9.0, change, turned=-0.15)
    weak, bits = steering(ROAD, 119.0, 9.0, change, turned=-0.15, memories=["overtaking"], slow_recovery=0.7)
    assert careful > 0
    assert 0 < weak < careful
    assert bits[TRIGGERED] == R2_1
    assert steering(ROAD, 119.0, 9.0, change, turned=-0.15, slow_recovery=0.7)[0] == careful


def test_r2_2_looks_less_far_ahead():
    step = change_profile(100.0, 0.0, 0.0, 3.5, 15.0)
    careful, _ = steering(ROAD, 103.0, 4.0, step, steering_rate=100.0)
    sharp, _ = steering(ROAD, 103.0, 4.0, step, memories=["sharp"], short_change=0.6, steering_rate=100.0)
    assert abs(sharp - careful) > 0.01


def test_r2_4_holds_the_angle_of_a_slow_left_turn_behind_the_turn():
    end = float(LEFT.ego_route.bounds[2])
    careful, _ = steering(LEFT, end + 1.0, 3.0, keep_profile(0.0), last=-0.27)
    weak, bits = steering(LEFT, end + 1.0, 3.0, keep_profile(0.0), last=-0.27, held_steering=1.0)
    assert careful == pytest.approx(-0.19)
    assert weak == -0.27
    assert bits[TRIGGERED] == R2_4
    assert steering(LEFT, end + 1.0, 6.0, keep_profile(0.0), last=-0.27, held_steering=1.0)[0] == careful
    assert steering(STRAIGHT, 60.0, 3.0, keep_profile(0.0), last=-0.27, held_steering=1.0)[1][REACHED] == 0
