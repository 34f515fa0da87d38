"""The counting of failures without traces: the same outcomes, one by one, as those of the traces."""

import json

import gymnasium
import numpy as np
import pytest
from highway_env.envs import RoundaboutEnv

from behavexplor import FUNCTIONAL_SCENARIOS, HIGHWAY_ENV, evaluation
from behavexplor.data.target import Target
from behavexplor.evaluation import STREAM, Evaluation, start_judge, uniform_outcomes
from behavexplor.execution.evaluator import EXECUTE
from behavexplor.execution.executor import ADSError
from behavexplor.execution.simulation import Simulation
from behavexplor.judge.outcomes import outcomes_of, packed, unpacked
from tests.drivers import Cruiser

POLICIES = "docs/data/policies"
SOME = (
    ("highway-fast-v0", f"{POLICIES}/highway-fast.zip", False),
    ("intersection-v0", f"{POLICIES}/intersection.zip", True),
    ("roundabout-v0", "careful", False),
    ("exit-v0", "constant:FASTER", False),
    ("intersection-straight", f"{POLICIES}/intersection-straight.npz", False),
    ("lane-change", "rule", False),
)
ALL = (
    *((env, "careful", False) for env in HIGHWAY_ENV),
    *((env, "constant:FASTER", False) for env in HIGHWAY_ENV),
    *((env, ads, False) for env in FUNCTIONAL_SCENARIOS for ads in ("rule", "idm", f"learned:{env}")),
    *(
        (f"{name}-v0", f"{POLICIES}/{name}.zip", False)
        for name in ("highway-fast", "merge", "roundabout", "intersection")
    ),
    *((f"{name}-v0", f"{POLICIES}/{name}.zip", True) for name in ("highway-fast", "roundabout", "intersection")),
)


def counted(env, ads, drawn, n, workers=0):
    """The outcomes of scenarios as they are counted."""
    with start_judge(Target(env, ads, unconfined=True, stochastic=drawn), workers) as judge:
        assert judge.submit("can_count", b"256").result()
        return list(uniform_outcomes(judge, Simulation(env, ads).logical, n, 5))


def check_equality(env, ads, drawn, n):
    simulation, generator = Simulation(env, ads, stochastic=drawn), np.random.default_rng([STREAM, 5])
    traces = dict(simulation.run_all([simulation.logical.sample(generator) for _ in range(n)], 32))
    expected = [outcomes_of(traces[number]) for number in range(n)]
    assert counted(env, ads, drawn, n) == expected


@pytest.mark.parametrize(("env", "ads", "drawn"), SOME)
def test_what_is_counted_is_what_traces_tell(env, ads, drawn):
    check_equality(env, ads, drawn, 90)


@pytest.mark.slow
@pytest.mark.parametrize(("env", "ads", "drawn"), ALL)
def test_what_is_counted_is_what_traces_tell_in_every_environment(env, ads, drawn):
    check_equality(env, ads, drawn, 2000)


class OwnStarts(RoundaboutEnv):
    """A roundabout that places its own vehicles, so that highway-env itself begins the episodes."""

    def _make_vehicles(self):
        super()._make_vehicles()
        self.road.vehicles[-1].target_speed = 10.0


gymnasium.register("own-starts-v0", entry_point=OwnStarts)


def test_what_is_counted_is_what_traces_tell_where_highway_env_begins_the_episodes():
    check_equality("own-starts-v0", "careful", False, 24)


def test_workers_change_nothing():
    found = [counted("roundabout-v0", "careful", False, 600, workers) for workers in (0, 1, 2)]
    assert found[0] == found[1] == found[2]


def test_large_blocks_change_nothing(monkeypatch):
    small = counted("roundabout-v0", "careful", False, 1300)
    monkeypatch.setattr(evaluation, "MANY", 1300)
    assert counted("roundabout-v0", "careful", False, 1300) == small


class Forgetful(Cruiser):
    """Brakes in every episode of a small batch, and in none of a larger one."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        actions, state = super().predict(observation, state)
        if len(observation) == evaluation.BLOCK:
            actions[:, 0] = -1.0
        return actions, state


def test_a_failure_that_does_not_recur_ends_the_evaluation():
    with (
        start_judge(Target("lane-follow", "tests.test_counting:Forgetful", unconfined=True), 0) as judge,
        pytest.raises(RuntimeError, match="scenario 0 failed, and did not fail when it was driven again"),
    ):
        list(uniform_outcomes(judge, Simulation("lane-follow", "idm").logical, 20, 0))


class Fallible(Cruiser):
    """Fails where another vehicle starts near."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        if (np.abs(observation[:, 1, 1] - observation[:, 0, 1]) < 5).any() and observation[0, 0, 0]:
            raise ValueError("too near")
        return super().predict(observation, state)


def test_scenarios_in_which_the_driver_fails_are_counted_one_by_one():
    logical = Simulation("lane-follow", "idm").logical
    with start_judge(Target("lane-follow", "tests.test_counting:Fallible", unconfined=True), 0) as judge:
        found = list(uniform_outcomes(judge, logical, 300, 0))
        generator = np.random.default_rng([STREAM, 0])
        requests = [logical.sample(generator).to_json().encode() for _ in range(300)]
        alone = []
        for request in requests:
            try:
                judge.submit(EXECUTE, request).result()
                alone.append(False)
            except ADSError as error:
                alone.append("too near" in str(error))
    assert [one.found == ("error", "error: raised") for one in found] == alone
    assert 0 < sum(alone) < 300
    rates = Evaluation.of_outcomes(found)
    assert rates.count("error") == rates.count("error: raised") == sum(alone) <= rates.failed


def test_packed_outcomes_are_unpacked():
    outcomes = counted("roundabout-v0", "constant:FASTER", False, 100)
    values = json.loads(json.dumps(packed(outcomes)))
    assert len(values["kinds"]) == len(set(outcomes)) > 1
    assert unpacked(values) == outcomes
    assert Evaluation.of_outcomes(outcomes).n == 100
