"""Own runs stay own runs: campaigns are killed at random moments, two at a time, and resumed without a flag."""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from behavexplor.campaign.config import stored_config
from behavexplor.campaign.folder_format import CONFIG
from behavexplor.campaign.provenance import accepted, list_path

ROOT = Path(__file__).parents[2]
KILLS = 50


def begun(folder, environment, *flags):
    command = [sys.executable, "-m", "behavexplor", "fuzz", "--workers", "1", "--quiet", *flags]
    return subprocess.Popen(command, cwd=folder, env=environment, stderr=subprocess.PIPE, start_new_session=True)


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="kills process groups")
def test_whatever_is_killed_can_be_resumed(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "mine.py").write_text("from tests.drivers import Swerver\nclass Mine(Swerver):\n    pass\n")
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}:{ROOT}"}
    rng, begun_runs = random.Random(1), []
    new = ["--ads", "mine:Mine", "--unconfined", "--method", "uniform", "--budget", "1000"]
    for number in range(KILLS // 2):
        runs = [tmp_path / f"run-{number}-{i}" for i in range(2)]
        campaigns = [
            begun(tmp_path, environment, *new, "--seed", str(10 * number + i), "--out", str(runs[i])) for i in range(2)
        ]
        if rng.random() < 0.7:  # about the time at which the folder is made, or at any time
            while not any((run / CONFIG).exists() or run.exists() for run in runs) and campaigns[0].poll() is None:
                time.sleep(0.0005)
            time.sleep(rng.choice([0.0, rng.uniform(0.0, 0.02), rng.uniform(0.0, 1.0)]))
        else:
            time.sleep(rng.uniform(0.0, 6.0))
        for campaign in campaigns:
            os.killpg(campaign.pid, signal.SIGKILL)
            assert campaign.wait() == -signal.SIGKILL, campaign.stderr.read()
            campaign.stderr.close()
        for run in runs:
            if (run / CONFIG).exists():
                begun_runs.append(run)
                assert accepted(stored_config(run)).target.unconfined
    assert len(begun_runs) > KILLS // 4
    resumed = begun(tmp_path, environment, "--resume", str(begun_runs[-1]), "--stop-after", "1")
    assert resumed.wait(120) == 0, resumed.stderr.read()
    resumed.stderr.close()
    lines = list_path().read_text().split()
    assert len(lines) == len(set(lines)) >= len(begun_runs)
