"""Experiments as a user runs them: to their end, cut off, gone on with, and with campaigns that fail."""

import csv
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from behavexplor.ads.rule.weaknesses import WEAKNESSES
from behavexplor.bench.experiment import experiment_config, read_experiment
from behavexplor.bench.runs import (
    CampaignService,
    ExperimentRunner,
    Outcome,
    RunState,
    campaign_request,
    run_state,
    take_outcome,
)
from behavexplor.bench.summaries import summarize
from behavexplor.campaign.config import CampaignConfig
from behavexplor.campaign.store import Store
from behavexplor.commands import main
from behavexplor.errors import InputError
from behavexplor.judge.fault import NPC_CAUSED, contact_fault
from behavexplor.triage.signatures import signature
from tests.confining import confines
from tests.drivers import Cruiser

ROOT = Path(__file__).parents[2]
TEXT = """
envs: [intersection-straight]
ads: ["tests.drivers:cruiser"]
methods:
  BehAVExplor: {config: paper}
  Uniform: {method: uniform}
seeds: 2
budget: BUDGET
baseline: Uniform
unconfined: true
"""
TIMES = ("executing_s", "analysing_s")


def write(folder, budget, text=TEXT):
    path = folder / "small.yaml"
    path.write_text(text.replace("BUDGET", str(budget)))
    return path


def start(*arguments):
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "behavexplor", "bench", "--unconfined", *map(str, arguments)]
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT, env=environment
    )


def run(*arguments):
    process = start(*arguments)
    out, err = process.communicate(timeout=120)
    return subprocess.CompletedProcess(arguments, process.returncode, out, err)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """An experiment that was run to its end without interruption."""
    folder = tmp_path_factory.mktemp("whole")
    result = run(write(folder, 20), "--out", folder / "out", "--jobs", 2)
    assert result.returncode == 0, result.stderr
    return folder, result


def summaries(root):
    """The rows of the campaigns, without what a clock has measured."""
    with (root / "summaries.csv").open() as file:
        return [{key: value for key, value in row.items() if key not in TIMES} for row in csv.DictReader(file)]


def records(root):
    found = {}
    for path in sorted(root.rglob("campaign.db")):
        store = Store.read(path.parent)
        found[str(path.parent.relative_to(root))] = [execution.record.to_json() for execution in store.executions()]
        store.close()
    return found


def test_every_cell_is_run_and_everything_is_written(whole):
    folder, result = whole
    rows = summaries(folder / "out")
    assert [(row["method"], row["seed"], row["executions"]) for row in rows] == [
        ("BehAVExplor", "1", "20"),
        ("Uniform", "1", "20"),
        ("BehAVExplor", "2", "20"),
        ("Uniform", "2", "20"),
    ]
    for row in rows:
        assert int(row["failed"]) == sum(int(row[f"failed_{label}"]) for label in ("R1", "R2", "R3", "error")) > 0
        assert int(row["R1_npc_caused"]) + int(row["R1_other"]) == int(row["failed_R1"])
        assert (row["r_BF"] != "") == (row["method"] == "BehAVExplor")
    assert "4 of 4 campaigns finished" in result.stdout
    assert "BehAVExplor against Uniform: not distinguishable in 1 of 1 scenarios." in result.stdout
    assert f"All tables: {folder / 'out' / 'tables.txt'}" in result.stdout
    assert max(map(len, result.stdout.replace(str(folder), "").splitlines())) <= 80
    assert f"Report: {folder / 'out' / 'report.html'}" in result.stdout
    assert "All 4 campaigns are finished." in (folder / "out" / "report.html").read_text()
    names = {path.name for path in (folder / "out" / "tables").iterdir()}
    assert {"violations.csv", "times.csv", "failures-behavexplor.csv", "times.md"} <= names


def test_a_summary_counts_what_is_in_the_run_folder(whole):
    folder, _ = whole
    row, *_ = summaries(folder / "out")
    lines = [
        json.loads(line)
        for line in records(folder / "out")["runs/intersection-straight/tests.drivers-cruiser/BehAVExplor/1"]
    ]
    assert int(row["failed"]) == sum(bool(line["violated"]) for line in lines)
    assert int(row["failed_R1"]) == sum(line["violated"][:1] == ["collision"] for line in lines)
    assert float(row["simulated_s"]) == pytest.approx(sum(line["duration"] for line in lines), abs=1e-3)
    for kind in ("waypoint", "route"):
        assert int(row[f"{kind}_mutations"]) == sum(line["origin"] == f"{kind}s" for line in lines)
    assert int(row["waypoint_mutations"]) + int(row["route_mutations"]) > 0
    assigned = {str([(npc["type"], npc["route"]) for npc in line["scenario"]["npcs"]]) for line in lines}
    assert int(row["assignments"]) == len(assigned)
    assert float(row["novelty_rate"]) == pytest.approx(sum(line["novel"] for line in lines) / 20, abs=1e-6)


