"""A driver with a state: each episode begins without that of another one."""

import numpy as np

from behavexplor.execution.simulation import Simulation

ENV = "highway-fast-v0"


class Counting:
    """Begins anew where it has no state, and does not look at `episode_start`. It drives one episode at a time."""

    env_config = {"duration": 4, "vehicles_count": 2}

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        count = 0 if state is None else state
        return np.array([3 if count < 2 else 4]), count + 1


def test_an_episode_begins_without_the_state_of_another_one():
    simulation = Simulation(ENV, Counting())
    scenario = simulation.logical.sample(np.random.default_rng(0))
    first, again = (trace for _, trace in simulation.run_all([scenario, scenario]))
    assert first.to_bytes() == again.to_bytes()
