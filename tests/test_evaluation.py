"""Rates over scenarios drawn uniformly, and the lock-step in which they are driven."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from behavexplor import Run, evaluation
from behavexplor.api.evaluating import board
from behavexplor.commands import BAD_INPUT, CHECK_FAILED, EXECUTION_FAILED, OK, UNDECIDED, main
from behavexplor.commands.rate_table import rates_table as table
from behavexplor.data.target import Target
from behavexplor.errors import InputError
from behavexplor.evaluation import STREAM, Evaluation, estimate_rates, start_judge, uniform_outcomes
from behavexplor.execution.executor import ADSError
from behavexplor.execution.rollout import rollout_all
from behavexplor.execution.simulation import Simulation
from behavexplor.execution.start import logical_of_target
from behavexplor.judge.outcomes import Outcomes, outcomes_of, outcomes_of_error
from behavexplor.judge.rates import ABOVE, BELOW, Decision, Goal
from tests.confining import confines
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
    found = Evaluation.of_outcomes(map(outcomes_of, cruising[2]))
    traces = cruising[2]
    assert found.n == 23
    assert found.counts["arrived"] == sum(trace.end == "arrived" for trace in traces)
    assert found.counts["collision"] == sum(trace.end == "collision" for trace in traces) > 0
    assert found.counts["collision"] == sum(count for name, count in found.counts.items() if ": " in name)
    assert found.counts["destination"] + found.counts["arrived"] == 23


@pytest.mark.parametrize(
    ("count", "n", "low", "high"), [(0, 100, 0.0, 0.0362), (50, 100, 0.3983, 0.6017), (3, 10, 0.0667, 0.6525)]
)
def test_intervals_are_exact(count, n, low, high):
    """The figures are those of the published tables of Clopper and Pearson."""
    assert Evaluation(n, {"collision": count}).interval("collision") == pytest.approx((low, high), abs=2e-4)
    assert Evaluation(n, {"collision": count}).rate("collision") == count / n


@pytest.mark.parametrize("ahead", [1, 1024])
@pytest.mark.parametrize(
    ("goal", "verdict"), [(Goal("failed", below=0.9), BELOW), (Goal("at-fault", below=0.01), ABOVE)]
)
def test_an_evaluation_ends_where_its_rate_is_decided_however_many_are_under_way(
    ahead, goal, verdict, cruising, monkeypatch
):
    monkeypatch.setattr(evaluation, "AHEAD", ahead)
    logical = cruising[0].logical
    with start_judge(Target("intersection-straight", "tests.drivers:Cruiser", unconfined=True), 0) as executor:
        found = estimate_rates(executor, logical, 200, 0, goal=goal)
        whole = list(uniform_outcomes(executor, logical, found.n, 0))
    decision = found.decision
    assert decision.verdict == verdict
    assert found.n == decision.n < 200
    wanted = [one.at_fault if goal.outcome == "at-fault" else not one.passed for one in whole]
    assert decision.count == sum(wanted)
    assert not Decision.of(goal, decision.n - 1, sum(wanted[:-1])).verdict
    assert found.counts == Evaluation.of_outcomes(whole).counts


def test_an_undecided_rate_is_said_to_be(cruising):
    with start_judge(Target("intersection-straight", "tests.drivers:Cruiser", unconfined=True), 0) as executor:
        found = estimate_rates(executor, cruising[0].logical, 5, 0, goal=Goal("lines", until=0.01))
    assert not found.decision.verdict
    assert found.decision.n == 5


@pytest.mark.parametrize(("below", "code"), [(0.995, OK), (0.001, CHECK_FAILED), (0.8, UNDECIDED)])
def test_the_exit_code_is_the_decision(below, code, tmp_path, capsys):
    flags = ["--ads", "tests.drivers:Cruiser", "--workers", "0", "--unconfined", "--outcome", "failed", "--quiet"]
    file = tmp_path / "rates.json"
    limits = ["--below", str(below), "--scenarios", "20", "--json", str(file)]
    assert main(["evaluate", "--env", "S1", *flags, *limits]) == code
    words = " ".join(capsys.readouterr().out.split())
    assert "which says nothing about roads" in words
    assert "%)" not in words.split("the one interval that holds is below")[1].split("95 %")[0].rsplit("(", 1)[0]
    decision = json.loads(file.read_text())["decision"]
    assert decision["verdict"] == {OK: "below", CHECK_FAILED: "above", UNDECIDED: ""}[code]


def test_an_outcome_that_does_not_exist_is_named(capsys):
    assert main(["evaluate", "--env", "S1", "--ads", "idm", "--below", "0.1", "--outcome", "colision"]) == BAD_INPUT
    assert "did you mean 'collision'?" in capsys.readouterr().err


@pytest.mark.parametrize("outcome", ["collision", "error", "failed", "at-fault"])
def test_a_driver_whose_program_fails_is_never_below(outcome, tmp_path):
    flags = ["--env", "lane-follow", "--ads", "tests.drivers:Lost", "--unconfined", "--workers", "0", "--quiet"]
    flags += ["--below", "0.1", "--outcome", outcome, "--json", str(tmp_path / "rates.json")]
    assert main(["evaluate", *flags, "--junit", str(tmp_path / "rates.xml")]) == EXECUTION_FAILED
    decision = json.loads((tmp_path / "rates.json").read_text())["decision"]
    assert (decision["verdict"], decision["count"]) == ("above", decision["n"])
    assert decision["errors"] == (decision["n"] if outcome == "collision" else 0)
    words = (tmp_path / "rates.xml").read_text()
    assert ("collision or error in" in words) == (outcome == "collision")
    assert 'failures="1"' in words


def test_errors_among_other_outcomes_count_against_the_driver(monkeypatch):
    """A program that fails in some scenarios does not arrive in them, and may have crashed there."""
    passed, failed = Outcomes(("arrived",), ("arrived", "collision"), False), outcomes_of_error("raised")
    monkeypatch.setattr(evaluation, "uniform_outcomes", lambda *_: iter([passed, failed] * 100))
    rates = {
        outcome: estimate_rates(None, None, 200, 0, goal=Goal(outcome, until=0.9)).decision
        for outcome in ("collision", "arrived")
    }
    collision, arrived = rates["collision"], rates["arrived"]
    assert collision.count == collision.errors == collision.n // 2
    assert (arrived.count, arrived.errors) == (-(-arrived.n // 2), 0)


@pytest.mark.parametrize("limit", [{"below": 0.1}, {"until": 0.1}])
def test_an_outcome_that_means_nothing_in_an_environment_is_refused(limit):
    target = Target("highway-fast-v0", "constant:FASTER")
    with start_judge(target, 0) as executor, pytest.raises(InputError, match="'destination' means nothing") as refused:
        estimate_rates(executor, logical_of_target(executor, target.env), 400, 0, goal=Goal("destination", **limit))
    assert str(refused.value).endswith("name one of collision, lines, error, at-fault, failed")


@pytest.mark.parametrize("name", ["colision", "at_fault", "", "collision_"])
def test_an_unknown_outcome_is_refused_wherever_it_is_named(name, cruising):
    found = Evaluation.of_outcomes([outcomes_of(trace) for trace in cruising[2]])
    for ask in (
        found.count,
        found.rate,
        found.interval,
        Goal,
        lambda name: board({"a": {"ads": "idm"}}, "x", outcome=name),
    ):
        with pytest.raises(InputError, match="Unknown outcome"):
            ask(name)
    assert found.count("collision: npc_wreck") == 0


@pytest.mark.parametrize("ahead", [1, 5, 1024])
def test_the_same_seed_gives_the_same_rates_however_many_are_under_way(ahead, cruising, monkeypatch):
    monkeypatch.setattr(evaluation, "AHEAD", ahead)
    logical, done = cruising[0].logical, []
    with start_judge(Target("intersection-straight", "tests.drivers:Cruiser", unconfined=True), 0) as executor:
        first = estimate_rates(executor, logical, 12, 0, done.append)
        other = estimate_rates(executor, logical, 12, 1)
    generator = np.random.default_rng([STREAM, 0])
    assert first == Evaluation.of_outcomes(outcomes_of(cruising[0].run(logical.sample(generator))) for _ in range(12))
    assert first != other
    assert done[-1] == 12


def evaluated(tmp_path, ads, *flags):
    """The exit code of an evaluation in few scenarios, and its figures."""
    file = tmp_path / "rates.json"
    code = main(["evaluate", "--env", "lane-follow", "--ads", ads, "--scenarios", "9", "--json", str(file), *flags])
    return code, json.loads(file.read_text()) if file.exists() else None


def test_rates_do_not_depend_on_the_workers(tmp_path):
    found = [evaluated(tmp_path, "tests.drivers:Cruiser", "--workers", count) for count in ("1", "2")]
    assert found[0] == found[1] == evaluated(tmp_path, "tests.drivers:Cruiser", "--workers", "0", "--unconfined")
    assert found[0][0] == OK


def test_a_driver_is_examined_before_its_evaluation(tmp_path, capsys):
    assert evaluated(tmp_path, "tests.execution.test_preflight:Parked", "--workers", "1")[0] == OK
    assert "Warning: The ego never moved in 4 scenarios" in capsys.readouterr().err
    assert evaluated(tmp_path, "tests.execution.test_preflight:Parked", "--workers", "1", "--quiet")[0] == OK
    assert capsys.readouterr().err == ""


class Diarist(Cruiser):
    """Keeps a diary where it should not."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        Path(os.environ["DIARY"]).write_text("x")
        return super().predict(observation, state)