def test_what_is_finished_is_not_run_again_and_tables_are_the_same_files(whole):
    folder, _ = whole
    out = folder / "out"
    before = {path: path.read_bytes() for path in out.rglob("*") if path.suffix in {".csv", ".md", ".txt", ".svg"}}
    times = {path: path.stat().st_mtime_ns for path in out.rglob("campaign.db")}
    for flag in ("--tables-only", "--quiet"):
        assert main(["bench", str(folder / "small.yaml"), "--unconfined", "--out", str(out), flag]) == 0
    assert {path: path.read_bytes() for path in before} == before
    assert {path: path.stat().st_mtime_ns for path in times} == times


def test_a_dry_run_checks_options(tmp_path, capsys):
    methods = "{A: {method: behavexplor, options: {keeep: 1}}}"
    (tmp_path / "one.yaml").write_text(f"name: one\nbudget: 5\nseeds: 1\nenvs: [lane-change]\nmethods: {methods}\n")
    assert main(["bench", str(tmp_path / "one.yaml"), "--dry-run"]) == 2
    assert "options of behavexplor 'keeep'" in capsys.readouterr().err


def test_a_dry_run_says_how_much_is_left_and_makes_nothing(whole, tmp_path, capsys):
    folder, _ = whole
    command = ["bench", str(folder / "small.yaml"), "--unconfined", "--dry-run", "--out"]
    assert main([*command, str(tmp_path / "new"), "--jobs", "2"]) == 0
    printed = capsys.readouterr().out
    assert "4 campaigns of 20 executions" in printed
    assert "0 finished; 80 executions left" in printed
    assert not (tmp_path / "new").exists()
    assert main(["status", str(folder / "out")]) == 2
    assert "name one that it holds, such as " in capsys.readouterr().err
    assert main([*command, str(folder / "out")]) == 0
    assert "4 finished; 0 executions left" in capsys.readouterr().out


def stored(root):
    """How many executions are on disk."""
    count = 0
    for path in root.rglob("campaign.db"):
        try:
            store = Store.read(path.parent)
        except InputError:  # it is being made right now
            continue
        count += len(store)
        store.close()
    return count


def wait_for(process, root, executions):
    deadline = time.monotonic() + 60
    while stored(root) < executions and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.1)


def test_an_interrupted_experiment_goes_on_to_the_same_results(whole, tmp_path):
    folder, _ = whole
    process = start(write(tmp_path, 20), "--out", tmp_path / "out", "--jobs", 2)
    wait_for(process, tmp_path / "out", 5)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert "Traceback" not in err
    assert "the same command continues" in err
    assert 5 <= stored(tmp_path / "out") < 80
    result = run(tmp_path / "small.yaml", "--out", tmp_path / "out", "--jobs", 1)
    assert result.returncode == 0, result.stderr
    assert records(tmp_path / "out") == records(folder / "out")
    assert summaries(tmp_path / "out") == summaries(folder / "out")


@pytest.mark.slow
def test_after_sigkill_no_campaign_is_left_running(tmp_path):
    process = start(write(tmp_path, 2000), "--out", tmp_path / "out", "--jobs", 2)
    wait_for(process, tmp_path / "out", 5)
    process.kill()
    process.communicate()
    deadline = time.monotonic() + 60
    counts = [-1, stored(tmp_path / "out")]
    while counts[-1] != counts[-2] and time.monotonic() < deadline:
        time.sleep(2)
        counts.append(stored(tmp_path / "out"))
    assert counts[-1] == counts[-2] < 8000


