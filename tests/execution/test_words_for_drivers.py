"""What is said of drivers that have no `predict`, or no file beside which a configuration could be written."""

import gymnasium
import numpy as np
import pytest

from behavexplor.ads.loading import FunctionDriver
from behavexplor.errors import InputError
from behavexplor.execution.executor import ADSError
from behavexplor.execution.preflight import preflight_warnings
from behavexplor.execution.simulation import Simulation

ENV = "highway-fast-v0"
SHORT = {"duration": 2, "vehicles_count": 2}


class Trained:
    """A policy that knows its spaces, but not the configuration of its training."""

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (5, 5), np.float32)
    action_space = gymnasium.spaces.Discrete(5)

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.array([1]), state


@pytest.mark.parametrize("answer", [None, 7, 1.5, [1, 2], [[1], [2, 3]], "left"])
def test_a_function_is_told_of_its_own_answer(answer):
    simulation = Simulation(ENV, FunctionDriver(lambda _: answer), env_config=SHORT)
    with pytest.raises(ADSError) as caught:
        simulation.run(simulation.logical.sample(np.random.default_rng(0)))
    assert (caught.value.kind, caught.value.message) == (
        "invalid",
        f"the function must return an action of Discrete(5), got {answer!r}",
    )
    (warning,) = preflight_warnings(simulation)
    assert caught.value.message in warning


def advice(ads):
    (found,) = [said for said in preflight_warnings(Simulation(ENV, ads)) if "is not known" in said]
    return found


def test_a_file_is_named_only_beside_a_file():
    assert advice(Trained()).endswith("give it as env_config, or give an environment that has it instead of an id")
    named = advice(f"{__name__}:Trained")
    assert "--env-config FILE" in named
    assert "beside the model" not in named


def test_a_log_of_another_kind_is_no_decision_log():
    class Keeping(Trained):
        def __init__(self, log):
            self.log = log

    simulation = Simulation(ENV, Keeping([]), env_config=SHORT)
    scenario = simulation.logical.sample(np.random.default_rng(0))
    assert not simulation.run(scenario).decisions
    simulation.ads.log = print
    with pytest.raises(ADSError, match=r"log\(state\) must return arrays by name"):
        simulation.run(scenario)


class Unshowable:
    def __repr__(self):
        raise RuntimeError("nothing to see")


class EveryAttribute:
    """Has every attribute, as a mock has."""

    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        return EveryAttribute()

    def __call__(self, *_, **__):
        return 1

    def __repr__(self):
        return "all"


def raising(*_):
    raise ValueError("not today")


@pytest.mark.parametrize("env", ["highway-fast-v0", "lane-follow"])
@pytest.mark.parametrize(
    ("attributes", "words"),
    [
        (vars(EveryAttribute), "The driver's observation must be a mapping, such as .*, got all"),
        ({"action": None}, "The driver's action must be a mapping, such as {'type': 'DiscreteMetaAction'}, got None"),
        ({"env_config": [3]}, r"The driver's env_config must be a mapping, such as {'lanes_count': 3}, got \[3\]"),
        ({"policy_frequency": Unshowable()}, "The driver's policy_frequency must be a number, got a Unshowable that"),
        (
            {"vectorized": property(raising)},
            r"The driver's vectorized cannot be looked at: ValueError: not today \(test",
        ),
        ({"seeing": 3}, "The driver's seeing must be a method, got 3"),
        ({"seeing": lambda *_: None}, "The driver's seeing must return what has predict, got None"),
        ({"seeing": raising}, r"The driver's seeing failed: ValueError: not today \(test_words_for_drivers.py, line"),
    ],
)
def test_an_attribute_of_the_wrong_kind_is_named(attributes, words, env):
    declared = {} if "__getattr__" in attributes else {"observation": {"type": "Kinematics"}}
    driver = type("Driver", (), {"predict": lambda *_: (np.array([1]), None), **declared, **attributes})
    with pytest.raises(InputError, match=words):
        Simulation(env, driver())


def test_a_configuration_that_a_driver_makes_is_a_mapping():
    driver = type("Driver", (), {"predict": lambda *_: (np.array([1]), None), "fitted": lambda *_: [1]})
    with pytest.raises(InputError, match=r"The driver's fitted must return what has keys, got \[1\]"):
        Simulation("highway-fast-v0", driver())
