"""The last chance of a crash, against all sequences of actions driven from the start of the episode."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from behavexplor.execution.simulation import Simulation
from behavexplor.triage import closed_loop as module
from behavexplor.triage.closed_loop import BEYOND, MOST_BACK, last_chance

NAMES = ["LANE_LEFT", "IDLE", "LANE_RIGHT", "FASTER", "SLOWER"]


def crashes(env, driver, count):
    simulation = Simulation(env, driver)
    rng = np.random.default_rng(3)
    scenarios = [simulation.logical.sample(rng) for _ in range(40)]
    traces = sorted(simulation.run_all(scenarios), key=lambda pair: pair[0])
    ended = [(scenarios[i], trace) for i, trace in traces if trace.end == "collision"]
    assert len(ended) >= count
    return simulation, ended[:count]


def survivors(simulation, scenario, commands, back):
    """The actions at so many decisions before the crash after which some sequence survives, driven one by one."""
    begun, free = commands[:-back], back + BEYOND
    sequences = np.array(list(product(range(len(NAMES)), repeat=free)))
    envs = simulation.vector_env(len(sequences))
    envs.reset(options={"scenarios": [scenario] * len(sequences)})
    for action in begun:
        envs.engine.step(np.full(len(sequences), action))
    crashed = np.zeros(len(sequences), dtype=bool)
    for column in sequences.T:
        crashed |= envs.engine.step(column)[-1]["crashed"]  # an episode that has ended says nothing any more
    return {NAMES[sequence[0]] for sequence in sequences[~crashed]}


@pytest.mark.parametrize(
    ("env", "driver"),
    [
        ("merge-v0", "constant:FASTER"),
        ("highway-fast-v0", "constant:IDLE"),
        ("roundabout-v0", "constant:FASTER"),
        ("intersection-v0", "constant:IDLE"),
    ],
)
def test_it_is_what_driving_every_sequence_from_the_start_gives(env, driver):
    simulation, ended = crashes(env, driver, 2)
    found = 0
    for scenario, trace in ended:
        chance = last_chance(simulation, scenario, trace)
        commands = trace.actions[:, 0].astype(int)
        for back in (1, 2):  # more would be 5 ** 6 sequences
            saving = survivors(simulation, scenario, commands, back)
            if chance is not None and back == chance.back:
                assert saving == set(chance.saving)
                assert chance.did == NAMES[commands[-back]]
                found += 1
            elif chance is None or back < chance.back:
                assert not saving
    assert found


def test_the_words_say_what_was_done_and_what_would_have_saved_the_ego():
    simulation, [(scenario, trace)] = crashes("merge-v0", "constant:FASTER", 1)
    chance = last_chance(simulation, scenario, trace)
    assert chance.words == f"FASTER instead of {' or '.join(chance.saving)}"


def test_nothing_is_said_of_what_is_no_crash_or_cannot_branch():
    simulation, [(scenario, trace)] = crashes("merge-v0", "constant:FASTER", 1)
    assert last_chance(simulation, scenario, replace(trace, end="ended")) is None
    other = replace(trace, actions=np.full_like(trace.actions, NAMES.index("SLOWER")))
    assert last_chance(simulation, scenario, other) is None  # these actions do not crash
    straight = Simulation("intersection-straight", "constant:3,0")
    scripted = straight.logical.sample(np.random.default_rng(0))
    assert last_chance(straight, scripted, replace(straight.run(scripted), end="collision")) is None


def test_a_search_that_takes_too_long_claims_nothing(monkeypatch):
    simulation, [(scenario, trace)] = crashes("merge-v0", "constant:FASTER", 1)
    assert last_chance(simulation, scenario, trace).back <= MOST_BACK
    monkeypatch.setattr(module, "MOST_BRANCHINGS", 1)
    assert last_chance(simulation, scenario, trace) is None
