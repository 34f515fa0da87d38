"""Scenarios that are the random draws of an environment."""

import json

import gymnasium
import highway_env  # noqa: F401 - registers the environments
import pytest

from behavexplor.data.drawn_scenario import DrawnScenario, Setup, config_text, sorted_draws
from behavexplor.data.scenario import parse_scenario, read_scenario
from behavexplor.errors import InputError

SETUP = Setup("merge-v0", config_text({"duration": 40, "lanes": [1, 2]}), "default", "1.12.1")
SCENARIO = DrawnScenario(SETUP, 7, sorted_draws({"_make_vehicles": [0.25, 0.1], "_make/_place#1": [-1.5]}))


def test_it_survives_json_exactly():
    again = parse_scenario(SCENARIO.to_json())
    assert again == SCENARIO
    assert hash(again) == hash(SCENARIO)
    assert read_scenario(SCENARIO.to_dict()) == SCENARIO
    assert SCENARIO.functional == "merge-v0"


def test_the_order_of_keys_and_draws_does_not_matter():
    value = SCENARIO.to_dict()
    value["config"] = dict(reversed(value["config"].items()))
    value["draws"] = dict(reversed(value["draws"].items()))
    assert read_scenario(value) == SCENARIO


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"seed": -1}, "seed: expected a whole number"),
        ({"seed": True}, "seed: expected a whole number"),
        ({"draws": {"a": [float("nan")]}}, r"draws\['a'\]\[0\]: expected a finite number"),
        ({"draws": {"a": ["1"]}}, r"draws\['a'\]\[0\]: expected a finite number"),
        ({"draws": {"a": 1.0}}, "draws: expected lists of numbers by name"),
        ({"draws": {"a": [0.5] * 20_001}}, "draws: at most 20000"),
        ({"config": []}, "config: expected highway-env's configuration"),
        ({"traffic": "dense"}, "traffic: expected default or wide"),
        ({"functional": 3}, "functional: expected a text"),
        ({"highway-env": None}, "highway-env: expected a text"),
        ({"speed": 3}, "'speed' is not a field of the scenario"),
    ],
)
def test_what_is_wrong_is_named(change, message):
    with pytest.raises(InputError, match=message):
        read_scenario({**SCENARIO.to_dict(), **change})


def test_a_missing_field_is_named():
    value = SCENARIO.to_dict()
    del value["seed"]
    with pytest.raises(InputError, match="seed: missing"):
        read_scenario(value)


def test_a_configuration_that_is_not_json_is_refused():
    with pytest.raises(InputError, match="configuration cannot be stored"):
        config_text({"color": {1, 2}})
    with pytest.raises(InputError, match="configuration cannot be stored"):
        config_text({"speed": float("inf")})


@pytest.mark.parametrize(
    ("other", "difference"),
    [
        (Setup("exit-v0", SETUP.config, "default", "1.12.1"), "env is 'exit-v0', not 'merge-v0'"),
        (Setup("merge-v0", SETUP.config, "wide", "1.12.1"), "traffic is 'wide', not 'default'"),
        (Setup("merge-v0", SETUP.config, "default", "1.11.0"), "highway-env is '1.11.0', not '1.12.1'"),
        (Setup("merge-v0", config_text({"duration": 9}), "default", "1.12.1"), "'duration' in its configuration is 9"),
        (SETUP, None),
    ],
)
def test_the_difference_of_two_setups_is_named(other, difference):
    found = SETUP.difference(other)
    assert found is None if difference is None else difference in found


def test_the_json_is_readable():
    assert json.loads(SCENARIO.to_json())["draws"] == {"_make/_place#1": [-1.5], "_make_vehicles": [0.25, 0.1]}


@pytest.mark.parametrize("action", [{}, {"lateral": False}, {"longitudinal": False}])
def test_meta_actions_are_named_as_in_highway_env(action):
    config = {"action": {"type": "DiscreteMetaAction", **action}}
    names = gymnasium.make("highway-fast-v0", config=config).unwrapped.action_type.actions
    setup = Setup("highway-fast-v0", config_text(config), "default", "1.11.0")
    assert dict(enumerate(DrawnScenario(setup, 0, ()).meta_actions)) == names


def test_continuous_actions_have_no_names():
    setup = Setup("highway-fast-v0", config_text({"action": {"type": "ContinuousAction"}}), "default", "1.11.0")
    assert DrawnScenario(setup, 0, ()).meta_actions == ()
