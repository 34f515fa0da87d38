"""The end of an episode that arrives does not depend on where its frames lie."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from behavexplor.data.conventions import ARRIVAL_DISTANCE
from behavexplor.judge.specs import Collision, Destination, Lines, final_distance, judge, poses_until_arrival
from tests.fakes import RATE, make_trace

STEP = 1 / RATE  # [s]
ROUNDED = 1e-7  # [m]; positions of a trace are rounded to 1e-9 m

speeds = st.floats(0.5, 11.2)
offsets = st.floats(-0.9, 0.9)  # beyond, an ego could pass between two frames without being seen within 1 m
phases = st.floats(0, 1, exclude_max=True)
curvatures = st.integers(-100, 100).map(lambda thousandths: thousandths / 1000)  # [1/m]


def arriving(speed, offset, phase, curvature=0.0, npcs=(), lines=()):
    """An ego on a circle that passes the destination at an offset, seen in frames of a phase until it has arrived.

    The way to the destination begins 20 m before it. NPCs are functions of time since the ego's nearest moment [s].
    """
    time = (np.arange(int(40 / speed * RATE)) + phase) * STEP - 20 / speed
    along = speed * time
    turned = along * curvature
    x = along * np.sinc(turned / np.pi)
    y = offset + along * np.sinc(turned / 2 / np.pi) * np.sin(turned / 2)
    seen = np.flatnonzero(np.hypot(x, y) <= ARRIVAL_DISTANCE)[0] + 1
    ego = np.stack([x, y, turned], axis=1)[:seen]
    trace = make_trace(ego, [npc(time[:seen]) for npc in npcs], lines=lines)
    return replace(trace, end="arrived")


def closest(offset, curvature):
    """Distance of the destination from the circle."""
    if curvature == 0:
        return abs(offset)
    return abs(abs(offset + 1 / curvature) - abs(1 / curvature))


@given(speeds, offsets, phases, phases)
def test_the_phase_of_sampling_does_not_change_the_degree_of_a_straight_arrival(speed, offset, one, other):
    first, second = (Destination().degree(arriving(speed, offset, phase)) for phase in (one, other))
    assert first == pytest.approx(second, abs=ROUNDED)
    assert first == pytest.approx(10 - abs(offset), abs=ROUNDED)


@given(speeds, offsets, phases, curvatures)
def test_on_a_curve_the_closest_approach_is_exact_to_the_stated_bound(speed, offset, phase, curvature):
    """The straight line through two points of a parabola y = k x^2 / 2 is k x (x - h) / 2 away from it at a point x.

    The first point is at 0, the second at h, and the closest approach lies at most r behind the second, so that the
    bound is k r (r + h) / 2 for small angles. For two phases it is twice that.
    """
    step = speed * STEP
    found = final_distance(arriving(speed, offset, phase, curvature))
    reach = ARRIVAL_DISTANCE
    assert abs(found - closest(offset, curvature)) <= 1.05 * abs(curvature) * reach * (reach + step) / 2 + ROUNDED


def test_what_the_last_frame_says_depends_on_the_phase():
    """By up to the way of a frame, which is what this mends."""
    last = [arriving(11.0, 0.0, phase).destination_distance for phase in np.linspace(0, 0.99, 50)]
    assert max(last) - min(last) > 0.5


@given(speeds, offsets, phases, phases, st.floats(-11, 11), st.floats(8, 12))
def test_a_vehicle_that_comes_nearer_until_the_end_counts_until_the_moment_of_arrival(
    speed, offset, one, other, oncoming, gap
):
    def npc(time):
        return np.stack([gap - oncoming * time, 0 * time, 0 * time], axis=1)

    assume(oncoming + speed > 0)
    first, second = (Collision().degree(arriving(speed, offset, phase, npcs=[npc])) for phase in (one, other))
    assert first == pytest.approx(second, abs=ROUNDED)


@given(speeds, phases, phases, st.floats(-0.5, 0.5))
def test_a_line_that_comes_nearer_until_the_end_counts_until_the_moment_of_arrival(speed, one, other, slope):
    line = [[(-50.0, 4.0 - 50 * slope), (50.0, 4.0 + 50 * slope)]]
    first, second = (Lines().degree(arriving(speed, 0.0, phase, lines=line)) for phase in (one, other))
    if slope <= 0:  # the line comes nearer
        assert first == pytest.approx(second, abs=ROUNDED)
    else:
        assert abs(first - second) <= speed * STEP * slope + ROUNDED  # the first frame has a phase, too


@given(speeds, offsets, phases)
def test_the_last_frame_is_moved_to_the_moment_of_arrival(speed, offset, phase):
    trace = arriving(speed, offset, phase, npcs=[lambda time: np.stack([30 + 5 * time, 0 * time, 0 * time], axis=1)])
    position, heading = poses_until_arrival(trace)
    assert np.hypot(*position[-1, 0]) == pytest.approx(ARRIVAL_DISTANCE, abs=ROUNDED)
    share = (position[-1, 0, 0] - trace.position[-2, 0, 0]) / (speed * STEP)
    assert -ROUNDED <= share <= 1 + ROUNDED
    expected = (1 - share) * trace.position[-2] + share * trace.position[-1]
    assert position[-1] == pytest.approx(expected, abs=1e-5)
    assert (position[:-1] == trace.position[:-1]).all()
    assert (heading == trace.heading).all()


def test_an_ego_that_was_seen_just_at_the_distance_of_arrival():
    """The trace rounds the frame before the last one onto the circle."""
    trace = arriving(0.95, 0.0, 0.0)
    assert np.hypot(*trace.position[-2, 0]) == ARRIVAL_DISTANCE
    assert poses_until_arrival(trace)[0][-1, 0] == pytest.approx([-1.0, 0.0])


def test_headings_turn_the_short_way():
    ego = np.array([[-2.0, 0.0, 3.1], [-0.5, 0.0, -3.1]])
    _, heading = poses_until_arrival(replace(make_trace(ego), end="arrived"))
    assert abs(abs(heading[-1, 0]) - np.pi) < 0.05


@pytest.mark.parametrize("end", ["timeout", "passed", "collision", "standstill"])
def test_other_ends_are_judged_by_their_last_frame(end):
    trace = replace(arriving(10.0, 0.5, 0.3), end=end)
    position, heading = poses_until_arrival(trace)
    assert position is trace.position
    assert heading is trace.heading
    assert final_distance(trace) == trace.destination_distance > 0.5


def test_an_ego_that_stands_or_was_there_from_the_start():
    still = replace(make_trace(np.full((5, 3), [0.6, 0.0, 0.0])), end="arrived")
    assert (poses_until_arrival(still)[0] == still.position).all()
    assert final_distance(still) == pytest.approx(0.6)
    alone = replace(make_trace([(0.5, 0.0, 0.0)]), end="arrived")
    assert (poses_until_arrival(alone)[0] == alone.position).all()
    assert final_distance(alone) == pytest.approx(0.5)


def test_a_course_is_not_continued_beyond_the_reach_of_an_arrival():
    """A trace from elsewhere that calls itself arrived far away is not at its destination."""
    far = replace(make_trace([(-20.0, 0.0, 0.0), (-19.0, 0.0, 0.0)]), end="arrived")
    assert final_distance(far) == pytest.approx(18.0)
    assert judge(far).violated == ("destination",)
