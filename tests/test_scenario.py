"""Concrete scenarios: exact JSON, and errors that name the field."""

import json

import pytest
from hypothesis import given

from behavexplor.envs.functional.intersection_straight import IntersectionStraightEnv
from behavexplor.errors import InputError
from behavexplor.scenario import NPC, Scenario, Waypoint
from tests.strategies import scenarios

LOGICAL = IntersectionStraightEnv.logical

VALID = {
    "functional": "intersection-straight",
    "npcs": [{"type": "sedan", "route": "west-inner-left", "waypoints": [[10, 3.5], [20.25, 0]]}],
}


def changed(**fields):
    return {**VALID, **fields}


def with_npc(**fields):
    return changed(npcs=[{**VALID["npcs"][0], **fields}])


@given(scenarios(LOGICAL))
def test_json_restores_exactly(scenario):
    assert Scenario.from_json(scenario.to_json()) == scenario
    assert Scenario.from_json(scenario.to_json()).to_json() == scenario.to_json()


def test_scenarios_are_values():
    scenario = Scenario.from_dict(VALID)
    assert scenario == Scenario(
        "intersection-straight", [NPC("sedan", "west-inner-left", [Waypoint(10, 3.5), Waypoint(20.25, 0)])]
    )
    assert hash(scenario) == hash(Scenario.from_dict(VALID))
    with pytest.raises(AttributeError):
        scenario.functional = "other"


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ([], "the scenario must be an object with functional, npcs"),
        ({"npcs": []}, "functional: missing"),
        (changed(weather="rain"), "'weather' is not a field of the scenario; the fields are functional, npcs"),
        (changed(functional=3), "functional: expected a name, got 3"),
        (changed(npcs={}), "npcs: expected a list"),
        (changed(npcs=[7]), "npcs[0]: an NPC must be an object"),
        (with_npc(type=""), "npcs[0].type: expected a name"),
        (with_npc(route=None), "npcs[0].route: expected a name"),
        (with_npc(waypoints=[]), "npcs[0].waypoints: at least one"),
        (with_npc(waypoints=[[1]]), "npcs[0].waypoints[0]: expected [position, speed]"),
        (with_npc(waypoints=[[1, "fast"]]), "npcs[0].waypoints[0].speed: expected a number"),
        (with_npc(waypoints=[[1, -0.1]]), "npcs[0].waypoints[0].speed: expected a number"),
        (with_npc(waypoints=[[True, 1]]), "npcs[0].waypoints[0].position: expected a number"),
        (with_npc(waypoints=[[10**400, 1]]), "npcs[0].waypoints[0].position: expected a number"),
        (with_npc(waypoints=[[5, 1], [4, 0]]), "npcs[0].waypoints[1].position: 4.0 lies before"),
    ],
)
def test_errors_name_the_field(value, message):
    with pytest.raises(InputError) as error:
        Scenario.from_json(json.dumps(value))
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("text", ["", "{", "[" * 100_000, "NaN", '{"functional": "x", "npcs": ' + " " * 10**6 + "[]}"])
def test_text_that_is_no_scenario(text):
    with pytest.raises(InputError):
        Scenario.from_json(text)


@pytest.mark.parametrize("number", ["NaN", "Infinity", "-Infinity"])
def test_numbers_are_finite(number):
    text = json.dumps(VALID).replace("3.5", number)
    with pytest.raises(InputError, match=r"npcs\[0\].waypoints\[0\].speed"):
        Scenario.from_json(text)
