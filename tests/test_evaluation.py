"""Rates over scenarios drawn uniformly, and the lock-step in which they are driven."""

import json

import numpy as np
import pytest

from behavexplor.commands import BAD_INPUT, EXECUTION_FAILED, OK, main
from behavexplor.evaluation import Evaluation, estimate_rates
from behavexplor.execution.rollout import ADSError, rollout_all
from behavexplor.execution.simulation import Simulation
from tests.drivers import Cruiser


@pytest.fixture(scope="module")
def cruising():
    simulation = Simulation("intersection-straight", "tests.drivers:Cruiser")
    generator = np.random.default_rng(3)
    scenarios = [simulation.logical.sample(generator) for _ in range(23)]
    yield simulation, scenarios, [simulation.run(scenario) for scenario in scenarios]
    simulation.close()


@pytest.mark.parametrize("batch", [1, 2, 7, 64])
def test_in_lock_step_everything_happens_as_one_by_one(batch, cruising):
    simulation, scenarios, expected = cruising
    got = dict(simulation.run_all(scenarios, batch))
    assert sorted(got) == list(range(23))
    for number, trace in enumerate(expected):
        assert got[number].to_bytes() == trace.to_bytes()


def test_a_planner_with_memory_and_a_log_drives_alike_in_lock_step():
    simulation = Simulation("lane-change", "rule")
    generator = np.random.default_rng(4)
    scenarios = [simulation.logical.sample(generator) for _ in range(9)]
    for number, trace in simulation.run_all(scenarios, 4):
        assert trace.to_bytes() == simulation.run(scenarios[number]).to_bytes()
        assert len(trace.decisions["decision"]) == len(trace.actions)


def test_what_only_the_single_environment_can_do_is_done_there(cruising):
    simulation = Simulation("intersection-straight", "tests.drivers:Ranger")
    assert simulation.vector_env(8) is None
    assert [number for number, _ in simulation.run_all(cruising[1][:2])] == [0, 1]


def test_a_wrong_answer_to_a_batch_is_named(cruising):
    class Short(Cruiser):
        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            return np.zeros((1, 2)), state

    simulation, scenarios, _ = cruising
    envs = simulation.vector_env(4)
    with pytest.raises(ADSError, match=r"actions of shape \(4, 2\), got \(1, 2\)"):
        next(rollout_all(envs, Short(), scenarios))


def test_no_scenarios_no_traces(cruising):
    assert list(cruising[0].run_all([])) == []


def test_outcomes_are_counted(cruising):
    found = Evaluation.of(cruising[2])
    traces = cruising[2]
    assert found.n == 23
    assert found.counts["arrived"] == sum(trace.end == "arrived" for trace in traces)
    assert found.counts["collision"] == sum(trace.end == "collision" for trace in traces) > 0
    assert found.counts["collision"] == sum(count for name, count in found.counts.items() if ": " in name)
    assert found.counts["destination"] + found.counts["arrived"] == 23


@pytest.mark.parametrize(
    ("count", "n", "low", "high"), [(0, 100, 0.0, 0.0370), (50, 100, 0.4038, 0.5962), (3, 10, 0.1078, 0.6032)]
)
def test_intervals_are_wilsons(count, n, low, high):
    """The figures are those of the published tables of the score interval."""
    assert Evaluation(n, {"x": count}).interval("x") == pytest.approx((low, high), abs=2e-4)
    assert Evaluation(n, {"x": count}).rate("x") == count / n


def test_the_same_seed_gives_the_same_scenarios(cruising):
    first, again, other = (estimate_rates(cruising[0], 12, seed).counts for seed in (0, 0, 1))
    assert first == again
    assert first != other


def test_the_command_prints_rates_and_writes_them(tmp_path, capsys):
    file = tmp_path / "rates.json"
    flags = ["--ads", "tests.drivers:Cruiser", "--scenarios", "20", "--json", str(file), "--quiet"]
    assert main(["evaluate", *flags]) == OK
    out = capsys.readouterr().out
    counts = json.loads(file.read_text())
    assert counts["n"] == 20
    assert f"{counts['arrived'] / 20:.1%} (" in out
    assert "tests.drivers:Cruiser in intersection-straight, 20 scenarios" in out


@pytest.mark.parametrize(("flag", "value"), [("--scenarios", "0"), ("--seed", "-1"), ("--env", "nowhere")])
def test_wrong_flags_are_refused(flag, value, capsys):
    assert main(["evaluate", flag, value]) == BAD_INPUT
    assert value in capsys.readouterr().err


def test_a_driver_that_fails_ends_the_evaluation_with_its_words(capsys):
    flags = ["--env", "lane-follow", "--ads", "tests.drivers:Lost", "--scenarios", "3", "--quiet"]
    assert main(["evaluate", *flags]) == EXECUTION_FAILED
    assert "In one of the scenarios the ADS failed (invalid): predict must return finite" in capsys.readouterr().err


def test_figures_that_cannot_be_written_are_named(tmp_path, capsys):
    flags = ["--ads", "tests.drivers:Cruiser", "--scenarios", "2", "--json", str(tmp_path), "--quiet"]
    assert main(["evaluate", *flags]) == BAD_INPUT
    assert "cannot be written" in capsys.readouterr().err
