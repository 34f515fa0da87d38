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
    default_specs,
    judge,
)
from tests.fakes import make_trace, simulate

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


def test_default_specs_are_the_papers_in_order():
    assert [spec.name for spec in SPECS] == ["collision", "lines", "destination"]
    assert default_specs() == SPECS


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
