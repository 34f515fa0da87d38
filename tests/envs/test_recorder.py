"""The record of an episode, against shapely and against arithmetic by hand on its trace."""

import math
from functools import reduce
from operator import add
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from shapely import LineString, Polygon

from behavexplor.data.conventions import EGO_SIZE, VEHICLE_SIZES
from behavexplor.data.geometry import box_corners
from behavexplor.data.npc_motion import motion_table
from behavexplor.data.scripted import ScriptedScenario
from behavexplor.envs.functional import IntersectionLeftEnv, LaneChangeEnv
from behavexplor.envs.plain_simulation import Recorder
from behavexplor.envs.tasks.scripted_outcome import WEIGHTS

LEFT = IntersectionLeftEnv.logical
TIME = np.arange(41) / 20
CLEAR = 1e-6  # distances below that are not judged [m]


def recorder(scenario=None, logical=LEFT):
    scenario = scenario or ScriptedScenario(logical.name, ())
    sizes = [EGO_SIZE, *(VEHICLE_SIZES[npc.type] for npc in scenario.npcs)]
    return Recorder(logical.roadmap, TIME, motion_table(scenario, logical.roadmap, TIME), sizes)


def ego(x, y, heading=0.0, speed=0.0, steering=0.0):
    return SimpleNamespace(position=np.array([x, y]), heading=heading, speed=speed, action={"steering": steering})


def polygon(x, y, heading, size):
    return Polygon(box_corners(np.array([x, y]), np.array(heading), np.array(size)))


def lines_touched(record):
    """Whether the next decision that nothing else happens in would be charged for a line."""
    return record._line_frame is not None


@given(st.integers(0, 10**6), st.floats(-6, 6), st.floats(-6, 6), st.floats(-4, 4))
def test_lines_are_touched_where_shapely_says_so(which, dx, dy, heading):
    lines = LEFT.roadmap.illegal_lines
    x, y = lines[which % len(lines), 0] + (dx, dy)
    record = recorder()
    record.frame(ego(x, y, heading))
    gap = min(polygon(x, y, heading, EGO_SIZE).distance(LineString(line)) for line in lines)
    if gap == 0 or gap > CLEAR:
        assert lines_touched(record) == (gap == 0)


@given(st.integers(0, 2**32 - 1), st.floats(-6, 6), st.floats(-6, 6), st.floats(-4, 4))
def test_npcs_are_touched_where_shapely_says_so(seed, dx, dy, heading):
    scenario = LEFT.sample(np.random.default_rng(seed))
    record = recorder(scenario)
    table = motion_table(scenario, LEFT.roadmap, TIME)[0]
    x, y = table[seed % len(table), :2] + (dx, dy)
    record.frame(ego(x, y, heading))
    own = polygon(x, y, heading, EGO_SIZE)
    gaps = [
        own.distance(polygon(*row[:3], VEHICLE_SIZES[npc.type])) for row, npc in zip(table, scenario.npcs, strict=True)
    ]
    if not any(0 < gap < CLEAR for gap in gaps):
        assert record.touched_npcs() == [i for i, gap in enumerate(gaps) if gap == 0]


def test_standing_is_counted_without_a_break():
    record, counted = recorder(), []
    for speed in (0.0, 0.29, 0.31, 0.2, -0.2, 0.0, 5.0):
        record.frame(ego(0, 0, speed=speed))
        counted.append(record.standing_frames(0.3))
    assert counted == [1, 2, 0, 1, 2, 3, 0]


def test_the_velocity_is_that_of_the_center():
    record = recorder()
    record.frame(ego(1.75, 60.0, heading=-math.pi / 2, speed=6.0, steering=0.4))
    record.action([0.5, 0.2])
    record.frame(ego(1.75, 59.7, heading=-math.pi / 2, speed=6.0))
    trace = record.trace("timeout")
    slip = math.atan(0.5 * math.tan(0.4))
    assert trace.velocity[0, 0] == pytest.approx([6 * math.sin(slip), -6 * math.cos(slip)])
    assert trace.velocity[1, 0] == pytest.approx([0, -6])
    assert (trace.actions.tolist(), trace.action_frame.tolist()) == ([[0.5, 0.2]], [0])
    assert trace.size.tolist() == [list(EGO_SIZE)]
    assert trace.end == "timeout"


