"""What a search takes for degree and failure where it is not the verdict."""

from dataclasses import replace

import numpy as np
import pytest

from behavexplor.data.roadmap import CURB, DOUBLE_YELLOW
from behavexplor.errors import InputError
from behavexplor.fuzz.behavexplor import AssessmentOptions, assess
from behavexplor.judge.specs import Verdict, judge
from tests.fakes import LOGICAL, make_trace, simulate

KINDS = (DOUBLE_YELLOW, CURB)
RELEASED = AssessmentOptions(
    degree="clipped", box_shrink=0.2, destination_from="box", destination_threshold=10.0, retreat=0.06
)

TRACE = simulate(LOGICAL.sample(np.random.default_rng(4)))
PLAIN = judge(TRACE)
PASSED = Verdict({"collision": 3.0, "lines": 2.0, "destination": 10.0}, ())


def along(xs, y=0.0, npcs=(), lines=(), destination=(100.0, 0.0)):
    xs = np.asarray(xs, dtype=float)
    ego = np.stack([xs, np.full_like(xs, y), np.zeros_like(xs)], axis=1)
    npcs = [np.tile(npc, (len(xs), 1)) for npc in npcs]
    return make_trace(ego, npcs, lines=lines, destination=destination)


def with_lines(trace, yellow, curb):
    """The trace with one illegal line of each kind, at these lateral places."""
    return replace(trace, illegal_lines=np.array([[[-50.0, y], [150.0, y]] for y in (yellow, curb)]))


def test_by_default_it_is_the_verdict():
    run = assess(TRACE, PLAIN, KINDS, AssessmentOptions())
    assert run.trace is TRACE
    assert (run.degree, run.failed) == (PLAIN.degree, PLAIN.failed)


def test_the_clipped_degree_is_a_mean_of_four_terms():
    """Half the boxes' widths are 1.03 m and shrink by 0.05 m each."""
    run = assess(
        with_lines(  # 0.3 m and 0.4 m away
            along([0, 50, 96], npcs=[(50.0, 2.56, 0.0)]),  # boxes 0.5 m apart
            yellow=-1.33,
            curb=1.43,
        ),
        PASSED,
        KINDS,
        AssessmentOptions(degree="clipped", box_shrink=0.1),
    )
    assert run.degree == pytest.approx(np.mean([0.6, 0.35, 0.45, 1 - 0.4]))


def test_terms_are_clipped_at_1_m_and_10_m():
    run = assess(with_lines(along([0, 40]), -9.0, 9.0), PASSED, KINDS, AssessmentOptions(degree="clipped"))
    assert run.degree == pytest.approx(np.mean([1, 1, 1, 0]))


def test_boxes_that_touch_count_0_and_shrunk_ones_do_not():
    trace = with_lines(along([0, 90], npcs=[(60.0, 2.06, 0.0), (90.0, 2.06, 0.0)]), -9.0, 9.0)
    plain, shrunk = (
        assess(
            with_lines(trace, -9.0, 9.0), PASSED, KINDS, AssessmentOptions(degree="clipped", box_shrink=shrink)
        ).degree
        for shrink in (0.0, 0.1)
    )
    assert shrunk - plain == pytest.approx(0.1 / 4)


@pytest.mark.parametrize(("end", "term"), [(92.0, 1 - (8 - 2.25) / 10), (97.8, 1 - 0.0), (98.5, 1.0), (80.0, 0.0)])
def test_the_distance_from_the_box(end, term):
    """The box of the ego is 4.70 m long, 0.1 m of which is taken off at each end."""
    options = AssessmentOptions(degree="clipped", box_shrink=0.2, destination_from="box")
    run = assess(with_lines(along([0, 50, end]), -9.0, 9.0), PASSED, KINDS, options)
    assert run.degree == pytest.approx(np.mean([1, 1, 1, term]))


@pytest.mark.parametrize(("end", "failed"), [(87.8, False), (87.7, True)])
def test_the_destination_threshold_from_the_box(end, failed):
    options = AssessmentOptions(box_shrink=0.2, destination_from="box", destination_threshold=10.0)
    missed = Verdict(PASSED.degrees, ("destination",))
    assert assess(along([0, 50, end]), missed, KINDS, options).failed is failed


