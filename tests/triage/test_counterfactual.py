"""Causes: a planted weakness is found by replays that are exact up to where they fork."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from behavexplor.ads.rule.weaknesses import WEAKNESSES
from behavexplor.data.scenario import parse_scenario
from behavexplor.execution.simulation import Simulation
from behavexplor.judge.specs import judge
from behavexplor.triage.counterfactual import (
    UNKNOWN,
    Cause,
    Fork,
    find_cause,
    primary_cause,
    run_forks,
    upstream_first,
    without,
)
from behavexplor.triage.signatures import signature
from tests.triage.scenes import slow_leader, way_blocked

SCENARIOS = Path(__file__).parent.parent / "ads" / "scenarios"
QUICK = ("R1-2", "R1-8", "R2-2", "R3-3")


def planted(name, profile="hardened+{}"):
    scenario = parse_scenario((SCENARIOS / f"{name}.json").read_text())
    simulation = Simulation(scenario.functional, f"rule:{profile.format(name)}")
    return simulation, scenario, simulation.run(scenario)


@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in WEAKNESSES]
)
def test_a_planted_weakness_is_the_cause(name):
    assert find_cause(*planted(name)) == Cause(name, (name,), (name,))


@pytest.mark.parametrize("name", [name for name in WEAKNESSES if name != "R1-5"])
def test_the_signature_of_a_planted_weakness(name):
    _, _, trace = planted(name)
    assert signature(trace, judge(trace).violated) == name


def test_a_fork_is_exact_up_to_where_it_begins_and_differs_then():
    simulation, scenario, trace = planted("R1-8")
    parameters = simulation.ads.parameters
    begin = len(trace.actions) - 60
    same, other, whole = run_forks(
        simulation,
        scenario,
        trace,
        [Fork(parameters, begin), Fork(without(parameters, ["branch_turn"]), begin), Fork(parameters)],
    )
    for again in (same, whole):
        assert np.array_equal(again.position, trace.position)
        assert np.array_equal(again.actions, trace.actions)
    frames = 2 * begin + 1
    for field in ("position", "heading", "velocity"):
        assert np.array_equal(getattr(other, field)[:frames], getattr(trace, field)[:frames])
    assert not np.array_equal(other.actions[begin : begin + 10], trace.actions[begin : begin + 10])
    assert other.end == "arrived"


def test_the_planner_that_takes_over_remembers_the_drive():
    simulation, scenario, trace = planted("R1-8")
    begin = len(trace.actions) - 60
    fork = Fork(replace(simulation.ads.parameters, jerk=9.0), begin)
    remembered = run_forks(simulation, scenario, trace, [fork])[0].actions[begin]
    limit = simulation.ads.parameters.jerk * 0.1 / 6.0  # of the command, from one decision to the next
    assert np.abs(remembered - trace.actions[begin - 1])[0] <= limit + 1e-9


def test_what_the_planner_without_weaknesses_violates_too_is_the_environment():
    made = way_blocked("rule:hardened+R3-1")
    assert judge(made[2]).violated == ("destination",)
    assert find_cause(*made) == Cause("environment", (), ())


def test_other_systems_and_passed_runs_have_no_cause():
    assert find_cause(*slow_leader()) is None
    simulation, scenario, _ = planted("R1-8", "hardened")
    assert find_cause(simulation, scenario, simulation.run(scenario)) is None


@pytest.mark.parametrize(
    ("spec", "necessary", "sufficient", "primary"),
    [
        ("R1", ("R1-8", "R1-4"), (), "R1-8"),
        ("R1", ("R1-8", "R1-4"), ("R1-4",), "R1-4"),
        ("R2", ("R3-2",), ("R2-2", "R2-1"), "R2-2"),
        ("R2", ("R3-2", "R2-2"), (), "R2-2"),
        ("R1", ("R3-1", "R2-2"), (), "R3-1"),
        ("R1", (), (), UNKNOWN),
    ],
)
def test_who_of_several_is_to_blame(spec, necessary, sufficient, primary):
    assert primary_cause(spec, necessary, sufficient) == primary


def test_upstream_is_prediction_before_control():
    assert upstream_first(["R2-1", "R1-4", "R2-2", "R3-4", "R1-8"]) == ("R1-8", "R3-4", "R2-2", "R1-4", "R2-1")
