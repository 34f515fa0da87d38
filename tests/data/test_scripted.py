"""Concrete scenarios: exact JSON, and errors that name the field."""

import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from behavexplor.data.scenario import parse_scenario
from behavexplor.data.scripted import NPC, ScriptedScenario, Waypoint
from behavexplor.envs.functional import IntersectionStraightEnv
from behavexplor.errors import InputError
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
    assert parse_scenario(scenario.to_json()) == scenario
    assert parse_scenario(scenario.to_json()).to_json() == scenario.to_json()


def test_scenarios_are_values():
    scenario = ScriptedScenario.from_dict(VALID)
    assert scenario == ScriptedScenario(
        "intersection-straight", [NPC("sedan", "west-inner-left", [Waypoint(10, 3.5), Waypoint(20.25, 0)])]
    )
    assert hash(scenario) == hash(ScriptedScenario.from_dict(VALID))
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
        parse_scenario(json.dumps(value))
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("text", ["", "{", "[" * 100_000, "NaN", '{"functional": "x", "npcs": ' + " " * 10**6 + "[]}"])
def test_text_that_is_no_scenario(text):
    with pytest.raises(InputError):
        parse_scenario(text)


@pytest.mark.parametrize("number", ["NaN", "Infinity", "-Infinity"])
def test_numbers_are_finite(number):
    text = json.dumps(VALID).replace("3.5", number)
    with pytest.raises(InputError, match=r"npcs\[0\].waypoints\[0\].speed"):
        parse_scenario(text)


anything = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)


def places(value, path=()):
    """The paths to everything in a JSON value."""
    yield path
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, child in inner:
        yield from places(child, (*path, key))


def replaced(value, path, new):
    if not path:
        return new
    copied = dict(value) if isinstance(value, dict) else list(value)
    copied[path[0]] = replaced(value[path[0]], path[1:], new)
    return copied


@settings(max_examples=150, deadline=None)
@given(scenarios(LOGICAL), st.data())
def test_whatever_is_changed_is_refused_in_one_sentence_or_a_scenario(scenario, data):
    value = scenario.to_dict()
    for _ in range(data.draw(st.integers(1, 3))):
        value = replaced(value, data.draw(st.sampled_from(sorted(places(value), key=str))), data.draw(anything))
    for read, given_value in ((ScriptedScenario.from_dict, value), (parse_scenario, json.dumps(value))):
        try:
            restored = read(given_value)
        except InputError as error:
            assert "\n" not in str(error)
            assert len(str(error)) < 400
            continue
        assert parse_scenario(restored.to_json()) == restored
        try:
            LOGICAL.check(restored)
        except InputError as error:
            assert "\n" not in str(error)


@given(st.text(max_size=60))
def test_any_text_is_refused_or_a_scenario(text):
    with pytest.raises(InputError):
        parse_scenario(text)


@settings(max_examples=100, deadline=None)
@given(scenarios(LOGICAL), st.data())
def test_json_cut_or_scratched_anywhere_is_refused_or_a_scenario(scenario, data):
    text = scenario.to_json()
    place = data.draw(st.integers(0, len(text) - 1))
    with pytest.raises(InputError):
        parse_scenario(text[:place])
    try:
        parse_scenario(text[:place] + data.draw(st.characters(codec="utf-8")) + text[place + 1 :])
    except InputError as error:
        assert str(error)


@pytest.mark.parametrize(
    "build",
    [
        lambda: ScriptedScenario("x", [1]),
        lambda: NPC("a", "b", [(1, 2)]),
        lambda: NPC("a", "b", 3),
        lambda: ScriptedScenario("x", None),
    ],
)
def test_wrong_parts_are_refused_in_python_too(build):
    with pytest.raises(InputError):
        build()
