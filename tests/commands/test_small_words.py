"""Results in words, and flags that two commands share."""

import pytest

from behavexplor.campaign.config import stored_config
from behavexplor.commands import OK, main
from behavexplor.commands.check import result
from behavexplor.execution.simulation import Simulation


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
    assert not stored_config(tmp_path / "out" / "second").confirm
