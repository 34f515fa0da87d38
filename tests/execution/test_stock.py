"""Execution of stock environments: compiled, in highway-env itself, and configured as the policy was trained."""

import json
from dataclasses import replace

import numpy as np
import pytest

from behavexplor.data.drawn_logical import DrawnLogicalScenario
from behavexplor.data.road_shape import RoadShape
from behavexplor.data.target import Target
from behavexplor.data.trace import Trace
from behavexplor.errors import InputError
from behavexplor.evaluation import start_judge
from behavexplor.execution.evaluator import EXECUTE, ORIGINAL, PREFLIGHT
from behavexplor.execution.executor import ADSError
from behavexplor.execution.simulation import Simulation
from behavexplor.execution.start import logical_of_target, start_executor
from tests.envs.highway import strange

FAILING = "constant:IDLE"  # in merge-v0, it drives into the vehicle ahead


class Wanderer:
    """A driver that is configured by what it declares, and that never changes its mind."""

    vectorized = True
    env_config = {"policy_frequency": 2, "action": {"type": "DiscreteMetaAction", "target_speeds": [10, 20, 30]}}

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.full(len(observation), 4), state


class Straight:
    """A driver without any configuration, that never steers."""

    vectorized = True

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.zeros((len(observation), 1)), state


def test_the_configuration_of_training_is_the_environments():
    simulation = Simulation("merge-v0", Wanderer())
    config = json.loads(simulation.logical.setup.config)
    assert config["policy_frequency"] == 2
    assert simulation.env.inner.vehicle.target_speeds.tolist() == [10, 20, 30]
    given = Simulation("merge-v0", Wanderer(), env_config={"policy_frequency": 3})
    assert json.loads(given.logical.setup.config)["policy_frequency"] == 3


def test_the_logical_scenario_comes_from_where_the_driver_is():
    with start_executor(Target("merge-v0", "constant:SLOWER"), 0) as executor:
        logical = logical_of_target(executor, "merge-v0")
        assert isinstance(logical, DrawnLogicalScenario)
        scenario = logical.sample(np.random.default_rng(0))
        trace = Trace.from_bytes(executor.submit(EXECUTE, scenario.to_json().encode()).result())
        assert trace.end == "collision"  # shortly before the end, with the vehicle ahead
        road = RoadShape.from_json(executor.submit("road", b"").result().decode())
        assert len(road.surfaces) == 9


def test_highway_env_itself_executes_what_it_is_asked_for():
    simulation = Simulation("merge-v0", FAILING)
    scenario = simulation.logical.sample(np.random.default_rng(0))
    with start_executor(Target("merge-v0", FAILING), 0) as executor:
        trace = executor.submit(ORIGINAL, scenario.to_json().encode()).result()
    assert trace == simulation.run(scenario).to_bytes()


def test_a_search_does_not_wait_for_highway_env(monkeypatch):
    def refuse(*_):
        raise AssertionError("highway-env was asked")

    monkeypatch.setattr(Simulation, "run", refuse)
    data = Simulation("merge-v0", FAILING).logical.sample(np.random.default_rng(0)).to_json().encode()
    with start_executor(Target("merge-v0", FAILING), 0) as executor:
        assert Trace.from_bytes(executor.submit(EXECUTE, data).result()).end == "collision"
    with start_judge(Target("merge-v0", FAILING), 0) as executor:
        assert "collision" in json.loads(executor.submit(EXECUTE, data).result())[0]


def test_a_driver_of_one_observation_is_compiled_too():
    class Single(Wanderer):
        vectorized = False

    episodes = Simulation("merge-v0", Single()).lock_step(8)
    assert episodes is not None
    assert episodes.free == 1


def test_a_driver_of_our_roads_is_refused_in_other_environments():
    with pytest.raises(InputError, match="'rule' follows a route on the roads of this package"):
        Simulation("merge-v0", "rule")


def test_an_environment_that_is_not_compiled_is_said_to_be_slow():
    target = Target("racetrack-v0", f"{__name__}:Straight", unconfined=True, env_config={"duration": 2})
    with start_executor(target, 0) as executor:
        warnings = json.loads(executor.submit(PREFLIGHT, b"").result())
    assert any("highway-env itself executes the scenarios" in warning for warning in warnings)


def test_a_configuration_that_cannot_be_used_is_named():
    with pytest.raises(InputError, match="The environment 'merge-v0' cannot be made"):
        Simulation("merge-v0", "constant:IDLE", env_config={"other_vehicles_type": "no.such.Vehicle"})
    with pytest.raises(
        InputError, match=r"cannot be made: TypeError: .float. object cannot be interpreted as an integer$"
    ):
        Simulation("highway-fast-v0", "constant:IDLE", env_config={"lanes_count": float("nan")})


def test_an_unknown_key_of_the_configuration_is_named_and_ignored():
    with pytest.warns(UserWarning, match="merge-v0 does not have the key 'policy_freq' .*: did you mean 'policy_freq"):
        simulation = Simulation("merge-v0", "constant:IDLE", env_config={"policy_freq": 5, "screen_width": 300})
    config = simulation.logical.config
    assert "policy_freq" not in config
    assert config["screen_width"] == 300


class Picky:
    """Drives many episodes at a time, slowly, and fails in the scenario that begins with one observation."""

    vectorized = True
    env_config = {"duration": 5, "vehicles_count": 5}
    refused = np.zeros((5, 5))

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        if any(np.allclose(row, self.refused) for row in observation if row.any()):
            raise RuntimeError("not this one")
        return np.full(len(observation), 4), state


def test_a_scenario_goes_alike_beside_one_in_which_the_driver_fails():
    simulation = Simulation("highway-fast-v0", Picky())
    rng = np.random.default_rng(0)
    refused, other = simulation.logical.sample(rng), simulation.logical.sample(rng)
    beside = {}
    target = Target("highway-fast-v0", f"{__name__}:Picky", unconfined=True)
    for is_refused in (False, True):
        if is_refused:
            Picky.refused = simulation.env.reset(options={"scenario": refused})[0]
        with start_executor(target, 0) as executor:
            futures = [executor.submit(EXECUTE, one.to_json().encode()) for one in (refused, other)]
            beside[is_refused] = futures[1].result()
            if is_refused:
                with pytest.raises(ADSError, match="not this one"):
                    futures[0].result()
    assert beside[True] == beside[False]


def test_an_episode_that_the_engine_cannot_begin_is_driven_in_highway_env():
    target = Target(strange.registered(strange.SeldomOnAnotherRoad), "constant:SLOWER")
    simulation = Simulation(target.env, target.ads)
    usual = simulation.logical.sample(np.random.default_rng(0))
    draws = {**dict(usual.draws), "_create_road/lanes": (1 - 1e-9,)}
    seldom = replace(usual, draws=tuple(sorted(draws.items())))
    with start_executor(target, 0) as executor:
        futures = [executor.submit(EXECUTE, one.to_json().encode()) for one in (usual, seldom)]
        results = [future.result() for future in futures]
    assert results[1] == simulation.run(seldom).to_bytes()
    assert results[0] != results[1]
