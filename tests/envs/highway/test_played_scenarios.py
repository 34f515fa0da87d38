"""The registered environments of highway-env play recorded scenarios, and refuse options that they would ignore."""

import json

import gymnasium
import numpy as np
import pytest

import behavexplor
from behavexplor.errors import InputError
from behavexplor.execution.simulation import Simulation

FASTER = 3


@pytest.fixture(scope="module")
def recorded():
    """A scenario of highway-fast-v0 with its trace."""
    simulation = Simulation("highway-fast-v0", "constant:FASTER")
    scenario = simulation.logical.sample(np.random.default_rng(5))
    yield scenario, simulation.run(scenario)
    simulation.close()


def made(scenario, **changes):
    config = {**json.loads(scenario.setup.config), **changes}
    return gymnasium.make("behavexplor/highway-fast-v0", config=config)


def test_a_recorded_scenario_is_played(recorded):
    scenario, trace = recorded
    env = made(scenario)
    for _ in range(2):
        _, info = env.reset(options={"scenario": scenario})
        while "trace" not in info:
            *_, info = env.step(FASTER)
        assert info["trace"].to_bytes() == trace.to_bytes()
    env.close()


def test_other_episodes_are_as_without_it(recorded):
    scenario, _ = recorded
    env, plain = made(scenario), gymnasium.make("highway-fast-v0", config=json.loads(scenario.setup.config))
    assert type(env.unwrapped) is type(plain.unwrapped)
    env.reset(seed=3)
    env.reset(options={"scenario": scenario})
    plain.reset(seed=3)
    for _ in range(2):  # the draws of the scenario do not touch those of the environment
        assert np.array_equal(env.reset()[0], plain.reset()[0])
        assert env.step(FASTER)[1:4] == plain.step(FASTER)[1:4]


def test_options_that_would_be_ignored_are_errors(recorded):
    scenario, _ = recorded
    env = made(scenario)
    options = {"scenaro": scenario}
    with pytest.raises(InputError, match="did you mean 'scenario'"):
        env.reset(options=options)
    assert list(options) == ["scenaro"]
    with pytest.raises(InputError, match="must be a scenario of this environment, got 3"):
        env.reset(options={"scenario": 3})
    with pytest.raises(InputError, match="'lanes_count' in its configuration"):
        made(scenario, lanes_count=2).reset(options={"scenario": scenario})
    wide = Simulation("highway-fast-v0", "constant:FASTER", traffic="wide").logical.sample(np.random.default_rng(0))
    with pytest.raises(InputError, match="open_run"):
        env.reset(options={"scenario": wide})
    assert "lanes_count" in env.unwrapped.config
    assert env.reset(options={"config": {"lanes_count": 2}})
    assert env.unwrapped.config["lanes_count"] == 2


def test_every_registered_environment_has_it():
    for name in behavexplor.HIGHWAY_ENV:
        assert gymnasium.spec(f"behavexplor/{name}").additional_wrappers[0].name == "PlaysScenarios"
