from dataclasses import replace

import numpy as np
import pytest

from behavexplor.judge.signals import acceleration, gap_ahead, speed
from behavexplor.judge.specs import NOTHING_NEAR
from tests.fakes import make_trace
from tests.judge.traces import driven, views

EGO = (4.70, 2.06)
CAR = (4.0, 2.0)
STILL = (0.0, 0.0, 0.0)


def ego_moving(velocity, heading=None, time=None):
    """A trace of an ego alone with these velocities, shape (T, 2); heading along x unless given."""
    poses = np.zeros((len(velocity), 3))
    poses[:, 2] = 0.0 if heading is None else heading
    return replace(make_trace(poses, time=time), velocity=np.array(velocity, dtype=float)[:, None])


def gaps(ego, *npcs, route=None):
    """`gap_ahead` where the ego and each car stand as given, in each of some frames."""
    sizes = [EGO, *[CAR] * len(npcs)]
    return gap_ahead(make_trace(ego, npcs, sizes=sizes, route=route))


def arc(angle, radius=20.0):
    """The pose on a left-hand circle round (0, radius) that begins at the origin towards x, `angle` farther on."""
    return radius * np.sin(angle), radius * (1 - np.cos(angle)), angle


def test_speed_is_that_of_the_motion():
    assert speed(ego_moving([(3, 4), (-5, 0), (0, 0)])).tolist() == [5, 5, 0]


def test_acceleration_is_the_change_to_the_next_frame_in_its_time():
    trace = ego_moving([(4, 0), (5, 0), (2, 0), (2, 0)], time=[0, 0.5, 1.5, 2])
    assert acceleration(trace).tolist() == [2, -3, 0, 0]
    assert acceleration(ego_moving([(4, 0), (5, 0)], time=[0, 0.5])).tolist() == [2, 2]


def test_acceleration_is_along_the_heading():
    assert acceleration(ego_moving([(1, 3), (2, 9)], [np.pi / 2] * 2, [0, 2])) == pytest.approx([3, 3])
    assert acceleration(ego_moving([(-1, 0), (-3, 0)], time=[0, 1])).tolist() == [-2, -2]


def test_a_turn_at_constant_speed_is_no_acceleration():
    heading = np.linspace(0, 3, 30)
    velocity = 8 * np.column_stack([np.cos(heading), np.sin(heading)])
    assert acceleration(ego_moving(velocity, heading)) == pytest.approx(np.zeros(30), abs=1e-6)


def test_a_single_frame_has_no_acceleration():
    assert acceleration(ego_moving([(4, 0)])).tolist() == [0]


@pytest.mark.parametrize(
    ("npc", "gap"),
    [
        pytest.param((20.0, 0.0, 0.0), 20 - 2.35 - 2, id="ahead"),
        pytest.param((20.0, 0.0, np.pi), 20 - 2.35 - 2, id="oncoming"),
        pytest.param((20.0, 0.0, np.pi / 2), 20 - 2.35 - 1, id="across"),
        pytest.param((20.0, 2.02, 0.0), 20 - 2.35 - 2, id="reaches into the corridor"),
        pytest.param((20.0, -2.02, 0.0), 20 - 2.35 - 2, id="reaches into it from the left"),
        pytest.param((20.0, 2.04, 0.0), NOTHING_NEAR, id="beside the corridor"),
        pytest.param((20.0, 2.9, np.pi / 2), 20 - 2.35 - 1, id="across, its front reaches in"),
        pytest.param((-20.0, 0.0, 0.0), NOTHING_NEAR, id="behind"),
        pytest.param((3.0, 0.0, 0.0), 0.0, id="overlaps"),
        pytest.param((120.0, 0.0, 0.0), 120 - 2.35 - 2, id="past the end of the route"),
    ],
)
def test_gap_on_a_straight_by_hand(npc, gap):
    assert gaps(STILL, npc) == pytest.approx([gap], abs=1e-6)