def test_the_distance_from_a_turning_box_may_grow_though_its_center_comes_nearer():
    trace = along([0, 10, 10.01, 50])
    turning = replace(trace, heading=np.array([[0.0], [0.0], [1.0], [0.0]]))
    from_center, from_box = (
        assess(turning, PASSED, KINDS, AssessmentOptions(retreat=0.06, destination_from=place)).failed
        for place in ("center", "box")
    )
    assert (from_center, from_box) == (False, True)


def test_a_run_that_is_cut_off_has_not_arrived():
    trace = replace(along([0, 10, 9, 99.5]), end="arrived")
    assert assess(trace, PASSED, KINDS, AssessmentOptions(retreat=0.06)).trace.end == "timeout"


@pytest.mark.parametrize(("end", "failed"), [(92.0, False), (89.0, True), (99.5, False)])
def test_the_destination_threshold(end, failed):
    trace = along([0, 50, end])
    missed = Verdict(PASSED.degrees, ("destination",) if end < 99 else ())
    assert assess(trace, missed, KINDS, AssessmentOptions()).failed is (end < 99)
    assert assess(trace, missed, KINDS, AssessmentOptions(destination_threshold=10.0)).failed is failed


def test_other_violations_fail_whatever_the_threshold():
    collided = Verdict(PASSED.degrees, ("collision", "destination"))
    assert assess(along([0, 95]), collided, KINDS, AssessmentOptions(destination_threshold=10.0)).failed


def test_a_run_that_retreats_fails_and_ends_there():
    xs = [0, 10, 20, 20.05, 20.0, 19.9, 19.0, 50, 100]
    trace = along(xs)
    run = assess(trace, PASSED, KINDS, AssessmentOptions(retreat=0.06))
    assert run.failed
    assert run.trace.position[:, 0, 0] == pytest.approx(xs[:6])
    assert len(run.trace.velocity) == len(run.trace.heading) == len(run.trace.time) == 6


@pytest.mark.parametrize("limit", [0.2, None])
def test_a_run_that_retreats_less_goes_on(limit):
    trace = along([0, 10, 20, 19.9, 50, 100])
    run = assess(trace, PASSED, KINDS, AssessmentOptions(retreat=limit))
    assert run.trace is trace
    assert not run.failed


def test_a_run_that_is_cut_keeps_the_commands_until_then():
    trace = along([0, 10, 9, 50])
    trace = replace(
        trace, actions=np.arange(4.0)[:, None], action_frame=np.arange(4), decisions={"code": np.arange(4.0)}
    )
    seen = assess(trace, PASSED, KINDS, AssessmentOptions(retreat=0.06)).trace
    assert seen.actions[:, 0].tolist() == seen.decisions["code"].tolist() == [0.0, 1.0, 2.0]


def test_the_degree_of_a_run_that_retreats_is_that_of_its_beginning():
    trace = with_lines(along([0, 10, 9, 100], npcs=[(100.0, 2.56, 0.0)]), -9.0, 9.0)
    whole, cut = (
        assess(with_lines(trace, -9.0, 9.0), PASSED, KINDS, o).degree
        for o in (replace(RELEASED, retreat=None), RELEASED)
    )
    assert whole == pytest.approx(np.mean([0.7, 1, 1, 1]))
    assert cut == pytest.approx(np.mean([1, 1, 1, 0]))


def test_the_lines_of_a_place_have_kinds():
    """The clipped terms look for both kinds on every map."""
    assert {DOUBLE_YELLOW, CURB} == set(LOGICAL.line_kinds)
    assert len(LOGICAL.line_kinds) == len(LOGICAL.roadmap.illegal_lines)


@pytest.mark.parametrize(
    ("option", "value"), [("box_shrink", -0.1), ("box_shrink", 2.0), ("destination_threshold", -1.0), ("retreat", -1.0)]
)
def test_options_out_of_range(option, value):
    with pytest.raises(InputError, match=option):
        AssessmentOptions(**{option: value})
