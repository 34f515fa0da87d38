"""Observations that are dictionaries of arrays: single episodes, lock-step, workers, and policies that were saved."""

from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.spaces import Box, Discrete
from stable_baselines3 import SAC
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from behavexplor.data.target import Target
from behavexplor.envs.making import make_registered
from behavexplor.errors import InputError
from behavexplor.execution import simulation as simulation_module
from behavexplor.execution.evaluator import EXECUTE
from behavexplor.execution.preflight import preflight_warnings
from behavexplor.execution.simulation import Simulation, seen_in
from behavexplor.execution.start import check_ads, start_executor
from tests.goals import NAME, SPACE, Aimless


@pytest.fixture(scope="module")
def parked(tmp_path_factory):
    """A policy on dictionaries, with statistics of a part of them."""
    folder = tmp_path_factory.mktemp("policy")
    env = VecNormalize(DummyVecEnv([lambda: gymnasium.make(NAME)]), norm_obs_keys=["observation"])
    small = {"net_arch": [8]}
    model = SAC("MultiInputPolicy", env, policy_kwargs=small, device="cpu", seed=1, buffer_size=100, learning_starts=10)
    model.learn(10)
    with torch.no_grad():
        model.actor.mu.bias[0] = 0.6  # it sets out
    model.save(folder / "model")
    env.save(str(folder / "vec_normalize.pkl"))
    (folder / "model.yaml").write_text("policy_frequency: 2\nsimulation_frequency: 10\n")
    return str(folder / "model.zip")


def scenarios(simulation, count):
    generator = np.random.default_rng(8)
    return [simulation.logical.sample(generator) for _ in range(count)]


def test_a_policy_drives_alike_alone_in_company_and_in_a_worker(parked):
    simulation = Simulation(NAME, parked)
    chosen = scenarios(simulation, 3)
    alone = [simulation.run(scenario).to_bytes() for scenario in chosen]
    assert len(set(alone)) == 3
    assert simulation.lock_step(2) is not None
    for number, trace in simulation.run_all(chosen, 2):
        assert trace.to_bytes() == alone[number]
    with start_executor(Target(NAME, parked), 1) as workers:
        assert check_ads(workers) == []
        futures = [workers.submit(EXECUTE, scenario.to_json().encode()) for scenario in chosen]
        assert [future.result() for future in futures] == alone
    simulation.close()


def test_a_driver_may_spoil_the_dictionary_that_it_was_given():
    simulation = Simulation(NAME, "tests.goals:Aimless")
    chosen = scenarios(simulation, 4)
    alone = [simulation.run(scenario).to_bytes() for scenario in chosen]
    for number, trace in simulation.run_all(chosen, 4):
        assert trace.to_bytes() == alone[number]
    assert preflight_warnings(simulation) == []
    simulation.close()


def test_a_policy_trained_on_other_values_is_named(parked):
    simulation = Simulation(NAME, parked)
    simulation.ads.last_trained_on = {key: array + 9e3 for key, array in simulation.ads.last_trained_on.items()}
    (warning,) = preflight_warnings(simulation)
    assert "100% of the values" in warning
    simulation.close()


PARTS = dict(SPACE.items())


@pytest.mark.parametrize(
    ("observations", "fits"),
    [
        (PARTS, True),
        ({**PARTS, "observation": Box(0, 1, (7, 5), np.float64)}, True),  # values of the same form
        ({**PARTS, "observation": Box(-np.inf, np.inf, (7, 6))}, False),
        ({**PARTS, "achieved_goal": Discrete(2)}, False),
        ({**PARTS, "more": PARTS["observation"]}, False),
        ({key: PARTS[key] for key in ("observation", "achieved_goal")}, False),
        (None, False),
    ],
)
def test_a_policy_fits_if_each_part_of_its_observations_has_the_form_of_the_environments(observations, fits):
    space = PARTS["observation"] if observations is None else gymnasium.spaces.Dict(observations)
    policy = SimpleNamespace(observation_space=space, action_space=Box(-1, 1, (2,)), action=Aimless.action)
    assert seen_in(NAME, policy, {}) == (policy, fits)


@pytest.mark.parametrize(
    ("actions", "fits"),
    [(Discrete(5), True), (Discrete(5, start=1), True), (Discrete(6), False), (Box(0, 1, ()), False)],
)
def test_a_policy_fits_if_it_chooses_among_as_many_actions(actions, fits):
    policy = SimpleNamespace(observation_space=SPACE, action_space=actions, action={"type": "DiscreteMetaAction"})
    assert seen_in(NAME, policy, {})[1] is fits


def test_an_environment_with_other_observations_is_told_in_a_sentence(parked):
    with pytest.raises(InputError) as refused:
        Simulation("lane-follow", parked)
    message = str(refused.value)
    assert "observes Dict(achieved_goal: Box(2,), desired_goal: Box(2,), observation: Box(7, 5))" in message
    assert message.endswith("The policy needs an environment whose observations are such dictionaries")
    assert "--trust" not in message


def test_environments_that_are_only_looked_at_are_closed(monkeypatch):
    """Those that a policy might have been trained in are looked at when it does not fit the one that is asked for."""
    open_ones = []

    def watched(make):
        def made(*given):
            env = make(*given)
            open_ones.append(env)
            monkeypatch.setattr(env, "close", lambda: open_ones.remove(env))
            return env

        return made

    monkeypatch.setattr(simulation_module, "make_env", watched(simulation_module.make_env))
    monkeypatch.setattr(simulation_module, "make_registered", watched(simulation_module.make_registered))
    unknown = SimpleNamespace(observation_space=Box(0, 1, (1, 2, 3)), action_space=Discrete(77))
    with pytest.raises(InputError, match="has"):
        Simulation("highway-fast-v0", unknown)
    assert len(open_ones) == 1  # the one that is asked for
    open_ones.clear()
    seen_in(NAME, SimpleNamespace(observation_space=SPACE, action_space=Discrete(5)), {})
    assert open_ones == []


def test_the_configuration_that_a_driver_declares_is_that_of_the_environment_itself(monkeypatch):
    configured = []
    made = make_registered(NAME, {})
    monkeypatch.setattr(simulation_module, "make_registered", lambda _, config: configured.append(config) or made)
    driver = SimpleNamespace(
        observation_space=SPACE, action_space=Discrete(5), policy_frequency=2, env_config={"duration": 7, "vehicles": 3}
    )
    seen_in(NAME, driver, {"vehicles": 1})
    assert configured == [{"policy_frequency": 2, "duration": 7, "vehicles": 1}]
