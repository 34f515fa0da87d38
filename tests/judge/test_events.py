"""Where a violation happened: against shapely, frame by frame, and by hand."""

import numpy as np
import pytest
import shapely

from behavexplor.data.geometry import box_corners
from behavexplor.judge.events import ViolationEvent, first_line_touch, recent_decisions, violation_event
from tests.judge.traces import driven, views


def touch_by_shapely(trace):
    """The first frame in which the ego's box touches a line, and the first such line; None if there is none."""
    boxes = box_corners(trace.position[:, 0], trace.heading[:, 0], trace.size[0])
    for frame, box in enumerate(boxes):
        apart = [shapely.Polygon(box).distance(shapely.LineString(line)) for line in trace.illegal_lines]
        if 0.0 in apart:
            return ViolationEvent("R2", frame, apart.index(0.0))
    return None


def test_the_first_touch_of_many_lines_is_that_of_shapely():
    """In drives of any number of frames, some of them fast and some turning, among lines of any kind."""
    rng, touched = np.random.default_rng(0), []
    for _ in range(60):
        frames, lines = int(rng.integers(1, 41)), int(rng.integers(1, 9))
        steps = rng.normal(0, rng.choice([0.1, 1.0, 5.0]), (frames, 2))
        ego = np.column_stack([rng.uniform(-30, 30, 2) + np.cumsum(steps, 0), rng.uniform(-4, 4, (frames, 2))])
        starts = rng.uniform(-40, 40, (lines, 1, 2))
        trace = driven(ego, illegal_lines=starts + rng.uniform(-20, 20, (lines, 2, 2)), sizes=[rng.uniform(1, (9, 3))])
        expected = touch_by_shapely(trace)
        assert first_line_touch(trace) == expected
        touched.append(expected is not None and expected.frame)
    assert len(set(touched)) > 5  # never, at once, and later


@pytest.mark.parametrize("frame", [0, 1, 7, 8, 9, 15, 16, 19])
def test_a_touch_of_one_frame_is_found_wherever_it_is(frame):
    """A vehicle that turns on the spot, 2 m long to each side and 1 m wide, beside lines."""
    ego = np.zeros((20, 4))
    ego[frame, 2] = np.pi / 2
    lines = np.array([[[-9.0, 50.0], [9.0, 50.0]], [[-9.0, 1.9], [9.0, 1.9]], [[-9.0, -1.9], [9.0, -1.9]]])
    for seen, _ in views(driven(ego, illegal_lines=lines)):
        assert first_line_touch(seen) == violation_event(seen, ["lines"]) == ViolationEvent("R2", frame, 1)
    assert first_line_touch(driven(np.zeros((20, 4)), illegal_lines=lines)) is None


def test_a_line_that_touches_a_corner_only_is_touched():
    """A box of 8 m times 6 m has a corner 5 m from its middle, and the line is tangent to the circle through it."""
    lines = [[[7.0, -1.0], [1.0, 7.0]]]
    assert first_line_touch(driven(np.zeros(4), illegal_lines=lines, sizes=[(8.0, 6.0)])) == ViolationEvent("R2", 0, 0)


def test_a_line_at_the_resolution_of_a_trace_is_touched():
    lines = [[[-9.0, gap], [9.0, gap]] for gap in (1.0 + 1e-6, 1.0 + 0.9e-9)]
    assert first_line_touch(driven(np.zeros(4), illegal_lines=lines)) == ViolationEvent("R2", 0, 1)
    assert first_line_touch(driven(np.zeros(4))) is None


@pytest.mark.parametrize(
    ("violated", "expected"),
    [
        ([], None),
        (["error"], None),
        (["collision"], ViolationEvent("R1", 4, 2)),
        (["mine", "destination", "lines", "collision"], ViolationEvent("R1", 4, 2)),
        (["mine", "destination", "lines"], ViolationEvent("R2", 3, 0)),
        (["mine", "destination"], ViolationEvent("R3", 4, -1)),
        (["mine", "yours"], ViolationEvent("mine", 4, -1)),
    ],
)
def test_the_first_violated_spec_tells_the_event(violated, expected):
    ego = np.column_stack([np.arange(5.0), np.zeros((5, 3))])
    far, near = np.full((5, 4), 60.0), np.full((5, 4), [7.0, 0.0, 0.0, 0.0])
    trace = driven(ego, far, near, illegal_lines=[[[5.0, -3.0], [5.0, 3.0]]])
    assert violation_event(trace, violated) == expected


def test_a_collision_without_a_vehicle_has_no_event():
    assert violation_event(driven(np.zeros(4), np.full(4, 60.0)), ["collision"]) is None


def test_an_ego_leaves_the_road_in_the_first_frame_that_says_so():
    trace = driven(np.zeros((5, 4)), signals={"off_road": np.array([0.0, 0.0, 1.0, 0.0, 1.0])})
    assert violation_event(trace, ["lines"]) == ViolationEvent("R2", 2, -1)


@pytest.mark.parametrize(
    ("frame", "seconds", "first"), [(9, 0.0, 9), (9, 0.3, 6), (9, 0.35, 6), (9, 0.299, 7), (5, 0.2, 3), (5, 9.0, 0)]
)
def test_recent_frames_are_those_of_the_last_seconds_with_both_ends(frame, seconds, first):
    """0.9 - 0.3 is a little more than 0.6, which does not matter."""
    trace = driven(np.zeros((10, 4)))
    assert trace.recent(frame, seconds).tolist() == list(range(first, frame + 1))


def test_recent_decisions_are_those_before_a_frame():
    trace = driven(np.zeros((10, 4)), actions=np.zeros((5, 1)), action_frame=np.array([0, 2, 4, 6, 8]))
    assert recent_decisions(trace, 6, 0.4).tolist() == [1, 2]  # that of the frame itself comes too late
    assert recent_decisions(trace, 7, 0.3).tolist() == [2, 3]
    assert recent_decisions(trace, 9, 0.29).tolist() == [4]
    assert recent_decisions(trace, 0, 9.0).tolist() == []