def test_progress_and_effort_of_one_decision():
    """From 4 to 6 m/s in 0.1 s, 0.5 m forward."""
    record = recorder()
    record.frame(ego(1.75, 60.0, -math.pi / 2, 4.0))
    record.action(0)
    record.frame(ego(1.75, 59.8, -math.pi / 2, 5.0))
    record.frame(ego(1.75, 59.5, -math.pi / 2, 6.0))
    terms = record.reward_terms(dict.fromkeys(WEIGHTS, 1.0), None)
    assert terms["progress"] == pytest.approx(0.5)
    assert terms["effort"] == pytest.approx(20.0**2)
    assert terms["step"] == 1
    assert sum(terms.values()) == pytest.approx(401.5)


def test_a_line_counts_in_the_decision_that_touches_it():
    record = recorder()
    lines = []
    for x in (1.75, 1.75, 0.5, 0.5, 1.75, 0.5):  # the double yellow line is x = 0, the ego 2.06 m wide
        record.frame(ego(x, 60.0, -math.pi / 2, 1.0))
        if len(record._ego) > 1:
            lines.append(record.reward_terms(WEIGHTS, None)["lines"])
        record.action(0)
    assert lines == [0, -8, 0, 0, 0]


@pytest.mark.parametrize(
    ("behind", "speed", "expected"), [(True, 3.0, "rear_end"), (True, 11.0, "collision"), (False, 3.0, "collision")]
)
def test_who_was_struck_from_behind(behind, speed, expected):
    """An NPC in the ego's lane touches it; it is a rear end if the NPC comes from behind and is faster."""
    scenario = next(
        scenario
        for seed in range(200)
        for scenario in [LEFT.sample(np.random.default_rng(seed))]
        if 4 < scenario.npcs[0].waypoints[0].speed < 10 and scenario.npcs[0].type == "sedan"
    )
    x, y, heading = motion_table(scenario, LEFT.roadmap, TIME)[0, 0, :3]
    gap = 4.5 if behind else -4.5  # of the centers; both boxes are longer together
    record = recorder(ScriptedScenario(LEFT.name, scenario.npcs[:1]))
    for _ in range(2):
        record.frame(ego(x + gap * math.cos(heading), y + gap * math.sin(heading), heading, speed))
        record._motion[:, 0] = record._motion[0, 0]
        record.action(0)
    record._action_frames[-1] = 0
    assert record.touched_npcs() == [0]
    terms = record.reward_terms(WEIGHTS, "collision")
    assert {name for name in ("collision", "rear_end") if terms[name]} == {expected}


@pytest.mark.parametrize("env_class", [IntersectionLeftEnv, LaneChangeEnv])
def test_every_reward_follows_from_the_trace(env_class):
    """All terms of whole episodes, worked out again from nothing but the trace, with shapely for the lines."""
    env = env_class({"duration": 12.0})
    rng = np.random.default_rng(4)
    for _ in range(6):
        env.reset(seed=int(rng.integers(1000)))
        steering, log = rng.normal(0, 0.02), []
        while True:
            _, reward, terminated, truncated, info = env.step(np.array([0.5, steering]))
            assert reward == reduce(add, info["rewards"].values())  # `sum` compensates since Python 3.12
            log.append(info["rewards"])
            if terminated or truncated:
                break
        trace, route = info["trace"], env.logical.roadmap.ego_route
        lines = LineString(trace.illegal_lines[0]).union(LineString(trace.illegal_lines[1]))
        for line in trace.illegal_lines[2:]:
            lines = lines.union(LineString(line))
        ends = [*trace.action_frame[1:], len(trace.time) - 1]
        speed = np.hypot(*trace.velocity[:, 0].T)
        touched = [
            polygon(*p, h, EGO_SIZE).distance(lines) == 0
            for p, h in zip(trace.position[:, 0], trace.heading[:, 0], strict=True)
        ]
        first = touched.index(True) if True in touched else None
        for terms, begin, end in zip(log, trace.action_frame, ends, strict=True):
            ahead = route.project(*trace.position[end, 0])[0] - route.project(*trace.position[begin, 0])[0]
            assert terms["progress"] == pytest.approx(0.1 * ahead, abs=1e-8)
            mean = (speed[end] - speed[begin]) / (trace.time[end] - trace.time[begin])
            assert terms["effort"] == pytest.approx(-0.002 * mean**2, abs=1e-6)
            assert terms["step"] == -0.02
            assert terms["lines"] == (-8.0 if first is not None and begin < first <= end else 0.0)
        last = {name for name in ("collision", "rear_end", "arrived", "missed") if log[-1][name]}
        expected = {"collision": {"collision", "rear_end"}, "arrived": {"arrived"}}.get(trace.end, {"missed"})
        assert len(last) == 1
        assert last <= expected
        assert not any(terms[name] for terms in log[:-1] for name in ("collision", "rear_end", "arrived", "missed"))
