"""What commands say of stored runs, without driving anything."""

import io
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from behavexplor.campaign.config import Budget, CampaignConfig
from behavexplor.campaign.progress import Progress
from behavexplor.campaign.store import Store
from behavexplor.commands import BAD_INPUT, INTERRUPTED, OK, fuzz, main, replay
from behavexplor.commands.checks import Checks
from behavexplor.commands.display import Display
from behavexplor.data.durable import write_durably
from behavexplor.data.road_shape import RoadShape
from tests.campaign.test_store import execution, filled, store  # noqa: F401 - a fixture


def ended(store, reason=None, **campaign):  # noqa: F811 - the fixture
    """What fuzzing says at the end of a campaign: its exit code and its notes."""
    stream = io.StringIO()
    campaign = SimpleNamespace(**{"run": lambda _: reason, "stopping": False, **campaign})
    return fuzz._run(campaign, store, Display(stream, Budget(executions=9), quiet=False)), stream.getvalue()


def test_only_a_used_budget_completes_a_run(store):  # noqa: F811
    progress = Progress(executions=3, resumed=3)
    assert "already complete" in ended(filled(store), progress=progress)[1]
    code, said = ended(store, "Stopped after 2 failures, as asked for", progress=progress)
    assert code == OK
    assert "already complete" not in said


def test_an_interruption_of_the_resumption_does_not_hide_stored_failures(store, capsys):  # noqa: F811
    store.add(execution(0))
    store.add(execution(1, ("lines",), "R2/a"))
    store.commit()
    assert ended(store, progress=Progress(executions=1, resumed=1), stopping=True)[0] == INTERRUPTED
    assert "None failed" not in capsys.readouterr().out


def test_a_failure_that_highway_env_does_not_confirm_is_not_the_drivers(tmp_path, capsys):
    run, failing = Store.create(tmp_path / "run", CampaignConfig().to_yaml()), Progress(violations={"error": 1})
    run.add(execution(0, ("error",), "error/differs"))
    run.commit()
    assert fuzz._checked(OK, failing, run.folder, Checks(), None) == OK
    run.add(execution(0, ("error",), "error/raised"))
    run.commit()
    run.close()
    assert capsys.readouterr().err == ""
    assert fuzz._checked(OK, failing, run.folder, Checks(), None) != OK


def test_an_execution_on_an_unknown_road_is_drawn(monkeypatch, tmp_path):
    drawn = []
    monkeypatch.setattr(replay, "_draw", lambda *given: drawn.append(given))
    replay._show(execution(0), RoadShape(()), tmp_path)  # as of an environment of another package
    assert len(drawn) == 1


def test_a_table_has_no_choices(tmp_path, capsys):
    for flags in (["--ego", "free"], ["--npcs", "routes"]):
        assert main(["export", str(tmp_path), "--out", str(tmp_path), "--format", "csv", *flags]) == BAD_INPUT
        assert "cannot be given with --format csv" in capsys.readouterr().err


@pytest.mark.parametrize("folder", [".", "reports"])
def test_a_folder_is_no_file(folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "reports").mkdir()
    with pytest.raises(IsADirectoryError):
        write_durably(Path(folder), "")
    assert [path.name for path in tmp_path.iterdir()] == ["reports"]


def test_the_command_for_a_written_model_can_be_copied(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "behavexplor.training", SimpleNamespace(write_model=lambda *_: None))
    path = tmp_path / "my models" / "a.zip"
    assert main(["zip", "learned:lane-change", "--out", str(path)]) == OK
    assert f"--ads '{path}'" in capsys.readouterr().out
