"""Results in words, and flags that two commands share."""

from contextlib import nullcontext
from types import SimpleNamespace

import pytest

from behavexplor.campaign.config import stored_config
from behavexplor.commands import BAD_INPUT, OK, main
from behavexplor.commands.check import result
from behavexplor.evaluation import Evaluation
from behavexplor.execution.simulation import Simulation
from behavexplor.repair.cases import Case, Suite
from behavexplor.repair.checking import CheckedCase
from tests.fakes import LOGICAL


@pytest.mark.parametrize(
    ("failed", "count", "said"),
    [
        (0, 1, "The only scenario passes"),
        (1, 1, "The only scenario fails"),
        (0, 3, "All 3 scenarios pass"),
        (1, 3, "1 of 3 scenarios fails"),
        (2, 3, "2 of 3 scenarios fail"),
    ],
)
def test_one_scenario_is_not_many(failed, count, said):
    assert result(failed, count) == said


def test_compare_leaves_confirmation_out_as_fuzz_does(tmp_path, monkeypatch, capsys):
    def refuse(*_):
        raise AssertionError("highway-env was asked")

    monkeypatch.setattr(Simulation, "run", refuse)
    drivers = ["constant:FASTER", "constant:IDLE"]
    flags = ["--env", "merge-v0", "--scenarios", "2", "--workers", "0", "--quiet", "--no-confirm"]
    assert main(["compare", *drivers, *flags, "--out", str(tmp_path / "out")]) == OK
    assert "2 scenarios of merge-v0" in capsys.readouterr().out
    assert not stored_config(tmp_path / "out" / "second").says.confirm


def test_what_was_driven_is_shown_even_if_a_file_of_it_cannot_be_written(tmp_path, monkeypatch, capsys):
    case = Case(words="", class_id="R2", run="run", execution=7, holds=("lines",), scenario={})
    outcome = CheckedCase(case, ("lines",), "Touched a line")
    monkeypatch.setattr(Suite, "read", lambda _: Suite(env="lane-change", driver="idm", cases=(case,)))
    drive = SimpleNamespace(all_of=lambda _: [outcome])
    monkeypatch.setattr("behavexplor.commands.check.opened_driver", lambda *_, **__: nullcontext(drive))
    assert main(["check", "suite", "--junit", str(tmp_path)]) == BAD_INPUT
    printed = capsys.readouterr()
    assert "R2-7      FAIL  Touched a line" in printed.out
    assert "cannot be written" in printed.err

    rates = Evaluation(4, {"arrived": 3})
    monkeypatch.setattr("behavexplor.commands.evaluate._evaluated", lambda *_: (LOGICAL, rates, False))
    assert main(["evaluate", "--json", str(tmp_path)]) == BAD_INPUT
    printed = capsys.readouterr()
    assert "75.0% (" in printed.out
    assert "cannot be written" in printed.err
