"""The driver of a run is found from any folder, and another one in its place is named."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from behavexplor.campaign.identity import Identity, changes
from behavexplor.commands import BAD_INPUT, CHECK_FAILED, OK, main

POLICIES = Path("docs/data/policies").resolve()


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A working directory with a policy and a run of it, which was given by a relative path."""
    for name in ("merge.zip", "merge.yaml"):
        shutil.copy(POLICIES / name, tmp_path / name)
    monkeypatch.chdir(tmp_path)
    command = ["fuzz", "--env", "merge-v0", "--ads", "merge.zip", "--budget", "16", "--out", "run", "--quiet"]
    assert main([*command, "--workers", "0", "--unconfined"]) == OK
    return tmp_path


def replay():
    return main(["replay", "run", "0", "--unconfined", "--out", "pictures"])


@pytest.mark.filterwarnings("default:The driver or other code is not")
def test_an_overwritten_policy_is_named(place, capsys):
    shutil.copy(POLICIES / "intersection.zip", place / "merge.zip")
    assert main(["fuzz", "--resume", "run", "--budget", "20", "--workers", "0", "--unconfined"]) == BAD_INPUT
    assert "other code of its campaign has changed: merge.zip (SHA-256" in capsys.readouterr().err
    shutil.copy(POLICIES / "highway-fast.zip", place / "merge.zip")
    assert replay() == CHECK_FAILED
    err = capsys.readouterr().err
    assert err.startswith("Warning: The driver or other code is not that with which run began: merge.zip (SHA-256")
    assert "_cli.py" not in err


def test_settings_that_came_beside_a_policy_are_named(place, capsys):
    (place / "merge.yaml").unlink()
    assert main(["fuzz", "--resume", "run", "--budget", "20", "--workers", "0", "--unconfined"]) == BAD_INPUT
    assert "merge.yaml (SHA-256" in (err := capsys.readouterr().err)
    assert "now no such file)" in err


def test_a_policy_is_found_from_another_folder_and_named_when_gone(place, capsys, monkeypatch):
    (place / "other").mkdir()
    monkeypatch.chdir(place / "other")
    shutil.move(place / "run", "run")
    assert replay() == OK
    assert "began" not in capsys.readouterr().err
    (place / "merge.zip").unlink()
    assert replay() == BAD_INPUT
    assert f"neither here nor in {place}, where the run began" in capsys.readouterr().err


def test_an_edited_module_is_named(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("edited.py").write_text("def drive(observation):\n    return 3\n")
    command = [sys.executable, "-m", "behavexplor"]
    environment = {**os.environ, "PYTHONPATH": str(POLICIES.parents[2]), "XDG_STATE_HOME": str(tmp_path / "state")}
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    flags = ["--env", "merge-v0", "--ads", "edited:drive", "--budget", "4", "--out", "run", "--no-confirm", "--quiet"]
    subprocess.run([*command, "fuzz", *flags, "--workers", "1"], check=True, env=environment)
    Path("edited.py").write_text("def drive(observation):\n    return 4\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert main(["fuzz", "--resume", "run", "--budget", "8", "--workers", "1"]) == BAD_INPUT
    assert "other code of its campaign has changed: module edited (SHA-256" in capsys.readouterr().err
    assert main(["replay", "run", "0"]) == BAD_INPUT
    err = capsys.readouterr().err
    assert "if you trust it, add --trust sha256:" in err
    assert "Changed since the run began: module edited (SHA-256" in err


@pytest.mark.filterwarnings("default:The driver or other code is not")
def test_a_suite_finds_its_policy_from_any_folder_and_names_another(place, capsys, monkeypatch):
    assert main(["suite", "run", "--out", "tests/suite", "--workers", "0", "--unconfined", "--quiet"]) == OK
    assert "driver: ../../merge.zip" in (place / "tests/suite/suite.yaml").read_text()
    monkeypatch.chdir(place / "tests")
    check = ["check", "suite", "--workers", "0", "--unconfined"]
    assert main(check) == CHECK_FAILED
    assert "Warning" not in capsys.readouterr().err
    shutil.copy(POLICIES / "highway-fast.zip", place / "merge.zip")
    main(check)
    assert "The driver is not the one that failed in the suite: merge.zip (SHA-256" in capsys.readouterr().err


def test_the_summary_has_the_digests_and_versions(place, capsys):
    assert main(["status", "run", "--json", "-"]) == OK
    found = json.loads(capsys.readouterr().out)
    assert set(found["digests"]) == {"merge.zip", "merge.yaml"}
    assert "highway-env" in found["libraries"]


def test_an_identity_that_cannot_be_read_is_not_known():
    assert Identity.from_json(Identity({"a": "b"}, {"numpy": "2"}, "/x").to_json().encode()) is not None
    for text in (b"", b"{", b"[]", b'{"digests": 1, "libraries": {}, "folder": ""}'):
        assert Identity.from_json(text) is None


def test_changes_name_what_has_gone_come_or_changed():
    assert changes({"a": "1" * 64}, {"a": "1" * 64}) == ""
    said = changes({"a": "1" * 64, "b": "2" * 64}, {"b": "3" * 64, "c": "4" * 64})
    assert said == (
        "a (SHA-256 111111111111..., now no such file) and b (SHA-256 222222222222..., now SHA-256 333333333333...) "
        "and c (no such file, now SHA-256 444444444444...)"
    )


def test_modules_are_no_policies_that_could_have_gone(tmp_path, monkeypatch):
    (tmp_path / "judges.py").write_text("def calm(trace):\n    return 1.0\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    run = ["--ads", "idm", "--spec", "judges:calm", "--budget", "2", "--out", "run", "--quiet", "--workers", "0"]
    assert main(["fuzz", "--env", "S3", *run]) == OK
    assert main(["replay", "run", "0"]) == OK
