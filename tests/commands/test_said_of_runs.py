"""What commands say of stored runs, without driving anything."""

import io
import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from behavexplor.campaign.config import Budget, CampaignConfig
from behavexplor.campaign.progress import Progress
from behavexplor.campaign.store import Store
from behavexplor.commands import BAD_INPUT, INTERRUPTED, OK, fuzz, main
from behavexplor.commands import replay as replaying
from behavexplor.commands.display import Display, Meter
from behavexplor.commands.fuzz import Checks
from behavexplor.commands.rate_table import rates_table as table
from behavexplor.data.durable import write_durably
from behavexplor.data.road_shape import RoadShape
from behavexplor.evaluation import Evaluation
from tests.campaign.test_store import execution, filled, store  # noqa: F401 - a fixture


def ended(store, reason=None, **campaign):  # noqa: F811 - the fixture
    """What fuzzing says at the end of a campaign: its exit code and its notes."""
    stream = io.StringIO()
    campaign = SimpleNamespace(
        **{"run": lambda _: reason, "drive_uniformly": lambda: None, "unconfirmed": [], "stopping": False, **campaign}
    )
    return fuzz._run(
        campaign, store, Display(stream, Budget(executions=9), quiet=False), "nsga2", sys.stdout
    ), stream.getvalue()


def test_the_same_driver_below_the_home_folder_resumes_a_run(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    stored = CampaignConfig(ads=str(tmp_path / "p.zip"))
    Store.create(tmp_path / "run", stored.to_yaml()).close()
    monkeypatch.setattr(fuzz, "accepted_run", lambda *_, **__: stored)
    assert fuzz._resumed_config(tmp_path / "run", {"ads": "~/p.zip"}) == stored


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


def test_a_driver_that_fails_in_every_execution_was_not_tested(tmp_path):
    run, failing = Store.create(tmp_path / "run", CampaignConfig().to_yaml()), Progress(violations={"error": 1})
    run.add(execution(0, ("error",), "error/raised"))
    run.commit()
    run.close()
    assert fuzz._checked(OK, failing, run.folder, Checks(), fuzz.Output()) != OK


def test_an_execution_on_an_unknown_road_is_drawn(monkeypatch, tmp_path):
    drawn = []
    monkeypatch.setattr(replaying, "_draw", lambda *given: drawn.append(given))
    replaying._show(execution(0), RoadShape(()), tmp_path, None)  # as of an environment of another package
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


HOSTILE = "\x1b]52;c;aGk=\x07\u202e[bold]:smile:\x9b2J"
SHOWN = r"\x1b]52;c;aGk=\x07\u202e[bold]:smile:\x9b2J"


def is_clean(text):
    return all(char.isprintable() or char in "\n\t" for char in text)


def hostile_run(folder):
    """A run in which every text that a command may print would command the terminal."""
    config = CampaignConfig().to_yaml()
    store = Store.create(folder, config.replace("ads: rule:hardened", json.dumps({"ads": HOSTILE})[1:-1]))  # noqa: F811
    for number, spec in enumerate((HOSTILE, "error", "collision")):
        found = execution(number, (spec,), f"{HOSTILE}/{number}")
        failure = {"kind": HOSTILE, "message": HOSTILE * 3} if spec == "error" else None
        store.add(replace(found, record=replace(found.record, error=failure, degrees={HOSTILE: 0.0})))
    store.commit()
    store.close()
    return folder


@pytest.mark.parametrize("command", ["status", "records", "report", "triage", "replay"])
def test_no_text_of_a_run_commands_the_terminal(tmp_path, capsys, command):
    run = hostile_run(tmp_path / "run")
    main([command, str(run), *(["1"] if command == "replay" else [])])
    printed = capsys.readouterr()
    assert is_clean(printed.out + printed.err)
    assert command != "status" or SHOWN in printed.out


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_no_text_commands_the_terminal_of_a_live_screen(monkeypatch):
    """Neither by control characters nor by the markup of rich."""
    monkeypatch.setenv("TERM", "xterm")
    stream = Terminal()
    with Display(stream, Budget(executions=9), quiet=False) as shown:
        shown.say(HOSTILE)
        shown.show(Progress(executions=3, violations={HOSTILE: 1}, method={HOSTILE: 1.0}))
    with Meter(stream, 3, HOSTILE + "{task}", quiet=False) as meter:
        meter.show(1, HOSTILE)
    said = stream.getvalue()
    assert "\x07" not in said
    assert "\x9b" not in said
    assert "]52;c;aGk=\\x07" in said
    assert "[bold]:smile:" in said
    assert "\x1b]" not in said
    assert "\u202e" not in said


def test_no_heading_of_a_table_is_markup():
    assert SHOWN in table(HOSTILE, {HOSTILE: Evaluation(3, {HOSTILE: 1})})


def test_a_meter_says_that_the_first_item_is_being_worked_on(monkeypatch):
    monkeypatch.setattr("behavexplor.commands.display.LINE_SECONDS", 0.05)
    stream = io.StringIO()
    with Meter(stream, 1, "failures", quiet=False) as meter:
        time.sleep(0.5)
        assert stream.getvalue() == "0 of 1 failures\n"
    with Meter(stream, 9, "failures", quiet=False) as meter:
        meter.show(1)  # too early for a line
        time.sleep(0.5)
    assert stream.getvalue() == "0 of 1 failures\n"


def test_a_meter_says_how_long_the_rest_will_take(monkeypatch):
    times = iter([0.0, 60.0, 60.0])
    monkeypatch.setattr("behavexplor.commands.display.time.monotonic", lambda: next(times))
    stream = io.StringIO()
    with Meter(stream, 9, "failures", quiet=False) as meter:
        meter.show(3)
    assert stream.getvalue() == "3 of 9 failures, about 2:00 left\n"
