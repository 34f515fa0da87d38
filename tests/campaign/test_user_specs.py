"""Requirements of a user's own, from a file outside the package, through everything that a campaign goes through."""

import csv
import json
import os
import signal
import subprocess
import sys
import textwrap
import time

import pytest

from behavexplor.campaign.config import stored_config
from behavexplor.campaign.store import Store
from behavexplor.commands import BAD_INPUT, OK, main
from behavexplor.errors import InputError
from behavexplor.report import drawing

SPECS = """
    import numpy as np
    from behavexplor.judge.signals import speed
    from behavexplor.judge.stl import Signal, always

    def keeps_below_9(trace):
        return always(Signal(trace.time, 9.0 - speed(trace)))

    class Brisk:
        name = "brisk-drive"

        def __call__(self, trace):
            return trace.duration and float(speed(trace).max()) - 1.0

    def raising(trace):
        return 1 / 0

    def vague(trace):
        return float("nan") if len(trace.time) > 1 else 1.0

    def wordy(trace):
        return "far away"

    class Taken(Brisk):
        name = "collision"
"""
CAMPAIGN = ["--env", "lane-follow", "--ads", "constant:1", "--seed", "3"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("user")
    (folder / "own_specs.py").write_text(textwrap.dedent(SPECS))
    return folder


@pytest.fixture(autouse=True)
def at_home(folder, monkeypatch):
    """In the folder of the user's file."""
    monkeypatch.chdir(folder)
    monkeypatch.syspath_prepend(str(folder))


def fuzz(out, *flags, budget="40", workers="2"):
    run = [*CAMPAIGN, "--budget", budget, "--workers", workers, "--quiet", "--out", str(out)]
    return main(["fuzz", *run, "--spec", "own_specs:keeps_below_9", *flags])


def records(run):
    store = Store.read(run)
    found = [record.to_dict() for record in store.records()]
    store.close()
    return found


@pytest.fixture(scope="module")
def run(folder, tmp_path_factory):
    """A run of a driver that sees nothing, judged by R1, R2, R3 and a user's spec."""
    out = tmp_path_factory.mktemp("runs") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.syspath_prepend(str(folder))
        assert fuzz(out) == OK
    return out


def test_it_is_scored_and_counted_in_classes_of_its_name(run):
    found = records(run)
    assert all(list(record["degrees"]) == ["collision", "lines", "destination", "keeps_below_9"] for record in found)
    own = [record for record in found if record["violated"][:1] == ["keeps_below_9"]]
    assert own
    assert all(record["class"].startswith("keeps_below_9/") and "fault" not in record for record in own)
    assert all(record["degrees"]["keeps_below_9"] == 0.0 for record in own)
    assert stored_config(run).unverified.specs == ("own_specs:keeps_below_9",)


def test_the_summary_the_replay_triage_and_the_report_show_it(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(drawing, "MAX_FRAMES", 2)
    run = tmp_path / "run"
    assert fuzz(run, budget="12", workers="0") == OK
    capsys.readouterr()
    first = next(record["id"] for record in records(run) if record["violated"][:1] == ["keeps_below_9"])
    assert main(["fuzz", "--resume", str(run), "--workers", "0", "--quiet"]) == OK
    assert "  keeps_below_9 " in capsys.readouterr().out
    assert main(["replay", str(run), str(first), "--out", str(tmp_path)]) == OK
    assert "failed (keeps_below_9), ended by" in capsys.readouterr().out
    assert main(["triage", str(run), "--workers", "0", "--quiet"]) == OK
    assert "keeps_below_9/" in capsys.readouterr().out
    assert main(["report", str(run), "--out", str(tmp_path / "page.html")]) == OK
    page = (tmp_path / "page.html").read_text()
    assert "keeps_below_9/" in page
    assert "Violated keeps_below_9" in page


def test_a_campaign_that_was_killed_goes_on_to_the_same_records(run, folder, tmp_path):
    out = tmp_path / "killed"
    command = [sys.executable, "-m", "behavexplor", "fuzz", *CAMPAIGN, "--budget", "40", "--workers", "2", "--quiet"]
    process = subprocess.Popen(
        [*command, "--out", str(out), "--spec", "own_specs:keeps_below_9"],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        stdout=subprocess.DEVNULL,
        cwd=folder,
    )
    deadline = time.monotonic() + 120
    while not count(out) and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert main(["fuzz", "--resume", str(out), "--workers", "1", "--quiet"]) == OK
    assert records(out) == records(run)


def count(run):
    try:
        return len(records(run))
    except InputError:  # it has not begun yet
        return 0


@pytest.mark.parametrize("method", ["behavexplor", "random", "avfuzzer", "samota", "uniform", "nsga2", "map-elites"])
def test_every_search_method_is_told_its_degree(method, tmp_path):
    pytest.importorskip({"nsga2": "pymoo", "map-elites": "ribs"}.get(method, "numpy"))
    options = {"restart_samples": 50} if method == "avfuzzer" else {}
    (tmp_path / "config.yaml").write_text(json.dumps({"method": method, "options": options}))
    assert fuzz(tmp_path / "run", "--config", str(tmp_path / "config.yaml"), workers="0", budget="45") == OK
    found = records(tmp_path / "run")
    assert all("keeps_below_9" in record["degrees"] for record in found)
    if method in {"nsga2", "samota"}:
        assert {len(record["search"]["objectives"]) for record in found} == {4}


def test_a_policy_is_judged_by_it_too(tmp_path):
    pytest.importorskip("stable_baselines3")
    from tests.ads.sb3.models import BOX, META, make_model  # noqa: PLC0415 - needs torch

    make_model("DQN", BOX, META).save(tmp_path / "model.zip")
    (tmp_path / "model.yaml").write_text(
        json.dumps(
            {
                "observation": {"type": "Kinematics", "vehicles_count": 7},
                "action": {"type": "DiscreteMetaAction"},
                "policy_frequency": 1,
            }
        )
    )
    flags = ["--env", "lane-follow", "--ads", str(tmp_path / "model.zip"), "--spec", "own_specs:Brisk"]
    assert main(["fuzz", *flags, "--budget", "6", "--workers", "1", "--quiet", "--out", str(tmp_path / "run")]) == OK
    assert all("brisk-drive" in record["degrees"] for record in records(tmp_path / "run"))


def test_the_tables_of_an_experiment_have_a_column_for_it(tmp_path, capsys):
    experiment = {
        "envs": ["lane-follow"],
        "ads": ["constant:1"],
        "methods": {"Uniform": {"method": "uniform"}},
        "seeds": 2,
        "budget": 15,
        "specs": ["own_specs:keeps_below_9"],
    }
    (tmp_path / "own.yaml").write_text(json.dumps(experiment))
    assert main(["bench", str(tmp_path / "own.yaml"), "--out", str(tmp_path / "out"), "--jobs", "1", "--quiet"]) == OK
    assert "All tables" in capsys.readouterr().out
    assert "keeps_below_9" in (tmp_path / "out" / "tables.txt").read_text()
    with (tmp_path / "out" / "summaries.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert sum(int(row["failed_keeps_below_9"]) for row in rows) > 0
    assert all(
        int(row["failed"]) == sum(int(row[f"failed_{label}"]) for label in ("R1", "R2", "R3", "keeps_below_9", "error"))
        for row in rows
    )
    assert "keeps_below_9" in (tmp_path / "out" / "report.html").read_text()


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("raising", "The spec 'raising' (own_specs:raising) raised ZeroDivisionError: division by zero (own_specs.py"),
        ("vague", "The spec 'vague' (own_specs:vague) returned nan: it must return a number"),
        ("wordy", "returned 'far away': it must return a number, negative if the trace violates the requirement"),
        ("Taken", "cannot be named 'collision'"),
        ("nothing", "cannot be imported: AttributeError"),
    ],
)
def test_a_spec_that_cannot_be_used_is_one_sentence_and_nothing_is_lost(name, message, tmp_path, capsys):
    flags = ["--budget", "5", "--workers", "0", "--quiet", "--out", str(tmp_path / "run")]
    assert main(["fuzz", *CAMPAIGN, *flags, "--spec", f"own_specs:{name}"]) == BAD_INPUT
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert message in error
    if name in {"raising", "vague", "wordy"}:
        assert "in execution 0 of" in error
        assert "fuzz --resume" in error


@pytest.mark.parametrize("flag", ["own_specs", ":keeps_below_9", "own_specs:"])
def test_a_name_without_module_or_attribute_is_refused(flag, capsys):
    assert main(["fuzz", *CAMPAIGN, "--spec", flag]) == BAD_INPUT
    assert "must be written as package.module:attribute" in capsys.readouterr().err


def test_specs_are_not_changed_on_resume(run, capsys):
    assert main(["fuzz", "--resume", str(run), "--spec", "own_specs:Brisk"]) == BAD_INPUT
    assert "cannot be given with --resume" in capsys.readouterr().err
