"""The planner's weaknesses: each causes its violation, and without it there is none."""

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from behavexplor.ads.loading import load_ads
from behavexplor.ads.rule import Parameters
from behavexplor.ads.rule.profiles import DEFAULT, PROFILES, rule_planner
from behavexplor.ads.rule.weaknesses import R1_1, R2_4, R3_4, WEAKNESSES
from behavexplor.data.scenario import parse_scenario
from behavexplor.data.trace import weakness_names
from behavexplor.envs.functional import IntersectionStraightEnv
from behavexplor.errors import InputError
from behavexplor.execution.simulation import Simulation
from behavexplor.judge.specs import judge

ROADMAP = IntersectionStraightEnv.logical.roadmap
FROZEN = "e29898fd4b605dab"
SCENARIOS = Path(__file__).parent.parent / "scenarios"


@pytest.mark.parametrize("name", WEAKNESSES)
def test_the_violation_occurs_with_the_weakness_and_not_without(name):
    scenario = parse_scenario((SCENARIOS / f"{name}.json").read_text())
    weak = Simulation(scenario.functional, f"rule:hardened+{name}").run(scenario)
    careful = Simulation(scenario.functional, "rule:hardened").run(scenario)
    requirement = {"R1": "collision", "R2": "lines", "R3": "destination"}[name[:2]]
    assert requirement in judge(weak).violated
    assert not judge(careful).violated
    assert name in weakness_names(np.bitwise_or.reduce(weak.decisions["triggered"].astype(int)))
    assert not careful.decisions["reached"].any()


def test_the_default_profile_has_every_weakness_so_far():
    assert rule_planner(ROADMAP).parameters == rule_planner(ROADMAP, DEFAULT).parameters
    assert list(PROFILES[DEFAULT].severities) == list(WEAKNESSES)


def test_the_frozen_profile_has_not_changed():
    profile = PROFILES["apollo-like"]
    text = json.dumps([dict(profile.severities), dict(profile.gates)], sort_keys=True)
    assert hashlib.sha256(text.encode()).hexdigest()[:16] == FROZEN


def test_the_profile_held_back_differs_in_every_severity_by_at_most_30_percent():
    like, held_back = PROFILES["apollo-like"].severities, PROFILES["apollo-held-back"].severities
    assert PROFILES["apollo-like"].gates == PROFILES["apollo-held-back"].gates
    assert list(like) == list(held_back) == list(WEAKNESSES)
    shares = {name: held_back[name] / like[name] for name in like}
    assert all(0.7 - 1e-9 <= share <= 1.3 + 1e-9 and share != 1 for share in shares.values())


def test_narrower_gates_are_parameters_of_their_own():
    gates = PROFILES["apollo-like"].gates
    careful = Parameters()
    assert all(getattr(careful, name) != value for name, value in gates.items())
    assert not set(gates) & {weakness.parameter for weakness in WEAKNESSES.values()}
    assert rule_planner(ROADMAP, "apollo-like").parameters.branch_speed == gates["branch_speed"]
    assert rule_planner(ROADMAP, "apollo-easy").parameters.branch_speed == careful.branch_speed


def test_every_weakness_is_a_parameter_of_its_own_that_is_off_in_the_careful_planner():
    fields = [weakness.parameter for weakness in WEAKNESSES.values()]
    assert len(set(fields)) == 16
    assert all(getattr(Parameters(), name) == 0 for name in fields)


def test_bits_of_the_log_are_read_as_names():
    assert weakness_names(0) == ()
    assert weakness_names(R1_1 | R2_4 | R3_4) == ("R1-1", "R2-4", "R3-4")
    assert weakness_names(float(2**16 - 1)) == tuple(WEAKNESSES)


def test_weaknesses_are_added_and_taken():
    careful = rule_planner(ROADMAP, "hardened").parameters
    assert careful == Parameters()
    one = rule_planner(ROADMAP, "hardened+R1-2").parameters
    assert one == Parameters(static_speed=PROFILES["apollo-easy"].severities["R1-2"])
    all_but_one = rule_planner(ROADMAP, "apollo-like~R1-8").parameters
    assert all_but_one == replace(rule_planner(ROADMAP, "apollo-like").parameters, branch_turn=0.0)
    assert rule_planner(ROADMAP, "hardened+R1-2~R1-2").parameters == careful


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("rule:hardend", "did you mean 'hardened'"),
        ("rule:hardened\0", "Unknown profile of the rule planner"),
        ("rule:hardened+R1-3x", "Unknown weakness of the rule planner 'R1-3x'"),
        ("rule:hardened~R1-2", "~R1-2: the weakness is not on"),
        ("rule:apollo-easy+R1-2", r"\+R1-2: the weakness is already on"),
    ],
)
def test_wrong_variants_are_refused(name, message):
    with pytest.raises(InputError, match=message):
        load_ads(name, ROADMAP)
