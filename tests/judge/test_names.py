"""Names in highway-env's environments: true by an oracle that reads highway-env's objects, and by hand-made signals."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from behavexplor.data.trace import ELSEWHERE, OBSTACLE, ON_ITS_WAY, WAYS, Trace
from behavexplor.execution.simulation import Simulation
from behavexplor.judge.classes import violation_class
from behavexplor.judge.fault import contact_fault
from behavexplor.judge.specs import judge
from tests.judge.names_oracle import seen_in, untrue_words

POLICIES = Path(__file__).parents[2] / "docs" / "data" / "policies"
ENVIRONMENTS = ("highway-fast", "merge", "roundabout", "intersection")
DRIVERS = ("careful", *(f"constant:{name}" for name in ("FASTER", "IDLE", "LANE_LEFT", "LANE_RIGHT")), "policy")
OF_EACH = 4  # failures
MOST = 192  # scenarios in which they are looked for


def failures(env, driver):
    simulation = Simulation(f"{env}-v0", str(POLICIES / f"{env}.zip") if driver == "policy" else driver)
    rng = np.random.default_rng(11)
    scenarios = [simulation.logical.sample(rng) for _ in range(MOST)]
    traces = (trace for _, trace in sorted(simulation.run_all(scenarios), key=lambda pair: pair[0]))
    failed = [(one, trace) for one, trace in zip(scenarios, traces, strict=True) if judge(trace).failed]
    return failed[:OF_EACH]


@pytest.mark.slow
@pytest.mark.parametrize("env", ENVIRONMENTS)
def test_nearly_every_word_is_true_by_highway_env_s_objects(env):
    untrue, total = [], 0
    for scenario, trace in (pair for driver in DRIVERS for pair in failures(env, driver)):
        kind = violation_class(trace, judge(trace).violated)
        seen = seen_in(scenario, trace.actions[:, 0].astype(int))
        words, count = untrue_words(seen, kind.id, contact_fault(trace))
        untrue, total = [*untrue, *words], total + count
    assert total >= 3 * OF_EACH * 3
    assert len(untrue) <= 0.02 * total, untrue


FRAMES = 51  # at 10 Hz


def crash(*, changing=0, changed_at=(), way="going-straight", where=ELSEWHERE, lanes=0, npc=(), wreck=False, speed=9.0):
    """A trace at the end of which the ego, which drives along x, crashes into a vehicle.

    Args:
        changing: what the signal of lane changes is in the seconds `changed_at`.
        changed_at: from when to when, before the crash [s].
        way: what the ego does on its road.
        where: where the partner is, in all frames.
        lanes: how many lanes to the right.
        npc: x [m], y [m], heading [rad] and speed [m/s] of the partner a second before the crash, as the ego is at 0.
        wreck: whether it had crashed before.
        speed: of the ego [m/s].
    """
    time = np.arange(FRAMES) / 10
    left = time[-1] - time
    x, y, heading, npc_speed = npc or (20.0, 0.0, 0.0, 0.0)
    headings = np.zeros((FRAMES, 2))
    headings[:, 1] = heading
    velocity = np.stack([np.cos(headings), np.sin(headings)], -1) * np.array([speed, npc_speed])[:, None]
    position = np.array([[0.0, 0.0], [x, y]]) - (left - 1)[:, None, None] * velocity
    headings[-1, 1] += 2.0  # highway-env turns what has crashed
    recent = (left <= changed_at[0]) & (left >= changed_at[1]) if changed_at else np.zeros(FRAMES, bool)
    return Trace(
        time=time,
        position=position,
        heading=headings,
        velocity=velocity,
        size=np.array([[5.0, 2.0], [5.0, 2.0]]),
        actions=np.zeros((0, 1)),
        action_frame=np.zeros(0, dtype=int),
        route=np.array([[-200.0, 0.0], [200.0, 0.0]]),
        destination=np.array([100.0, 0.0]),
        illegal_lines=np.empty((0, 2, 2)),
        end="collision",
        signals={
            "crashed": (left == 0).astype(float),
            "changing_lanes": np.where(recent, changing, 0),
            "way": np.full(FRAMES, WAYS.index(way)),
            "partner": np.full(FRAMES, where),
            "partner_lanes": np.full(FRAMES, lanes),
            **({"wrecks": np.ones((FRAMES, 2)) * [0, 1]} if wreck else {}),
        },
        partner=1,
    )


def named(trace):
    return violation_class(trace, ("collision",)).id.removeprefix("R1/").removesuffix("/car-sized")


@pytest.mark.parametrize(
    ("changing", "changed_at", "way", "words"),
    [
        (-1, (0.5, 0.2), "going-straight", "changing-left"),
        (1, (2.5, 1.5), "going-straight", "having-changed-right"),
        (1, (2.5, 1.5), "entering-the-ring", "entering-the-ring"),
        (1, (4.5, 3.5), "driving-in-the-ring", "driving-in-the-ring"),
        (1, (0.5, 0.0), "leaving-the-ring", "changing-right"),
        (0, (), "turning-left", "turning-left"),
    ],
)
def test_the_maneuver_is_what_the_lanes_say(changing, changed_at, way, words):
    assert named(crash(changing=changing, changed_at=changed_at, way=way)).startswith(f"{words}/")


@pytest.mark.parametrize(
    ("where", "lanes", "npc", "words"),
    [
        (ON_ITS_WAY, 0, (15.0, 0.0, 0.0, 3.0), "leading"),
        (ON_ITS_WAY, 0, (-9.0, 0.0, 0.0, 14.0), "behind"),
        (ON_ITS_WAY, 0, (15.0, -8.0, -1.0, 3.0), "leading"),
        (ON_ITS_WAY, 1, (15.0, 4.0, 0.0, 3.0), "ahead-on-the-right"),
        (ON_ITS_WAY, -1, (3.0, -4.0, 0.0, 9.0), "on-the-left"),
        (ON_ITS_WAY, -1, (-9.0, -4.0, 0.0, 12.0), "behind-on-the-left"),
        (ELSEWHERE, 0, (30.0, -3.0, 3.0, 9.0), "oncoming"),
        (ELSEWHERE, 0, (10.0, 9.0, -1.5, 9.0), "crossing-from-right"),
        (ELSEWHERE, 0, (10.0, -9.0, 1.5, 9.0), "crossing-from-left"),
        (ELSEWHERE, 0, (5.0, 6.0, -0.3, 9.0), "merging-from-right"),
        (ELSEWHERE, 0, (15.0, 0.5, 0.3, 3.0), "leading"),
    ],
)
def test_the_other_vehicle_is_where_it_was_a_second_before(where, lanes, npc, words):
    assert named(crash(where=where, lanes=lanes, npc=npc)) == f"going-straight/{words}"


def test_an_obstacle_and_a_wreck_are_called_so():
    kind = violation_class(crash(where=OBSTACLE), ("collision",))
    assert kind.words.startswith("Collision with an obstacle; the ego was going straight")
    assert "other vehicle" not in kind.words
    wreck = crash(where=ON_ITS_WAY, wreck=True)
    words = violation_class(wreck, ("collision",)).words
    assert words.startswith("Collision with a car-sized vehicle that had crashed before; the ego was going straight")
    assert contact_fault(wreck) == "npc_wreck"
    missed = replace(wreck, end="timeout", partner=-1)
    assert "behind a crashed vehicle" in violation_class(missed, ("destination",)).words


@pytest.mark.parametrize(
    ("changed_at", "way", "speed", "fault"),
    [
        ((2.0, 1.5), "going-straight", 5.0, "ego_cut_in"),
        ((), "going-straight", 5.0, "npc_rear_end"),
        ((2.0, 1.5), "going-straight", 0.0, "npc_rear_end"),
        ((), "entering-the-ring", 5.0, "ego_cut_in"),
        ((), "driving-in-the-ring", 5.0, "npc_rear_end"),
    ],
)
def test_only_an_ego_that_changed_lanes_or_entered_a_ring_and_drives_has_cut_in(changed_at, way, speed, fault):
    behind = (-5.0 - (14.0 - speed), 0.0, 0.0, 14.0)
    assert contact_fault(crash(changing=1, changed_at=changed_at, way=way, npc=behind, speed=speed)) == fault


def test_an_ego_off_the_road_has_left_it():
    trace = crash()
    off = replace(trace, partner=-1, signals={**trace.signals, "off_road": np.arange(FRAMES) == FRAMES - 1})
    assert violation_class(off, ("lines",)).words == "Left the road on its left at speed while going straight"
