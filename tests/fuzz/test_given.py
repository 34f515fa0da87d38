"""Given scenarios: executed in order, and checked before anything runs."""

import json

import numpy as np
import pytest

from behavexplor.envs.functional import LaneChangeEnv
from behavexplor.errors import InputError
from behavexplor.fuzz.given import Given, GivenOptions
from behavexplor.fuzz.search import SearchExhausted

LOGICAL = LaneChangeEnv.logical


def test_every_scenario_of_the_file_is_asked_for_in_order(tmp_path):
    scenarios = [LOGICAL.sample(np.random.default_rng(seed)) for seed in range(3)]
    path = tmp_path / "given.jsonl"
    path.write_text("".join(scenario.to_json() + "\n" for scenario in scenarios))
    method = Given(LOGICAL, 0, GivenOptions(str(path)))
    assert [method.ask().scenario for _ in range(3)] == scenarios
    with pytest.raises(SearchExhausted, match="All 3 given scenarios"):
        method.ask()


def test_a_wrong_line_is_named(tmp_path):
    path = tmp_path / "given.jsonl"
    path.write_text(json.dumps({"functional": "lane-follow", "npcs": []}))
    with pytest.raises(InputError, match="line 1: functional: this is a scenario of 'lane-follow'"):
        Given(LOGICAL, 0, GivenOptions(str(path)))
    with pytest.raises(InputError, match="cannot be read"):
        Given(LOGICAL, 0, GivenOptions(str(tmp_path / "missing")))
