"""Whose fault collisions were, on scenes with a known verdict, and witnesses that can be replayed."""

from dataclasses import replace

import numpy as np
import pytest

from behavexplor.execution.simulation import Simulation
from behavexplor.judge.events import violation_event
from behavexplor.judge.specs import judge
from behavexplor.triage.blame import blame
from behavexplor.triage.witness import (
    CAREFUL,
    SAMPLES,
    SURVIVED,
    Evasion,
    Witness,
    alarm_time,
    avoids,
    drive,
    path_straight_on,
    recorded_commands,
    replay_witness,
)
from tests.triage.scenes import boxed_in, cut_off, rear_ended, slow_leader, struck_standing


def verdict(made, seed=0):
    return blame(*made, np.random.default_rng(seed))


def test_an_ego_that_could_have_braked_is_at_fault_and_the_witness_is_replayed():
    made = slow_leader()
    found = verdict(made)
    assert (found.kind, found.at_fault, found.witness.name) == ("preventable", True, CAREFUL)
    simulation, scenario, trace = made
    again = replay_witness(simulation, scenario, found.witness)
    assert not {"collision", "lines"} & set(judge(again).violated)
    assert again.duration == pytest.approx(trace.duration + SURVIVED)
    before = round(found.witness.begin * found.witness.frequency) + 1
    assert 0 < before < len(trace.time)
    assert again.position[:before] == pytest.approx(trace.position[:before], abs=1e-6)
    assert np.diff(np.hypot(*again.velocity[:, 0].T)).min() * found.witness.frequency > -7.7


def test_who_is_cut_off_with_no_time_is_not_at_fault():
    found = verdict(cut_off("school-bus", 20.0))
    assert (found.kind, found.at_fault, found.witness) == ("unpreventable", False, None)
    assert found.tried > SAMPLES


def test_with_a_little_more_time_and_room_it_is_at_fault():
    found = verdict(cut_off("sedan", 15.0))
    assert (found.kind, found.at_fault) == ("preventable", True)


def test_a_witness_that_does_nothing_collides():
    simulation, scenario, trace = slow_leader()
    commands = recorded_commands(trace)
    again = replay_witness(simulation, scenario, Witness("none", trace.duration, 20, commands))
    assert again.end == "collision"
    assert again.position == pytest.approx(trace.position, abs=1e-6)


@pytest.mark.parametrize(
    ("made", "kind", "in_junction"),
    [(rear_ended, "npc_rear_end", False), (struck_standing, "struck_stationary", True)],
    ids=["rear-ended", "struck while standing"],
)
def test_who_is_struck_is_not_at_fault(made, kind, in_junction):
    found = verdict(made())
    assert (found.kind, found.in_junction, found.at_fault, found.witness) == (kind, in_junction, False, None)


def test_one_who_is_boxed_in_could_do_nothing_within_the_budget():
    found = verdict(boxed_in())
    assert (found.kind, found.at_fault, found.witness) == ("unpreventable", False, None)
    assert found.tried == 7 + SAMPLES


def test_without_those_behind_the_same_could_have_been_avoided():
    simulation, scenario, _ = boxed_in()
    freed = replace(scenario, npcs=scenario.npcs[:2])
    assert verdict((simulation, freed, simulation.run(freed))).kind == "preventable"


def test_no_collision_no_verdict():
    simulation, scenario, _ = slow_leader()
    empty = replace(scenario, npcs=())
    assert verdict((simulation, empty, simulation.run(empty))) is None


def test_the_alarm_is_where_two_seconds_are_left():
    _, _, trace = slow_leader()
    event = violation_event(trace, ("collision",))
    at = round(alarm_time(trace, event) * 20)
    gap = trace.position[:, 1, 0] - trace.position[:, 0, 0] - trace.size[:, 0].mean()
    closing = trace.velocity[:, 0, 0] - trace.velocity[:, 1, 0]
    assert gap[at] / closing[at] < 2.05
    assert gap[at - 3] / closing[at - 3] > 1.95


def test_an_evasion_brakes_along_the_recorded_path():
    simulation, scenario, trace = slow_leader()
    gentle = Evasion("gentle", trace.duration - 6, -1.0, lasting=2.0)
    aside = replace(gentle, offset=1.5)
    straight, moved = drive(simulation, scenario, trace, [gentle, aside], path_straight_on(trace))
    at = round((gentle.begin + 2) * 20)
    speed = np.hypot(*straight.velocity[:, 0].T)
    assert speed[at] == pytest.approx(speed[round(gentle.begin * 20)] - 2, abs=0.1)
    assert straight.position[:, 0, 1] == pytest.approx(trace.position[0, 0, 1], abs=1e-3)
    frame = round((gentle.begin + 3.5) * 20)
    assert moved.position[frame, 0, 1] - trace.position[0, 0, 1] == pytest.approx(1.5, abs=0.2)


def test_a_witness_touches_no_line_and_does_not_end_early():
    simulation, scenario, trace = slow_leader()
    over_the_line = Evasion("aside", trace.duration - 4, -1.0, offset=8.75)
    aside = drive(simulation, scenario, trace, [over_the_line], path_straight_on(trace))[0]
    assert aside.end == "timeout"
    assert "lines" in judge(aside).violated
    assert not avoids(aside, trace, over_the_line.begin)
    assert not avoids(trace, trace, 0.0)


@pytest.mark.parametrize(("env", "ads"), [("intersection-left", "rule"), ("lane-change", "idm")])
def test_commands_read_from_any_trace_make_the_same_drive(env, ads):
    simulation = Simulation(env, ads)
    scenario = simulation.logical.sample(np.random.default_rng(3))
    trace = simulation.run(scenario)
    again = replay_witness(simulation, scenario, Witness("", 0.0, 20, recorded_commands(trace)))
    frames = min(len(again.time), len(trace.time))
    assert frames >= len(trace.time) - 1
    assert again.position[:frames] == pytest.approx(trace.position[:frames], abs=1e-5)
