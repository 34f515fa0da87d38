from dataclasses import dataclass

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from behavexplor.data.geometry import box_corners
from behavexplor.envs.functional import IntersectionStraightEnv
from behavexplor.errors import InputError
from behavexplor.judge.specs import (
    NOTHING_NEAR,
    SPECS,
    Collision,
    Destination,
    Lines,
    Verdict,
    _least,
    final_distance,
    judge,
    poses_until_arrival,
)
from tests.fakes import make_trace, simulate
from tests.judge.traces import driven, turned, views

LOGICAL = IntersectionStraightEnv.logical

EGO = (4.70, 2.06)
STILL = [(0.0, 0.0, 0.0)]


def polygons(trace, vehicle):
    corners = box_corners(trace.position[:, vehicle], trace.heading[:, vehicle], trace.size[vehicle])
    return [shapely.Polygon(box) for box in corners]


def shapely_collision(trace):
    ego = polygons(trace, 0)
    return min(
        box.distance(other)
        for vehicle in range(1, len(trace.size))
        for box, other in zip(ego, polygons(trace, vehicle), strict=True)
    )


def shapely_lines(trace):
    lines = [shapely.LineString(line) for line in trace.illegal_lines]
    return min(box.distance(line) for box in polygons(trace, 0) for line in lines)


