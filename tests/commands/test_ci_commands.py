"""What continuous integration and a waiting user ask: thresholds, known classes, summaries, the state of a run."""

import importlib
import json
import subprocess
import sys
from types import SimpleNamespace

import gymnasium
import pytest

from behavexplor.campaign.store import Store
from behavexplor.commands import EXECUTION_FAILED, OK, main
from behavexplor.envs import making

FUZZ = ["fuzz", "--workers", "0", "--unconfined", "--method", "uniform", "--seed", "5"]
SEARCH = [*FUZZ, "--ads", "tests.drivers:cruiser", "--quiet", "--budget", "12"]


def raising(observation):
    raise ZeroDivisionError("no gap to divide by")


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A run, and its summary."""
    folder = tmp_path_factory.mktemp("ci")
    assert main([*SEARCH, "--out", str(folder / "run"), "--json", str(folder / "summary.json")]) == 0
    return folder / "run", json.loads((folder / "summary.json").read_text())


def test_a_budget_in_which_nothing_was_driven_is_no_check_that_passes(tmp_path, capsys):
    arguments = [*FUZZ, "--ads", "tests.drivers:cruiser", "--quiet", "--budget", "0.0001s", "--fail-above", "0"]
    assert main([*arguments, "--out", str(tmp_path / "run")]) == EXECUTION_FAILED
    assert "Nothing was driven within a budget of 0.0001s" in capsys.readouterr().err


def test_a_summary_is_written_as_json(finished):
    folder, summary = finished
    store = Store.read(folder)
    records = list(store.records())
    store.close()
    failed = [record for record in records if record.failed]
    assert summary["executions"] == 12
    assert summary["failed"] == len(failed) == sum(one["count"] for one in summary["classes"])
    assert summary["failure_rate"] == len(failed) / 12
    assert summary["at_fault"] == sum(record.at_fault for record in failed)
    assert summary["new_classes"] == [one["id"] for one in summary["classes"]]
    assert summary["complete"]
    assert summary["run"] == str(folder)


def test_only_classes_that_are_not_known_fail_a_check(finished, tmp_path, capsys):
    folder, summary = finished
    (tmp_path / "known.txt").write_text("\n".join(["# accepted", *summary["new_classes"][1:]]))
    (tmp_path / "all.json").write_text(json.dumps(summary))
    resumed = ["fuzz", "--resume", str(folder), "--workers", "0", "--quiet", "--fail-on-violation"]
    assert main([*resumed, "--known-classes", str(tmp_path / "known.txt"), "--json", str(tmp_path / "s.json")]) == 1
    assert "in 1 class that are not known" in capsys.readouterr().err
    assert json.loads((tmp_path / "s.json").read_text())["new_classes"] == summary["new_classes"][:1]
    assert main([*resumed, "--known-classes", str(tmp_path / "all.json")]) == 0
    assert main([*resumed, "--known-classes", str(tmp_path / "none.txt")]) == 2
    assert "none.txt cannot be read: No such file or directory" in capsys.readouterr().err
    for other in ('{"failed": 3}', '["no/class"]', '{"classes": ["no/class"]}', "{", "[" * 100_000):
        (tmp_path / "other.json").write_text(other)
        assert main([*resumed, "--known-classes", str(tmp_path / "other.json")]) == 2
        said = " ".join(capsys.readouterr().err.split())
        assert said.endswith("neither a list of classes, one in each line, nor a summary that --json has written")


def test_a_share_of_failures_above_the_threshold_fails_a_check(finished, capsys):
    folder, summary = finished
    resumed = ["fuzz", "--resume", str(folder), "--workers", "0", "--quiet"]
    assert main([*resumed, "--fail-above", str(summary["failure_rate"])]) == 0
    assert main([*resumed, "--fail-above", str(summary["failure_rate"] - 0.01)]) == 1
    assert f"({summary['failure_rate']:.1%}) failed" in capsys.readouterr().err
    assert main([*resumed, "--fail-above", "1.5"]) == 2


def test_a_search_stops_after_enough_failures(tmp_path, capsys):
    assert main([*SEARCH, "--stop-after", "1", "--out", str(tmp_path / "a")]) == 0
    printed = capsys.readouterr()
    assert "1 failed" in printed.out
    assert "Stopped after 1 failure" in printed.err
    assert main([*SEARCH, "--stop-after", "0", "--out", str(tmp_path / "b")]) == 2


def test_the_status_of_a_run_is_told_while_it_is_written(finished, capsys):
    folder, summary = finished
    assert main(["status", str(folder)]) == 0
    text = capsys.readouterr().out
    assert "complete, last written" in " ".join(text.split())
    assert f"{summary['failed']} failed" in text
    assert " ".join(summary["classes"][0]["words"].split()[:3]) in text
    store = Store.reopen(folder)
    try:
        assert main(["status", str(folder), "--json", "-"]) == 0
        found = json.loads(capsys.readouterr().out)
        assert found["running"]
        assert found["executions"] == 12
    finally:
        store.close()
    assert main(["status", str(folder.parent)]) == 2


def test_environments_are_listed(capsys):
    assert main(["envs"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert {"  intersection-straight", "  highway-fast-v0", "  parking-v0"} <= set(lines)


def test_a_package_can_declare_its_environments(monkeypatch, capsys):
    entry = SimpleNamespace(name="declared", module="tests.declared_environments")

    def declared(group, name=None):
        return [entry] if group == making.ENTRY_POINTS and name in (None, "declared") else []

    monkeypatch.setattr(making, "entry_points", declared)
    monkeypatch.setattr("behavexplor.commands.envs.entry_points", declared)
    try:
        assert making.environment_id("declared/lane-change-v0") == "declared/lane-change-v0"
        assert not making.is_highway("declared/lane-change-v0")
        assert main(["envs"]) == 0
        assert "Of installed packages:\n  declared/lane-change-v0" in capsys.readouterr().out
    finally:
        gymnasium.registry.pop("declared/lane-change-v0", None)


def test_an_environment_of_another_package_needs_its_module(capsys):
    assert main(["fuzz", "--env", "nowhere/two-lane-v0", "--workers", "0"]) == 2
    assert "name the module that does, as in module:nowhere/two-lane-v0" in capsys.readouterr().err


def test_gymnasium_makes_an_environment_without_an_import():
    """Gymnasium 1.0 has removed its plugins; an id with its module does the same."""
    code = "import gymnasium; print(gymnasium.make('behavexplor:behavexplor/lane-change-v0').spec.id)"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "behavexplor/lane-change-v0"


@pytest.mark.slow
@pytest.mark.parametrize("failing", ["fuzz", "report"])
def test_a_demo_ends_where_one_of_its_commands_fails(tmp_path, monkeypatch, failing):
    def train(folder, *_):
        return folder / "model.zip"

    module = importlib.import_module("behavexplor.commands.demo")
    monkeypatch.setattr("behavexplor.sb3.small_policy.train_small_policy", train)
    monkeypatch.setattr(module, "main", lambda words: 3 if words[0] == failing else OK)
    monkeypatch.setattr("webbrowser.open", pytest.fail)
    assert main(["demo", "--out", str(tmp_path / "d")]) == 3


def test_the_demo_trains_fuzzes_and_reports(tmp_path, capsys):
    assert main(["demo", "--out", str(tmp_path / "d"), "--no-browser", "--budget", "2", "--steps", "1024"]) == 0
    text = capsys.readouterr().out
    assert " fuzz --ads " in text
    assert "2 executions in" in text
    assert (tmp_path / "d" / "run" / "report.html").is_file()
    assert main(["demo", "--out", str(tmp_path / "d")]) == 2


def test_a_driver_that_never_drives_is_said_to(tmp_path, capsys):
    arguments = [*FUZZ, "--ads", "tests.commands.test_ci_commands:raising", "--budget", "2", "--out"]
    assert main([*arguments, str(tmp_path / "a"), "--quiet"]) == 3
    printed = capsys.readouterr()
    said = "The driver itself failed in every execution, first in 0: ZeroDivisionError: no gap"
    assert said in " ".join(printed.out.split())
    assert "failed in every execution, so nothing was tested" in printed.err
    assert main([*arguments, str(tmp_path / "b")]) == 3
    assert "no gap to divide by (test_ci_commands.py, line " in capsys.readouterr().err