class Diarist(Cruiser):
    """Keeps a diary where it should not."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        Path(os.environ["DIARY"]).write_text("x")
        return super().predict(observation, state)


@pytest.mark.skipif(not confines(), reason="this system cannot confine a process")
@pytest.mark.parametrize("unconfined", [False, True])
def test_a_third_partys_driver_is_confined_even_where_a_campaign_has_no_workers(unconfined, tmp_path, monkeypatch):
    monkeypatch.setenv("DIARY", str(tmp_path / "diary"))
    config = CampaignConfig(
        env="lane-follow", ads=f"{__name__}:Diarist", method="uniform", budget="2", unconfined=unconfined
    )
    outcome = CampaignService().run_in(config, tmp_path / "run", 0)
    assert outcome.finished
    assert any("--unconfined" in warning for warning in outcome.warnings) != unconfined
    assert (tmp_path / "diary").exists() == unconfined
    experiment = experiment_config({"name": "x", "methods": {"a": {"method": "uniform"}}, "unconfined": unconfined})
    assert {run.config.unconfined for run in experiment.runs()} == {unconfined}


def test_a_campaign_that_fails_is_named_and_the_others_go_on(tmp_path):
    text = TEXT.replace('"tests.drivers:cruiser"', '"tests.drivers:cruiser", "tests.drivers:Crashing"')
    path = write(tmp_path, 3, text.replace("seeds: 2", "seeds: 1").replace("  BehAVExplor: {config: paper}\n", ""))
    result = run(path, "--out", tmp_path / "out", "--jobs", 2)
    assert result.returncode == 3
    assert "Uniform on intersection-straight with tests.drivers:Crashing, seed 1: " in result.stderr
    assert "1 of 2 campaigns finished" in result.stdout
    assert {row["ads"] for row in summaries(tmp_path / "out")} == {"tests.drivers:cruiser"}


def test_another_campaign_in_a_cell_is_not_mixed_in(whole, capsys):
    folder, _ = whole
    (folder / "other.yaml").write_text((folder / "small.yaml").read_text() + "batch: 3\n")
    experiment = read_experiment(str(folder / "other.yaml"))
    with pytest.raises(InputError, match="holds a campaign with a different configuration"):
        ExperimentRunner(experiment.runs(), folder / "out", 1, 0)
    smaller = read_experiment(str(write(folder / "out", 10)))
    with pytest.raises(InputError, match="has 20 executions, more than the budget 10"):
        run_state(smaller.runs()[0], folder / "out")


def test_a_search_that_ends_early_has_finished(tmp_path):
    text = TEXT.replace("config: paper", "method: tests.bench.methods:Brief").replace(
        "  Uniform: {method: uniform}\n", ""
    )
    experiment = read_experiment(str(write(tmp_path, 20, text.replace("baseline: Uniform\n", ""))))
    first, other = experiment.runs()
    folder = tmp_path / first.folder
    assert CampaignService().run_in(first.config, folder, 0) == Outcome(finished=True)
    store = Store.read(folder)
    assert store.ended == "Five are enough."
    assert len(store) == 5
    store.close()
    assert run_state(first, tmp_path) == RunState(5, finished=True)
    assert run_state(other, tmp_path) == RunState(0, finished=False)
    assert ExperimentRunner([first], tmp_path, 1, 0).run(lambda _: None).finished == 1


def test_a_campaign_told_to_stop_before_it_began_does_nothing_and_is_not_finished(tmp_path):
    planned, *_ = read_experiment(str(write(tmp_path, 20))).runs()
    service = CampaignService()
    service.stop()
    assert service.run_in(planned.config, tmp_path / planned.folder, 0) == Outcome(finished=False)
    assert run_state(planned, tmp_path) == RunState(0, finished=False)


def test_a_campaign_without_this_folder_is_sent_back_and_goes_on_elsewhere(whole, tmp_path):
    """As on a cluster: what is there goes out, what came of it comes back."""
    planned, *_ = read_experiment(str(write(tmp_path, 20))).runs()
    short = replace(planned.config, budget="8")
    folder = tmp_path / planned.folder
    for config in (short, planned.config):
        answer = CampaignService().run(campaign_request(config, folder, 0, remote=True))
        assert take_outcome(answer, folder) == Outcome(finished=True)
    assert run_state(planned, tmp_path) == RunState(20, finished=True)
    name = str(planned.folder)
    assert records(tmp_path)[name] == records(whole[0] / "out")[name]


def test_classes_and_faults_of_failures_are_those_of_the_records(whole):
    root = whole[0] / "out"
    run, *_ = read_experiment(str(whole[0] / "small.yaml")).runs()
    summary = summarize(run, root)
    assert summary.failures
    assert all(kind.startswith(("R1/", "R2/", "R3/")) for kind in summary.kinds())
    store = Store.read(root / run.folder)
    faults = [contact_fault(store.execution(failure.number).load_trace()) for failure in summary.failures]
    store.close()
    assert [failure.npc_caused for failure in summary.failures] == [fault in NPC_CAUSED for fault in faults]


def test_signatures_are_of_drivers_with_the_planners_log_alone(whole, tmp_path):
    (cruiser, *_) = read_experiment(str(whole[0] / "small.yaml")).runs()
    assert {failure.signature for failure in summarize(cruiser, whole[0] / "out").failures} == {None}
    text = TEXT.replace("tests.drivers:cruiser", "rule")
    (run, *_) = read_experiment(str(write(tmp_path, 30, text))).runs()
    assert CampaignService().run_in(run.config, tmp_path / run.folder, 0).finished
    summary = summarize(run, tmp_path)
    store = Store.read(tmp_path / run.folder)
    failed = [store.execution(failure.number) for failure in summary.failures]
    store.close()
    expected = [signature(execution.load_trace(), execution.record.violated) for execution in failed]
    assert [failure.signature for failure in summary.failures] == [found or "unexplained" for found in expected]
    assert summary.weaknesses()
    assert summary.weaknesses() <= set(WEAKNESSES)