def test_gap_is_to_the_nearest_ahead_in_each_frame():
    ego = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (2.0, 0.0, 0.0)]
    far, behind = [(50.0, 0.0, 0.0)] * 3, [(-8.0, 0.0, 0.0)] * 3
    cuts_in = [(20.0, 4.0, 0.0), (20.0, 1.0, 0.0), (20.0, 0.0, 0.0)]
    assert gaps(ego, far, behind, cuts_in) == pytest.approx([50 - 4.35, 19 - 4.35, 18 - 4.35], abs=1e-6)


def test_the_corridor_is_where_the_ego_is_not_where_its_route_is():
    ego = (0.0, 4.0, 0.0)
    assert gaps(ego, (20.0, 0.0, 0.0)) == pytest.approx([NOTHING_NEAR])
    assert gaps(ego, (20.0, 4.0, 0.0)) == pytest.approx([20 - 4.35], abs=1e-6)


def test_the_corridor_follows_a_curve():
    """A quarter circle: the leader is far to the side, straight ahead is another lane."""
    route = np.column_stack(arc(np.linspace(0, np.pi / 2, 200))[:2])
    assert gaps(arc(0.2), arc(1.2), route=route) == pytest.approx([20 - 4.35], abs=0.02)
    x, y, heading = arc(0.2)
    straight_on = (x + 15 * np.cos(heading), y + 15 * np.sin(heading), heading)
    assert gaps((x, y, heading), straight_on, route=route) == pytest.approx([NOTHING_NEAR])


def test_nobody_ahead_has_a_finite_gap():
    assert gaps([STILL] * 3).tolist() == [NOTHING_NEAR] * 3


@pytest.mark.parametrize(
    ("place", "gap"),
    [
        ((0.5, 0.0, 0.0), 0.0),
        ((0.0, 0.0, 0.0), NOTHING_NEAR),  # not ahead
        ((9.0, 2.0, 0.0), NOTHING_NEAR),  # its side is just at the corridor's
        ((9.0, -2.5, 0.6), 9.0 - 2.0 - 2 * np.cos(0.6) - np.sin(0.6)),
        ((9.0, 2.5, 0.6), 9.0 - 2.0 - 2 * np.cos(0.6) - np.sin(0.6)),
        ((1010.0, 0.0, 0.0), NOTHING_NEAR),
    ],
)
def test_gap_between_cars_at_bounds_and_turned(place, gap):
    trace = driven([0.0, 0.0, 0.0, 5.0], [*place, 0.0])
    assert gap_ahead(trace) == pytest.approx([gap])
    is_on_a_bound = place[0] == 0.0 or place[1] == 2.0
    for seen, _ in views(trace) if not is_on_a_bound else ():
        assert gap_ahead(seen) == pytest.approx([gap])


def test_signals_are_alike_wherever_the_ego_heads():
    """An ego that brakes from 9 m/s to 5 m/s, drifts, and comes nearer to a vehicle that goes at 2 m/s."""
    rows = [[0.0, 0.0, 0.1, 9.0], [1.0, 0.1, 0.2, 8.0], [2.5, 0.3, 0.2, 5.0]]
    npc = [[20.0, 0.5, 0.0, 2.0], [20.4, 0.5, 0.0, 2.0], [21.0, 0.5, 0.0, 2.0]]
    trace = driven(rows, npc, time=[0.0, 0.2, 0.5])
    for seen, _ in views(trace):
        assert speed(seen) == pytest.approx([9.0, 8.0, 5.0])
        assert acceleration(seen) == pytest.approx([-5.0, -10.0, -10.0])
        reach = [2 * np.cos(angle) + np.sin(angle) + 2.0 for angle in (0.1, 0.2, 0.2)]
        assert gap_ahead(seen) == pytest.approx(np.array([20.0, 19.4, 18.5]) - reach)
