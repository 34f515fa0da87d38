"""Decisions that an ADS logs: each trace gets those of its own episode, and wrong ones are refused by name."""

import numpy as np
import pytest

from behavexplor.execution.executor import ADSError
from behavexplor.execution.rollout import DecisionRecorder
from behavexplor.execution.simulation import Simulation

SIMULATION = Simulation("intersection-straight", "constant")
SCENARIO = SIMULATION.logical.sample(np.random.default_rng(0))
TRACE = SIMULATION.run(SCENARIO)


class Echo:
    """Logs what it is given."""

    def log(self, state):
        return state


def recorded(*states, count=2):
    recorder = DecisionRecorder(Echo(), count)
    recorder.begin(np.ones(count, dtype=bool), np.ones(count, dtype=bool))
    for state in states:
        recorder.add(state)
    return recorder


def test_each_episode_has_the_decisions_since_it_began():
    """Episodes begin at random times in three sub-environments, and take many more steps than fit at first."""
    length, rng = len(TRACE.action_frame), np.random.default_rng(0)
    recorder, begins = DecisionRecorder(Echo(), 3), np.array([-1, -1, -1])  # -1: no episode
    n_completed = 0
    for step in range(20 * length):
        starts = (begins < 0) & (rng.random(3) < 0.02)
        if (begins < 0).all() and not starts.any():
            starts[rng.integers(3)] = True
        begins[starts] = step
        if starts.any():
            recorder.begin(starts, begins >= 0)
        recorder.add({"step": np.full(3, step), "place": step + np.arange(6.0).reshape(3, 2)})
        for slot in np.flatnonzero((begins >= 0) & (step - begins == length - 1)):
            decisions = recorder.completed(TRACE, slot).decisions
            steps = np.arange(begins[slot], step + 1)
            assert decisions["step"].tolist() == steps.tolist()
            assert decisions["place"].tolist() == (steps[:, None] + [2 * slot, 2 * slot + 1]).tolist()
            begins[slot] = -1
            n_completed += 1
    assert n_completed > 20
    assert recorder._room <= 4 * length


def test_later_episodes_may_log_something_else():
    recorder, every = DecisionRecorder(Echo(), 2), np.ones(2, dtype=bool)
    for log in ({"a": np.zeros(2)}, {"b": np.zeros((2, 3))}, {"b": np.zeros((2, 4))}):
        recorder.begin(every, every)
        for _ in TRACE.action_frame:
            recorder.add(log)
        assert recorder.completed(TRACE, 1).decisions.keys() == log.keys()


def test_without_a_log_the_trace_is_the_same():
    for ads in (object(), Echo()):
        recorder = DecisionRecorder(ads, 1)
        recorder.begin(np.ones(1, dtype=bool), np.ones(1, dtype=bool))
        recorder.add({})
        assert recorder.completed(TRACE, 0) is TRACE


@pytest.mark.parametrize(
    ("states", "message"),
    [
        (({"a": np.zeros(2)}, {"b": np.zeros(2)}), r"the same names at every decision: first \['a'\], now \['b'\]$"),
        (({"a": np.zeros(2)}, {"a": np.zeros((2, 1))}), r"of shape \(2,\) as 'a', got float64 of shape \(2, 1\)$"),
        (({"a": np.zeros(3)},), r"numbers of shape \(2,\) as 'a', got float64 of shape \(3,\)$"),
        (({"a": 5.0},), r"numbers of shape \(2,\) as 'a', got float64 of shape \(\)$"),
        (({"a": ["left", "right"]},), r"numbers of shape \(2,\) as 'a', got <U5 of shape \(2,\)$"),
        ((None,), "arrays by name: .* has no attribute 'items'"),
    ],
)
def test_a_wrong_log_is_refused_by_name(states, message):
    with pytest.raises(ADSError, match=r"log\(state\) must return .*" + message):
        recorded(*states)
