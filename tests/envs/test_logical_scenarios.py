import subprocess
import sys

import gymnasium
import pytest

import behavexplor  # noqa: F401 - registers the environments
from behavexplor.envs.logical_scenarios import LOGICAL_SCENARIOS

SCRIPT = """
import sys
import behavexplor.campaign.opening
from behavexplor.execution.simulation import logical_scenario
print(logical_scenario("lane-follow").name)
print(sorted({"highway_env", "matplotlib", "pandas", "sklearn", "torch"} & {*sys.modules}))
"""


@pytest.mark.parametrize("name", LOGICAL_SCENARIOS)
def test_they_are_those_of_the_environments(name):
    assert gymnasium.make(f"behavexplor/{name}-v0").unwrapped.logical is LOGICAL_SCENARIOS[name]


def test_a_campaign_knows_them_without_the_simulator():
    command = [sys.executable, "-c", SCRIPT]
    result = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert result.stdout.splitlines() == ["lane-follow", "[]"], result.stderr
