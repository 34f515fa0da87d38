"""Drivers that do not do the same twice in the compiled engine: what they did is recorded as theirs, and not lost."""

import numpy as np
import pytest

from behavexplor.data.target import Target
from behavexplor.execution.confirmation import confirmed
from behavexplor.execution.evaluator import EXECUTE
from behavexplor.execution.executor import ADSError
from behavexplor.execution.simulation import Simulation
from behavexplor.execution.start import start_executor
from behavexplor.judge.specs import DIFFERS

ENV = "highway-fast-v0"


class Rarely:
    """Fails in its third decision, and never again. It drives one episode at a time."""

    calls = 0

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        self.calls += 1
        if self.calls == 3:
            raise RuntimeError("a rare one")
        return np.array([4]), state


class Always:
    """Fails in every decision."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        raise RuntimeError("a common one")


class Remembering:
    """Goes faster until it has decided 30 times, and slower from then on."""

    calls = 0

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        self.calls += 1
        return np.array([3 if self.calls <= 30 else 4]), state


@pytest.fixture(scope="module")
def scenario():
    return Simulation(ENV, Rarely()).logical.sample(np.random.default_rng(0))


def executed(driver, scenario, **settings):
    target = Target(ENV, f"{__name__}:{driver}", unconfined=True, **settings)
    with start_executor(target, 0) as executor, pytest.raises(ADSError) as caught:
        executor.submit(EXECUTE, scenario.to_json().encode()).result()
    return caught.value


def test_a_failure_that_does_not_happen_again_is_not_lost(scenario):
    error = executed("Rarely", scenario)
    assert error.kind == "raised"
    assert error.message == "RuntimeError: a rare one; repeated, it did not fail in the same scenario"


def test_a_failure_that_happens_again_is_as_it_was(scenario):
    assert executed("Always", scenario).message == "RuntimeError: a common one"


def test_without_confirmation_the_driver_is_not_asked_again(scenario, monkeypatch):
    def refuse(*_):
        raise AssertionError("highway-env was asked")

    monkeypatch.setattr(Simulation, "run", refuse)
    assert executed("Rarely", scenario, confirm=False).message == "RuntimeError: a rare one"


def test_a_driver_that_remembers_earlier_episodes_is_not_taken_for_an_error_of_the_engine(scenario):
    simulation = Simulation(ENV, Remembering())
    ((_, trace),) = simulation.run_all([scenario])
    assert trace.end == "collision"
    simulation.ads.calls = 28
    with pytest.raises(ADSError, match="did not drive a scenario in the same way") as caught:
        confirmed(simulation, scenario, trace)
    assert caught.value.kind == DIFFERS


def test_a_failure_in_the_compiled_engine_alone_is_a_disagreement(scenario, monkeypatch):
    driver = Remembering()
    driver.calls = 30
    safe = Simulation(ENV, driver).run(scenario)
    monkeypatch.setattr(Simulation, "run", lambda *_: safe)
    error = executed("Always", scenario)
    assert error.kind == DIFFERS
    assert "disagree: only in one of them, the ADS failed (raised): RuntimeError: a common one" in error.message


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
