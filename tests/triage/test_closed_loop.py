"""Fault in traffic that reacts."""

from dataclasses import replace

import numpy as np
import pytest

from behavexplor.execution.simulation import Simulation
from behavexplor.triage.blame import blame
from behavexplor.triage.closed_loop import BY_CHANCE, CONSTANT, ScriptedDriver, find_driver


@pytest.fixture(scope="module")
def merging():
    return Simulation("merge-v0", "constant:FASTER")


def test_a_driver_that_does_not_crash_is_named(merging):
    scenario = merging.logical.sample(np.random.default_rng(1))
    trace = merging.run(scenario)
    assert trace.end == "collision"
    driver, tried = find_driver(merging.logical, scenario, np.random.default_rng(0))
    assert driver == "careful"
    assert tried == 1 + len(CONSTANT) + BY_CHANCE
    careful = Simulation("merge-v0", "careful")
    assert careful.run(replace(scenario, setup=careful.logical.setup)).end != "collision"
    verdict = blame(merging, scenario, trace, np.random.default_rng(0))
    assert (verdict.kind, verdict.driver) == ("preventable", "careful")
    assert verdict.at_fault


def test_the_same_generator_gives_the_same_verdict(merging):
    scenario = merging.logical.sample(np.random.default_rng(2))
    assert len({find_driver(merging.logical, scenario, np.random.default_rng(5)) for _ in range(2)}) == 1


def test_an_environment_without_meta_actions_has_no_witness():
    simulation = Simulation("racetrack-v0", f"{__name__}:Straight", env_config={"duration": 2})
    scenario = simulation.logical.sample(np.random.default_rng(0))
    assert find_driver(simulation.logical, scenario, np.random.default_rng(0)) == (None, 0)


class Straight:
    """A driver that never steers."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.zeros((len(observation), 1)), state


def test_a_scripted_driver_holds_its_last_action():
    driver = ScriptedDriver(np.array([[1, 2], [3, 4]]))
    state, taken = None, []
    for _ in range(4):
        actions, state = driver.predict(np.zeros((2, 5)), state)
        taken.append(actions.tolist())
    assert taken == [[1, 3], [2, 4], [2, 4], [2, 4]]
