"""A registered environment plays recorded scenarios of highway-env, and refuses options that it would ignore."""

import json

import gymnasium
import numpy as np
import pytest

import behavexplor  # noqa: F401 - registers environments
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
    return gymnasium.make("behavexplor/drawn-v0", env=scenario.setup.env, config=config)


def test_a_recorded_scenario_is_played(recorded):
    scenario, trace = recorded
    env = made(scenario)
    for _ in range(2):
        _, info = env.reset(options={"scenario": scenario})
        while "trace" not in info:
            *_, info = env.step(FASTER)
        assert info["trace"].to_bytes() == trace.to_bytes()
    env.close()


def test_other_episodes_are_those_of_highway_env(recorded):
    env, plain = made(recorded[0]), gymnasium.make("highway-fast-v0", config=json.loads(recorded[0].setup.config))
    for seed in range(2):
        assert np.array_equal(env.reset(seed=seed)[0], plain.reset(seed=seed)[0])
        assert env.step(FASTER)[1:4] == plain.step(FASTER)[1:4]


def test_options_that_would_be_ignored_are_errors(recorded):
    scenario, _ = recorded
    with pytest.raises(InputError, match="did you mean 'scenario'"):
        made(scenario).reset(options={"scenaro": scenario})
    with pytest.raises(InputError, match="'lanes_count' in its configuration"):
        made(scenario, lanes_count=2).reset(options={"scenario": scenario})
