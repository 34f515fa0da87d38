"""The lines of Python that a summary, a replay and a report print show the same failure in a fresh interpreter."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from behavexplor import find_failures
from behavexplor.campaign.run_summary import snippet

POLICIES = Path(__file__).parents[2] / "docs" / "data" / "policies"
FAILURES = 5
TRAINED = ("highway-fast", "merge", "roundabout", "intersection")
SHOWN = """
from behavexplor.judge.classes import violation_class
trace, stored = info["trace"], run.trace({number})
apart = abs(trace.position - stored.position).max()  # the compiled engine rounds otherwise
print(violation_class(trace, run.violated(trace)).id, len(trace.time), apart < 1e-3)
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("env", "driver"),
    [
        *((name, "rule") for name in ("S1", "S2", "S3", "S4")),
        *((f"{name}-v0", str(POLICIES / f"{name}.zip")) for name in TRAINED),
    ],
)
def test_the_printed_lines_show_the_same_failure(env, driver, tmp_path):
    settings = {"method": "uniform", "confirm": False, "unconfined": True, "workers": 0, "stop_after": FAILURES}
    run = find_failures(driver, env, budget=750, out=tmp_path / "run", **settings)
    failed = [record for record in run.records if record.failed][:FAILURES]
    assert len(failed) == FAILURES
    for record in failed:
        lines = snippet(run.folder, record.id)
        told = subprocess.run(
            [sys.executable, "-c", lines + SHOWN.format(number=record.id)],
            capture_output=True, text=True, check=True, cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(Path.cwd())},
        )  # fmt: skip
        violated, about = told.stdout.splitlines()
        assert violated == str(record.violated)
        assert about == f"{record.violation_class} {len(run.trace(record.id).time)} True"
