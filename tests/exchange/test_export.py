"""The files of `export`: those that are there are kept."""

import pytest

from behavexplor.campaign.store import Store
from behavexplor.commands import EXECUTION_FAILED, main


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run whose driver fails at once in every execution."""
    folder = tmp_path_factory.mktemp("exchange") / "run"
    flags = ["--env", "lane-change", "--ads", "tests.exchange.test_export:Absent", "--budget", "2", "--workers", "0"]
    assert main(["fuzz", *flags, "--quiet", "--unconfined", "--out", str(folder)]) == EXECUTION_FAILED
    return folder


class Absent:
    """A driver that raises at its first decision."""

    vectorized = True

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        raise RuntimeError("nobody is there")


@pytest.mark.parametrize(("flags", "suffix"), [([], "xosc"), (["--format", "csv"], "csv")])
def test_files_that_are_there_are_kept(run, tmp_path, flags, suffix, capsys):
    out, edited = tmp_path / "out", tmp_path / "out" / f"000001.{suffix}"
    export = ["export", str(run), "--out", str(out), *flags]
    assert main([*export, "1"]) == 0
    written = edited.read_bytes()
    assert main([*export, "1"]) == 0  # the same again
    edited.write_text("mine")
    before = sorted(out.iterdir())
    assert main([*export, "0", "1"]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert f"000001.{suffix} is kept, and another file would take its place" in said
    assert edited.read_text() == "mine"
    assert sorted(out.iterdir()) == before
    assert main(["export", str(run), "--out", str(tmp_path / "other"), *flags]) == 0
    assert (tmp_path / "other" / edited.name).read_bytes() == written


def test_a_scene_without_motion_says_so(run, tmp_path, capsys):
    assert main(["export", str(run), "1", "--out", str(tmp_path)]) == 0
    said = "ended in the first frame: nothing moves as recorded until the time limit of 200 s"
    assert f"1 of these {said}" in " ".join(capsys.readouterr().out.split())
    assert f"it {said}" in (tmp_path / "000001.xosc").read_text()


def test_a_run_without_executions_has_none(tmp_path, capsys):
    Store.create(tmp_path / "run", "env: lane-change\n").close()
    assert main(["export", str(tmp_path / "run"), "0", "--out", str(tmp_path / "out")]) == 2
    assert "has no execution 0: it has none" in " ".join(capsys.readouterr().err.split())