def random_trace(seed, frames, npcs, lines, reach):
    """Vehicles and lines anywhere within `reach`, turned anyhow, some standing still for a while."""
    rng = np.random.default_rng(seed)
    poses = rng.uniform((-reach, -reach, -4), (reach, reach, 4), (npcs + 1, frames, 3))
    poses[:, frames // 2 : frames // 2 + 3] = poses[:, frames // 2, None]
    return make_trace(
        poses[0],
        poses[1:],
        sizes=rng.uniform((0.5, 0.5), (9, 3), (npcs + 1, 2)),
        lines=rng.uniform(-reach, reach, (lines, 2, 2)),
    )


@settings(max_examples=150, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    frames=st.integers(1, 40),
    npcs=st.integers(1, 4),
    lines=st.integers(1, 12),
    reach=st.sampled_from([6.0, 30.0, 300.0]),
)
def test_degrees_are_exact(seed, frames, npcs, lines, reach):
    trace = random_trace(seed, frames, npcs, lines, reach)
    assert Collision().degree(trace) == pytest.approx(shapely_collision(trace), abs=1e-9)
    assert Lines().degree(trace) == pytest.approx(shapely_lines(trace), abs=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_degrees_are_exact_on_whole_episodes(seed):
    trace = simulate(LOGICAL.sample(np.random.default_rng(seed)))
    assert Collision().degree(trace) == pytest.approx(shapely_collision(trace), abs=1e-9)
    assert Lines().degree(trace) == pytest.approx(shapely_lines(trace), abs=1e-9)


@pytest.mark.parametrize(
    ("npc", "size", "degree"),
    [
        pytest.param((10.0, 0.0, 0.0), (4.0, 2.0), 10 - 2.35 - 2, id="ahead"),
        pytest.param((4.35, 0.0, 0.0), (4.0, 2.0), 0.0, id="bumpers touch"),
        pytest.param((4.351, 0.0, 0.0), (4.0, 2.0), 0.001, id="almost"),
        pytest.param((0.1, 0.1, 0.3), (1.0, 0.5), 0.0, id="inside the ego"),
        pytest.param((0.1, 0.1, 0.3), (30.0, 20.0), 0.0, id="round the ego"),
        pytest.param((0.0, 0.0, np.pi / 2), (30.0, 1.0), 0.0, id="across, no corner in the other"),
        pytest.param((5.35, 5.03, 0.0), (4.0, 4.0), np.hypot(1, 2), id="corner to corner"),
        pytest.param((0.0, 3.03 + np.sqrt(2), np.pi / 4), (2.0, 2.0), 2.0, id="corner to side"),
    ],
)
def test_collision_by_hand(npc, size, degree):
    trace = make_trace(STILL, [[npc]], sizes=[EGO, size])
    assert Collision().degree(trace) == pytest.approx(degree, abs=1e-9)
    assert Collision().violated(trace) == (degree == 0)


@pytest.mark.parametrize(
    ("line", "degree"),
    [
        pytest.param([(-50, 3.03), (50, 3.03)], 2.0, id="beside"),
        pytest.param([(-50, 1.03), (50, 1.03)], 0.0, id="along the side"),
        pytest.param([(-0.1, 0), (0.1, 0)], 0.0, id="inside"),
        pytest.param([(0, -9), (0, 9)], 0.0, id="right across"),
        pytest.param([(5.35, 0), (9, 0)], 3.0, id="end points at the bumper"),
        pytest.param([(5.35, 5.03), (9, 9)], 5.0, id="nearest at a corner"),
        pytest.param([(3.35, 0), (3.35, 0)], 1.0, id="a point"),
    ],
)
def test_lines_by_hand(line, degree):
    trace = make_trace(STILL, lines=[line, [(200, 200), (300, 300)]])
    assert Lines().degree(trace) == pytest.approx(degree, abs=1e-9)
    assert Lines().violated(trace) == (degree == 0)


def test_the_least_of_bounded_values_is_exact():
    """Wherever it stands in the order of the bounds, and none is computed twice."""
    rng = np.random.default_rng(0)
    looked_at = []

    def exact(indices):
        looked_at.extend(indices.tolist())
        return values[indices]

    for _ in range(1000):
        lower = rng.uniform(-1, 10, 200)
        values = np.maximum(lower, 0) + rng.uniform(0.5, 8, 200)
        looked_at.clear()
        assert _least(lower, float(values.max()), exact) == values.min()
        assert len(set(looked_at)) == len(looked_at)


def test_contact_in_one_frame_of_many_is_a_violation():
    ego = np.zeros((500, 3))
    npc = np.tile([20.0, 0.0, 0.0], (500, 1))
    npc[333, 0] = 4.0
    assert not Collision().violated(make_trace(ego, [np.delete(npc, 333, axis=0)[[0] * 500]]))
    assert Collision().violated(make_trace(ego, [npc]))


def test_turning_on_the_spot_reaches_a_line():
    """Position and circles stay the same; only the heading makes the difference."""
    ego = np.zeros((40, 3))
    ego[17, 2] = np.pi / 2
    trace = make_trace(ego, lines=[[(-9, 2.5), (9, 2.5)]])
    assert Lines().degree(trace) == pytest.approx(2.5 - 4.70 / 2, abs=1e-9)


def test_nothing_to_hit_has_a_finite_degree():
    trace = make_trace(STILL)
    assert Collision().degree(trace) == Lines().degree(trace) == NOTHING_NEAR == 1000
    assert not Collision().violated(trace)
    assert not Lines().violated(trace)


@pytest.mark.parametrize(
    ("gap", "degree", "violated"), [(0.0, 10, False), (1.0, 9, False), (1.5, 8.5, True), (10, 0, True), (40, 0, True)]
)
def test_destination_by_hand(gap, degree, violated):
    trace = make_trace([(90.0, 0.0, 0.0), (0.0, 0.0, 0.0)], destination=(0.0, gap))
    assert Destination().degree(trace) == pytest.approx(degree)
    assert Destination().violated(trace) is violated


def test_destination_threshold_is_an_option():
    trace = make_trace(STILL, destination=(5.0, 0.0))
    assert Destination().violated(trace)
    assert not Destination(threshold=10.0).violated(trace)
    assert Destination(reach=20.0).degree(trace) == 15


def test_specs_are_the_papers_in_order():
    assert [spec.name for spec in SPECS] == ["collision", "lines", "destination"]


def test_verdict_keeps_all_violations_and_adds_up_degrees():
    npc, line = [(3.0, 0.0, 0.0)], [(0, 3.03), (9, 3.03)]
    verdict = judge(make_trace(STILL, [npc], lines=[line], destination=(4.0, 0.0)), SPECS)
    assert verdict.violated == ("collision", "destination")
    assert verdict.failed
    assert list(verdict.degrees) == ["collision", "lines", "destination"]
    assert verdict.degree == pytest.approx(0 + 2 + 6)


def test_a_passed_verdict_has_no_violation():
    verdict = judge(make_trace(STILL, [[(20.0, 0.0, 0.0)]], lines=[[(0, 9), (9, 9)]]))
    assert verdict.violated == ()
    assert not verdict.failed


def test_verdict_cannot_be_changed():
    degrees = {"collision": 1.0}
    verdict = Verdict(degrees, ())
    degrees["collision"] = 2.0
    assert verdict.degree == 1.0
    with pytest.raises(TypeError):
        verdict.degrees["collision"] = 3.0


@dataclass(frozen=True)
class Broken:
    name: str
    value: float = 0.0

    def degree(self, _):
        return self.value

    def violated(self, _):
        return False


@pytest.mark.parametrize(
    ("specs", "message"),
    [
        ([Broken("mine"), Broken("mine")], "Two specs are named 'mine'"),
        ([Broken("mine", np.inf)], "degree of the spec 'mine' must be a finite number, got inf"),
        ([Broken("mine", np.nan)], "degree of the spec 'mine' must be a finite number, got nan"),
    ],
)
def test_a_bad_spec_is_refused(specs, message):
    with pytest.raises(InputError, match=message):
        judge(make_trace(STILL), specs)


def told(place=(60.0, 0.0), line=5.0, **signals):
    """A trace of an environment that tells what happened: a vehicle and a line beside an ego at the origin."""
    lines = np.array([[[-9.0, line], [9.0, line]]])
    values = {name: np.array([0.0, float(value), 0.0]) for name, value in signals.items()}
    ego, npc = np.zeros((3, 4)), np.tile([*place, 0.0, 0.0], (3, 1))
    return driven(ego, npc, signals=values, illegal_lines=lines, destination=[5.0, 0.0])


@pytest.mark.parametrize(
    ("spec", "trace", "degree", "violated"),
    [
        (Collision(), told(crashed=True), 0.0, True),
        (Collision(), told(crashed=False), 56.0, False),
        (Collision(), told((3.0, 0.0), crashed=False), 1e-9, False),  # boxes that overlap without a crash
        (Collision(), told((3.0, 0.0), way=False), 0.0, True),
        (Collision(), told((3.0, 0.0)), 0.0, True),
        (Lines(), told(off_road=True), 0.0, True),
        (Lines(), told(off_road=False), 4.0, False),
        (Lines(), told(line=1.0, off_road=False), 0.0, False),
        (Lines(), told(line=1.0, way=False), 0.0, True),
        (Destination(), told(arrived=True), 10.0, False),
        (Destination(), told(arrived=False), 0.0, True),
        (Destination(), told(way=True), 10.0, False),  # there is none
        (Destination(), told(), 5.0, True),
        (Destination(reach=7.0), told(arrived=True), 7.0, False),
    ],
)
def test_what_an_environment_tells_goes_before_what_the_boxes_do(spec, trace, degree, violated):
    assert spec.degree(trace) == pytest.approx(degree, rel=1e-12, abs=0)
    assert spec.violated(trace) == violated


@pytest.mark.parametrize(
    ("first", "last", "distance"),
    [
        ((-3.0, 0.5), (-0.5, 0.5), 0.5),  # 0.5 m further on
        ((-3.0, 0.5), (0.5, 0.5), 0.5),
        ((-3.0, 0.8), (-2.0, 0.8), np.hypot(1.0, 0.8)),  # it reaches 1 m beyond
        ((0.3, 0.4), (2.0, 0.4), 0.5),  # it came from behind
        ((3.0, -0.6), (0.2, -0.6), 0.6),
        ((0.3, 0.4), (0.3, 0.4), 0.5),
    ],
)
def test_an_arrival_counts_by_its_course_and_a_meter_beyond(first, last, distance):
    """The ego goes from the first place to the last, and on; the destination is the origin."""
    arrived = driven([(9.0, 9.0, 0, 0), (*first, 0, 0), (*last, 0, 0)], end="arrived", destination=[0.0, 0.0])
    for seen, _ in views(arrived):
        assert final_distance(seen) == pytest.approx(distance)
        assert Destination().degree(seen) == pytest.approx(10.0 - distance)
        assert Destination().violated(seen) == (distance > 1.0)
    other = driven([(9.0, 9.0, 0, 0), (*last, 0, 0)], destination=[0.0, 0.0])
    assert final_distance(other) == pytest.approx(np.hypot(*last))


@pytest.mark.parametrize(
    ("first", "last", "share"),
    [
        ((-3.0, 0.0), (0.0, 0.0), 2 / 3),
        ((-3.0, 0.6), (-0.8, 0.6), 1.0),
        ((-3.0, 0.6), (0.0, 0.6), 2.2 / 3),
        ((-0.5, 0.0), (0.5, 0.0), 0.0),  # it was there before
        ((0.0, -2.0), (0.0, -1.5), 1.0),  # it never was
        ((-3.0, 0.0), (3.0, 0.0), 1.0),  # it was there in between only
        ((0.5, 0.5), (0.5, 0.5), 1.0),
    ],
)
def test_all_vehicles_stop_at_the_moment_of_arrival(first, last, share):
    """Places, and headings that turn the short way across pi, are those of that share of the last step."""
    ego = [(9.0, 9.0, 3.0, 0.0), (*first, 3.0, 0.0), (*last, -3.0, 0.0)]
    npc = [(20.0, 0.0, 0.0, 0.0), (20.0, 4.0, -3.1, 0.0), (30.0, 4.0, 3.0, 0.0)]
    arrived = driven(ego, npc, end="arrived", destination=[0.0, 0.0])
    turn = 2 * np.pi - 6
    for angle in (0.0, 0.7):
        seen = turned(arrived, angle)
        position, heading = poses_until_arrival(seen)
        between = (1 - share) * seen.position[1] + share * seen.position[2]
        assert position == pytest.approx(np.stack([*seen.position[:2], between]), abs=1e-8)
        expected = np.array([3.0 + share * turn, -3.1 - share * (2 * np.pi - 6.1)]) + angle
        assert np.exp(1j * heading[-1]) == pytest.approx(np.exp(1j * expected), abs=1e-8)
        assert (heading[:-1] == seen.heading[:-1]).all()
        assert not position.flags.writeable
        assert not heading.flags.writeable


@pytest.mark.parametrize(("gap", "degree"), [(2e-9, 2e-9), (1e-9, 0.0), (0.5e-9, 0.0)])
def test_a_gap_at_the_resolution_of_a_trace_is_none(gap, degree):
    assert _least(np.array([gap]), gap, lambda _: np.array([gap])) == degree


def test_verdicts_of_users_specs_are_in_their_order():
    found = judge(make_trace(STILL), [Broken("b", 3.0), Broken("a", 4.5), *SPECS])
    assert list(found.degrees) == ["b", "a", "collision", "lines", "destination"]
    assert found.degree == 3.0 + 4.5 + 1000.0 + 1000.0 + 10.0


@pytest.mark.parametrize("kind", [Collision, Lines, Destination])
def test_the_papers_specs_keep_their_names(kind):
    with pytest.raises(TypeError, match="unexpected keyword argument 'name'"):
        kind(name="mine")