@pytest.mark.skipif(not confines(), reason="this system cannot confine a process")
def test_a_driver_that_is_evaluated_is_confined(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("DIARY", str(tmp_path / "diary"))
    command = [sys.executable, "-m", "behavexplor", "evaluate", "--env", "lane-follow", "--scenarios", "1"]
    command += ["--ads", "tests.test_evaluation:Diarist", "--workers", "1"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == EXECUTION_FAILED
    assert "raised 100.0%" in " ".join(result.stdout.split())
    assert "without --unconfined, an ADS may neither write files nor use the network" in result.stderr
    assert not (tmp_path / "diary").exists()
    assert subprocess.run([*command, "--unconfined"], capture_output=True, check=False).returncode == OK
    assert (tmp_path / "diary").exists()
    assert main(["evaluate", "--ads", "tests.test_evaluation:Diarist", "--workers", "0"]) == BAD_INPUT
    assert "cannot be confined" in capsys.readouterr().err


class Painter(Cruiser):
    """Fails with words that would clear a terminal."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        raise ValueError("\x1b[2Jall well\r")


@pytest.mark.parametrize("command", [["evaluate", "--scenarios", "1"], ["fuzz", "--budget", "1"]])
def test_the_words_of_a_driver_do_not_reach_the_terminal_as_they_are(command, tmp_path, capsys):
    out = ["--out", str(tmp_path / "run")] if command[0] == "fuzz" else []
    main([*command, "--ads", "tests.test_evaluation:Painter", "--workers", "1", *out])
    printed = capsys.readouterr()
    assert "\\x1b[2Jall well" in printed.err
    if out:
        assert main(["replay", str(tmp_path / "run"), "0"]) == OK
        printed = capsys.readouterr()
        assert "\\x1b[2Jall well" in printed.out
    assert all(line.isprintable() for line in (printed.out + printed.err).splitlines())


def test_the_command_prints_rates_and_writes_them(tmp_path, capsys):
    file = tmp_path / "rates.json"
    flags = ["--ads", "tests.drivers:Cruiser", "--workers", "1", "--scenarios", "20", "--json", str(file), "--quiet"]
    assert main(["evaluate", *flags]) == OK
    out = capsys.readouterr().out
    counts = json.loads(file.read_text())
    assert counts["n"] == 20
    assert f"{counts['arrived'] / 20:.1%} (" in out
    assert out.startswith("20 scenarios of intersection-straight, with 95 % intervals:")


def test_an_ego_that_crashes_has_not_arrived():
    simulation = Simulation("roundabout-v0", "constant:FASTER")
    generator = np.random.default_rng(0)
    traces = [trace for _, trace in simulation.run_all([simulation.logical.sample(generator) for _ in range(40)])]
    beyond = sum(bool(trace.signals["arrived"].any()) for trace in traces)
    found = Evaluation.of_outcomes(map(outcomes_of, traces)).counts
    assert found["arrived"] == sum(trace.end != "collision" for trace in traces) < beyond
    assert found["arrived"] + found["collision"] == 40
    assert found["destination"] == 40 - beyond


def test_a_row_that_repeats_another_one_is_left_out():
    one = Evaluation(9, {"arrived": 5, "collision": 3, "collision: other": 3, "lines": 0, "destination": 4})
    rows = [line.split()[0] for line in table("x", {"a": one}).splitlines()[2:]]
    assert rows == ["arrived", "collision", "lines"]
    two = Evaluation(
        9, {"arrived": 4, "collision": 4, "collision: other": 3, "collision: npc_wreck": 1, "destination": 1}
    )
    rows = [line.split()[0] for line in table("x", {"b": two}).splitlines()[2:]]
    assert rows == ["arrived", "collision", "npc", "other", "destination"]
    lines = table("x", {"a": one, "b": two, "c": two}).splitlines()
    assert lines[-4:-2] == ["Beside it, in 9 scenarios:", "   arrived  collision  destination"]
    assert lines[-1].split() == ["c", "44.4%", "44.4%", "11.1%"]


@pytest.mark.parametrize(("flag", "value"), [("--scenarios", "0"), ("--seed", "-1"), ("--env", "nowhere")])
def test_wrong_flags_are_refused(flag, value, capsys):
    assert main(["evaluate", flag, value]) == BAD_INPUT
    assert value in capsys.readouterr().err


def test_a_driver_that_fails_is_counted_and_kept_with_its_words(tmp_path, capsys):
    flags = ["--env", "lane-follow", "--ads", "tests.drivers:Lost", "--workers", "1", "--scenarios", "3"]
    assert main(["evaluate", *flags, "--out", str(tmp_path)]) == EXECUTION_FAILED
    said = capsys.readouterr()
    assert "The driver itself failed in every execution" in said.err
    assert "Warning: In the first scenarios, the ADS failed (invalid): predict must return finite" in said.err
    rows = {line.split()[0]: line.split()[1] for line in said.out.splitlines()[2:4]}
    assert rows == {"error": "100.0%", "invalid": "100.0%"}
    assert "In 3 scenarios the driver itself failed" in said.out
    errors = [record.error for record in Run(tmp_path / "failures").records]
    assert [error["kind"] for error in errors] == ["invalid"] * 3


def test_figures_that_cannot_be_written_are_named(tmp_path, capsys):
    flags = ["--ads", "tests.drivers:Cruiser", "--workers", "1", "--scenarios", "2", "--json", str(tmp_path), "--quiet"]
    assert main(["evaluate", *flags]) == BAD_INPUT
    assert "is a folder" in capsys.readouterr().err
