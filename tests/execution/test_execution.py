"""From a scenario to its trace: rollout, simulation, executors."""

import re

import gymnasium
import numpy as np
import pytest

from behavexplor.data.scripted import ScriptedScenario
from behavexplor.data.target import Target
from behavexplor.data.trace import Trace
from behavexplor.envs.functional import IntersectionStraightEnv
from behavexplor.envs.making import environment_id
from behavexplor.errors import InputError
from behavexplor.execution import simulation as simulation_module
from behavexplor.execution.evaluator import EXECUTE, Evaluator
from behavexplor.execution.executor import ADSError
from behavexplor.execution.rollout import rollout
from behavexplor.execution.simulation import Simulation, compile_kernels
from behavexplor.execution.start import InProcessExecutor, logical_of_target, start_executor
from tests.drivers import Cruiser

LOGICAL = IntersectionStraightEnv.logical

SCENARIOS = [LOGICAL.sample(np.random.default_rng(seed)) for seed in range(4)]


def begun(ads):
    """An evaluator that has begun in this process."""
    evaluator = Evaluator(env="intersection-straight", ads=ads)
    evaluator.begin()
    return evaluator


class Diary(Cruiser):
    """Counts its decisions in its state, and keeps a log of them."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        actions, _ = super().predict(observation)
        count = np.where(episode_start, 0, 0 if state is None else state) + 1
        return actions, count

    def log(self, state):
        return {"count": state}


def test_the_state_and_the_log_of_an_ads():
    env = gymnasium.make(
        environment_id("intersection-straight"), config={"observation": {"type": "Scene"}, "action": Diary.action}
    )
    ads = Diary()
    for scenario in SCENARIOS[:2]:
        trace = rollout(env, ads, scenario)
        assert trace.decisions["count"].tolist() == list(range(1, len(trace.actions) + 1))
        assert trace.actions.shape == (len(trace.action_frame), 2)


def test_recorded_actions_give_the_same_trace():
    simulation = Simulation("intersection-straight", "tests.drivers:cruiser")
    trace = simulation.run(SCENARIOS[0])

    class Recorded(Cruiser):
        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            step = 0 if state is None else state
            return trace.actions[step][None], step + 1

    assert rollout(simulation.env, Recorded(), SCENARIOS[0]).to_bytes() == trace.to_bytes()
    simulation.close()


def test_all_executors_give_the_same_traces():
    target = Target("intersection-straight", "tests.drivers:cruiser", unconfined=True)
    simulation = Simulation(target.env, target.ads)
    expected = [simulation.run(scenario).to_bytes() for scenario in SCENARIOS]
    for workers in (0, 1, 2):
        with start_executor(target, workers) as executor:
            futures = [executor.submit(EXECUTE, scenario.to_json().encode()) for scenario in SCENARIOS]
            assert [future.result() for future in futures] == expected


def test_a_third_partys_driver_is_not_run_in_this_process_unless_it_may_do_anything():
    with pytest.raises(
        InputError, match=r"--workers 0 would run .* cannot be confined: use --workers 1, or .* --unconf"
    ):
        start_executor(Target("intersection-straight", "tests.drivers:cruiser"), 0)


def test_a_driver_is_loaded_to_see_whether_it_can_be():
    with start_executor(Target("lane-follow", "tests.drivers:cruiser"), 1) as executor:
        logical_of_target(executor, "lane-follow")
    with (
        start_executor(Target("lane-follow", "tests.drivers:nobody"), 1) as executor,
        pytest.raises(InputError, match="nobody"),
    ):
        logical_of_target(executor, "lane-follow")


def test_errors_come_back_from_the_executor():
    evaluator = begun("tests.drivers:cruiser")
    for batched in ("", EXECUTE):
        future = InProcessExecutor(evaluator, batched).submit(EXECUTE, b"{}")
        with pytest.raises(InputError, match="functional: missing"):
            future.result()


@pytest.mark.parametrize("workers", [0, 2])
def test_which_of_many_scenarios_an_ads_fails_in_does_not_depend_on_the_others(workers):
    target = Target("intersection-straight", "tests.drivers:Timid", unconfined=True)
    simulation = Simulation(target.env, target.ads)
    scenarios = [LOGICAL.sample(np.random.default_rng(seed)) for seed in range(12)]
    expected = []
    for scenario in scenarios:
        try:
            expected.append(simulation.run(scenario).to_bytes())
        except ADSError as error:
            expected.append(str(error))
    assert {type(outcome) for outcome in expected} == {bytes, str}
    with start_executor(target, workers) as executor:
        futures = [executor.submit(EXECUTE, scenario.to_json().encode()) for scenario in scenarios]
        for future, outcome in zip(futures, expected, strict=True):
            if isinstance(outcome, bytes):
                assert future.result() == outcome
            else:
                with pytest.raises(ADSError, match=re.escape(outcome)):
                    future.result()


def test_what_is_not_vectorized_runs_alone():
    assert begun("tests.drivers:Hermit").batch.capacity == 1
    with start_executor(Target("intersection-straight", "tests.drivers:Hermit", unconfined=True), 0) as executor:
        futures = [executor.submit(EXECUTE, scenario.to_json().encode()) for scenario in SCENARIOS]
        assert all(Trace.from_bytes(future.result()).end for future in futures)


def test_waiting_evaluations_can_be_cancelled_or_finished():
    target = Target("intersection-straight", "tests.drivers:cruiser", unconfined=True)
    request = SCENARIOS[0].to_json().encode()
    executor = start_executor(target, 0)
    futures = [executor.submit(EXECUTE, request) for _ in range(3)]
    executor.shutdown(wait=False)
    assert all(future.cancelled() for future in futures)
    with start_executor(target, 0) as executor:
        future = executor.submit(EXECUTE, request)
    assert future.done()


def test_the_kernels_of_all_views_are_compiled_before_a_driver_is_confined(monkeypatch):
    """A confined process cannot keep machine code: each step of a view compiles what the view needs."""
    original, stepped = Simulation.vector_env, []

    def noted(simulation, number, **changes):
        envs = original(simulation, number, **changes)
        step = envs.step
        envs.step = lambda actions: stepped.append((number, *changes)) or step(actions)
        return envs

    monkeypatch.setattr(Simulation, "vector_env", noted)
    compile_kernels("lane-follow")
    assert {(1,), (2,), (2, "observation"), (2, "action")} == set(stepped)


def test_the_kernels_of_highway_env_s_environments_are_compiled_under_both_of_their_names(monkeypatch):
    made = []
    monkeypatch.setattr(simulation_module, "make_vector_env", lambda env, *_: made.append(env))
    for env in ("highway-fast-v0", "behavexplor/highway-fast-v0"):
        compile_kernels(env)
    assert len(made) == 2


@pytest.mark.parametrize("name", ["intersection-straight", "behavexplor/intersection-straight-v0"])
def test_environment_names(name):
    assert environment_id(name) == "behavexplor/intersection-straight-v0"


def test_an_environment_of_another_package():
    """It is registered elsewhere, says what it can run, and takes highway-env's config."""
    gymnasium.register("elsewhere/crossing-v3", "behavexplor.envs.functional:IntersectionStraightEnv")
    try:
        trace = Simulation("elsewhere/crossing-v3", "tests.drivers:cruiser").run(
            ScriptedScenario("intersection-straight", ())
        )
    finally:
        del gymnasium.registry["elsewhere/crossing-v3"]
    assert isinstance(trace, Trace)
    assert trace.end == "arrived"


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (np.zeros((1, 2)), "must return a pair"),
        ((np.zeros(2), None), r"of shape \(1, 2\), got \(2,\)"),
        ((np.zeros((1, 3)), None), r"of shape \(1, 2\), got \(1, 3\)"),
        ((np.array([[np.nan, 0.0]]), None), "must return finite numbers"),
        ((np.array([["a", "b"]]), None), "must return finite numbers"),
    ],
)
def test_an_answer_that_is_no_action_is_named_at_once(answer, message):
    class Odd(Cruiser):
        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            return answer

    env = gymnasium.make(environment_id("intersection-straight"), config={"action": Odd.action})
    with pytest.raises(ADSError, match=message):
        rollout(env, Odd(), SCENARIOS[0])


def test_a_meta_action_out_of_range_is_named():
    class Wild(Cruiser):
        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            return np.array([7]), state

    env = gymnasium.make(environment_id("lane-follow"), config={"action": {"type": "DiscreteMetaAction"}})
    with pytest.raises(ADSError, match=r"actions of Discrete\(5\), got 7"):
        rollout(env, Wild(), env.unwrapped.logical.sample(np.random.default_rng(0)))


def test_an_ads_that_exits_is_an_error_of_its_execution():
    future = InProcessExecutor(begun("tests.drivers:Leaver")).submit(EXECUTE, SCENARIOS[0].to_json().encode())
    with pytest.raises(ADSError, match=r"called sys.exit\(0\)"):
        future.result()
