"""Scripted vehicles as parts: nothing is lost, and plain values are left out."""

import pytest
from hypothesis import given

from behavexplor.data.scenario import Part
from behavexplor.data.scripted import ScriptedScenario
from behavexplor.envs.functional import IntersectionStraightEnv
from behavexplor.errors import InputError
from tests.strategies import scenarios

LOGICAL = IntersectionStraightEnv.logical
ROUTE = LOGICAL.roadmap.npc_routes[0].name
PLAIN = (None,) * (2 * len(LOGICAL.position_ranges(LOGICAL.roadmap.routes[ROUTE])))


@given(scenarios(LOGICAL))
def test_parts_make_the_same_scenario_again(scenario):
    assert LOGICAL.with_parts(scenario, LOGICAL.parts(scenario)) == scenario


@pytest.mark.parametrize("route", [route.name for route in LOGICAL.roadmap.npc_routes])
def test_a_part_without_values_is_a_plain_vehicle(route):
    values = (None,) * (2 * len(LOGICAL.position_ranges(LOGICAL.roadmap.routes[route])))
    scenario = LOGICAL.with_parts(ScriptedScenario(LOGICAL.name, ()), (Part(route, values),))
    (npc,) = scenario.npcs
    assert npc.type == "sedan"
    assert {waypoint.speed for waypoint in npc.waypoints[:-1]} == {LOGICAL.roadmap.speed_limit}
    assert LOGICAL.parts(scenario) == (Part(route, values),)


@pytest.mark.parametrize(
    ("part", "message"),
    [
        (Part("nowhere", ()), "there is no route 'nowhere'"),
        (Part(ROUTE, (None,)), "a vehicle on this route has"),
        (Part(ROUTE, ("tractor", *PLAIN[1:])), "type"),
    ],
)
def test_other_parts_are_refused(part, message):
    with pytest.raises(InputError, match=message):
        LOGICAL.with_parts(ScriptedScenario(LOGICAL.name, ()), (part,))
