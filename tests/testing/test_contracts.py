"""The contract tests that ship with the package: what we have keeps them, and each broken promise is named."""

import importlib.util

import gymnasium
import numpy as np
import pytest

import behavexplor
from behavexplor.envs.functional import LaneFollowEnv
from behavexplor.errors import InputError
from behavexplor.fuzz.methods import METHODS
from behavexplor.fuzz.search import Candidate
from behavexplor.fuzz.uniform import Uniform
from behavexplor.judge.stl import Signal, always
from behavexplor.testing import ContractError, check_ads, check_env, check_search_method, check_spec
from tests.drivers import Cruiser

NEEDS = {"nsga2": "pymoo", "map-elites": "ribs", "novelty-search": "ribs"}
COSTLY = {"samota", "avfuzzer"}  # their searches among themselves take long; tests/fuzz checks them with small options


@pytest.mark.parametrize("name", sorted(METHODS.keys() - COSTLY))
def test_every_search_method_keeps_the_contract(name):
    if importlib.util.find_spec(NEEDS.get(name, "numpy")) is None:
        pytest.skip("its library is not installed")
    check_search_method(name, executions=40)


class Unseeded(Uniform):
    """Draws from the clock."""

    def __init__(self, logical, seed, options):
        super().__init__(logical, np.random.default_rng().integers(2**31), options)


class Deaf(Uniform):
    """Has no use for its seed."""

    def __init__(self, logical, seed, options):
        super().__init__(logical, 0, options)


class Miscounting(Uniform):
    """Counts from one."""

    def ask(self):
        candidate = super().ask()
        return Candidate(candidate.number + 1, candidate.scenario, candidate.origin, None)


class Bold(Uniform):
    """Asks for scenarios of another environment."""

    def ask(self):
        candidate = super().ask()
        scenario = LaneFollowEnv.logical.sample(np.random.default_rng(candidate.number))
        return Candidate(candidate.number, scenario, "elsewhere", None)


class Talkative(Uniform):
    """Learns what no file can hold."""

    def tell(self, candidate, trace, verdict):
        return {"trace": trace}


class Forgetful(Uniform):
    """Keeps what only the first instance knows."""

    made = 0

    def __init__(self, logical, seed, options):
        type(self).made += 1
        super().__init__(logical, seed + (type(self).made > 5), options)


class Anonymous(Uniform):
    pass


Anonymous.__doc__ = None


@pytest.mark.parametrize(
    ("method", "message"),
    [
        (Unseeded, "asked for different scenarios"),
        (Deaf, "use the seed"),
        (Miscounting, "Candidate 0 has the number 1"),
        (Bold, "The scenario of candidate 0 cannot be run"),
        (Talkative, "not JSON"),
        (Forgetful, "asked for another candidate"),
        (Anonymous, "no docstring"),
        (object, "object has no Options"),
        ("uniform.py", "Unknown search method"),
    ],
)
def test_a_broken_promise_of_a_search_method_is_named(method, message):
    with pytest.raises((ContractError, InputError), match=message):
        check_search_method(method, executions=10)


@pytest.mark.parametrize("name", ["rule", "idm", "learned:intersection-straight", "tests.drivers:cruiser"])
def test_driving_systems_keep_the_contract(name):
    assert check_ads(name) == []


class Remembering(Cruiser):
    """Drives the slower the more often it was asked."""

    def __init__(self):
        self.asked = 0

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        self.asked += 1
        actions, state = super().predict(observation, state)
        return actions * 0.999**self.asked, state


class Herding(Cruiser):
    """Drives as the first of a batch."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        actions, state = super().predict(observation, state)
        actions[:, 0] = actions[0, 0] * (1 - 0.1 * (len(actions) > 1))
        return actions, state


class Mute(Cruiser):
    """Answers nothing."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return None


@pytest.mark.parametrize(
    ("ads", "message"),
    [(Remembering(), "keep nothing"), (Herding(), "`vectorized` is true"), (Mute(), "must return a pair")],
)
def test_a_broken_promise_of_a_driving_system_is_named(ads, message):
    with pytest.raises(ContractError, match=message):
        check_ads(ads, env="lane-follow", scenarios=3)


def test_what_is_odd_about_a_driving_system_is_a_warning():
    assert any("always chooses" in warning for warning in check_ads("constant", env="lane-follow", scenarios=2))


def stays_below_10(trace):
    """A spec in one line."""
    return always(Signal(trace.time, 10.0 - np.hypot(*trace.velocity[:, 0].T)))


def counting():
    calls = []

    def spec(trace):
        calls.append(trace)
        return float(len(calls))

    return spec


def test_a_spec_keeps_the_contract():
    check_spec(stays_below_10)
    check_spec("tests.testing.test_contracts:stays_below_10", env="lane-change")
    check_spec(stays_below_10, env="highway-fast-v0", traces=2)


def test_a_spec_is_called_on_what_is_special_in_environments_of_highway_env():
    seen = []

    def watches(trace):
        seen.append((trace.present.size > 0, "crashed" in trace.signals, trace.size.shape[0]))
        return 1.0

    check_spec(watches, env="intersection-v0", traces=1)
    assert seen[0][:2] == (True, True)  # vehicles come and go
    assert (False, True, 1) in seen


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        (lambda trace: 1.0, "cannot be named '<lambda>'"),
        (counting(), "gave another robustness"),
        (3, "is not callable"),
    ],
)
def test_a_broken_promise_of_a_spec_is_named(spec, message):
    with pytest.raises((ContractError, InputError), match=message):
        check_spec(spec, traces=2)


@pytest.mark.parametrize(
    ("returned", "message"),
    [
        (float("nan"), "returned nan: it must return a number"),
        ("far", "returned 'far': it must return a number"),
        (None, "returned None: it must return a number"),
        (True, "returned True: it must return a number"),
        (np.zeros(3), r"returned array\(.* it must return a number"),
    ],
)
def test_what_is_no_robustness_is_named(returned, message):
    def spec(trace):
        return returned

    with pytest.raises(ContractError, match=message):
        check_spec(spec, traces=1)


def test_a_spec_that_fails_on_a_short_trace_is_named():
    def second(trace):
        return trace.position[1, 0, 0]

    with pytest.raises(ContractError, match=r"On a trace of a single frame: The spec 'second' raised IndexError"):
        check_spec(second, traces=1)


@pytest.mark.parametrize("name", behavexplor.FUNCTIONAL_SCENARIOS)
def test_every_environment_keeps_the_contract(name):
    check_env(name, scenarios=2)


class NoScenario(LaneFollowEnv):
    """Takes another scenario than it was given."""

    def reset(self, *, seed=None, options=None):
        return super().reset(seed=seed)


class Noisy(LaneFollowEnv):
    """Adds noise to what the ego does."""

    def step(self, action):
        return super().step(np.clip(action + np.random.default_rng().normal(0, 0.1, 2), -1, 1).astype(np.float32))


@pytest.mark.parametrize(("kind", "message"), [(NoScenario, "the scenario that runs"), (Noisy, "gave another trace")])
def test_a_broken_promise_of_an_environment_is_named(kind, message):
    gymnasium.register("broken/road-v0", kind)
    try:
        with pytest.raises(ContractError, match=message):
            check_env("broken/road-v0", scenarios=1)
    finally:
        del gymnasium.registry["broken/road-v0"]
