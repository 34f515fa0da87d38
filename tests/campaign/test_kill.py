"""A campaign that is killed again and again loses nothing that it has shown, and ends as if it never was."""

import os
import pty
import re
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from threading import Thread

import numpy as np
import pytest

from behavexplor.campaign.folder_format import DATABASE, FAILURES
from behavexplor.campaign.store import Store
from behavexplor.errors import InputError

ROOT = Path(__file__).parents[2]
KILLS = 200
BUDGET = 300  # a replay of so many takes longer than it takes to show the first screen
CAMPAIGN = ["--ads", "constant:1", "--env", "lane-follow", "--budget", str(BUDGET), "--seed", "3"]
PATIENCE = 120.0  # for what comes anyhow [s]


class Life:
    """A campaign's process, begun or resumed in a folder, and what it shows on its terminal."""

    def __init__(self, folder, workers, campaign=CAMPAIGN):
        self.folder = folder
        run = ["--resume", folder] if (folder / "config.yaml").exists() else [*campaign, "--out", folder]
        command = [sys.executable, "-m", "behavexplor", "fuzz", *map(str, run), "--workers", str(workers)]
        self._terminal, theirs = pty.openpty()
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "TERM": "xterm", "COLUMNS": "120", "LINES": "40"}
        self._process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=theirs, stderr=theirs, env=environment, start_new_session=True
        )
        os.close(theirs)
        self._text = bytearray()
        self._reader = Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self):
        try:
            while some := os.read(self._terminal, 65536):
                self._text += some
        except OSError:  # the other end is closed
            return

    @property
    def text(self):
        return self._text.decode(errors="replace")

    @property
    def shown(self):
        """How many executions the screen has counted; None before the first screen."""
        counts = re.findall(rf"(\d+) of {BUDGET} executions", self.text)
        return int(counts[-1]) if counts else None

    def wait(self, seconds, until=lambda: False):
        """Wait for a time, for something to happen, or for the end of the process; whether it has ended."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline and self._process.poll() is None and not until():
            time.sleep(0.001)
        return self._process.poll() is not None

    def kill(self, whole_group):
        (os.killpg if whole_group else os.kill)(self._process.pid, signal.SIGKILL)

    def bury(self):
        """The exit code, once every process of its session has ended."""
        code = self._process.wait(PATIENCE)
        deadline = time.monotonic() + 20
        while (orphans := session(self._process.pid)) and time.monotonic() < deadline:
            time.sleep(0.01)
        assert not orphans, f"processes {orphans} have outlived their campaign"
        self._reader.join(PATIENCE)
        os.close(self._terminal)
        return code


def session(leader):
    """The processes of a session that still run."""
    members = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(") ")[2].split()
        except (FileNotFoundError, ProcessLookupError):  # it has just ended
            continue
        if int(fields[3]) == leader and fields[0] != "Z":
            members.append(int(stat.parent.name))
    return members


def stored(folder):
    """The records that a reader finds."""
    try:
        store = Store.read(folder)
    except InputError:  # it has not been made yet
        return []
    try:
        return list(store.records())
    finally:
        store.close()


def count_written(folder):
    try:
        return (folder / f"{DATABASE}-wal").stat().st_size + len(list((folder / FAILURES).iterdir()))
    except FileNotFoundError:
        return 0


def phase(life, before, after):
    """What a campaign was doing when it was killed, by what it has left."""
    files = [path.name for path in (life.folder / FAILURES).glob("*")] if life.folder.exists() else []
    if any(name.endswith(".part") or int(name.partition(".")[0]) >= after for name in files):
        return "commit"
    if not (life.folder / DATABASE).exists():
        return "making the folder" if life.folder.exists() else "start"
    if life.shown is None:
        return "start" if before else "warm-up"
    return "replay of what was stored" if life.shown < before else "run"


class Attack:
    """One seeded series of kills."""

    def __init__(self, rng, times):
        self._rng = rng
        self._times = times  # by workers: how long a campaign takes to its first screen, and from there to its end [s]

    def strike(self, folder, workers):
        """Live once, at most to a random instant; the life, whether it was killed, and what was read before that."""
        life = Life(folder, workers)
        fresh = not folder.exists()
        start, rest = self._times[workers]
        aims = ["time", "screen", "commit", "folder"]
        aim = self._rng.choice(aims, p=[0.35, 0.1, 0.1, 0.45] if fresh else [0.45, 0.3, 0.25, 0.0])
        if aim == "time":
            ended = life.wait(self._rng.uniform(0.0, 1.2 * start))
        elif aim == "screen":
            life.wait(PATIENCE, lambda: life.shown is not None)
            ended = life.wait(rest * self._rng.uniform() ** 2)  # rather early, because a replay is short
        elif aim == "commit":
            life.wait(PATIENCE, lambda: life.shown is not None)
            life.wait(self._rng.uniform(0.0, rest))
            written = count_written(folder)
            life.wait(PATIENCE, lambda: count_written(folder) != written)
            ended = life.wait(self._rng.uniform(0.0, 0.01))
        else:
            life.wait(PATIENCE, folder.exists)
            ended = life.wait(self._rng.uniform(0.0, 0.006))
        seen = stored(folder) if self._rng.random() < 0.5 else []
        if not ended:
            life.kill(bool(self._rng.random() < 0.5))
        return life, not ended, len(seen)


def uninterrupted(folder, workers, campaign=CAMPAIGN):
    """The records of a campaign that runs to its end, and its times to the first screen and from there on [s]."""
    begun = time.monotonic()
    life = Life(folder, workers, campaign)
    life.wait(PATIENCE, lambda: life.shown is not None)
    shown = time.monotonic()
    life.wait(PATIENCE)
    ended = time.monotonic()
    assert life.bury() == 0, life.text
    return stored(folder), (shown - begun, ended - shown)


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="the search for orphans reads /proc")
def test_a_campaign_survives_any_number_of_kills(tmp_path):
    runs = {workers: uninterrupted(tmp_path / f"whole-{workers}", workers) for workers in (0, 1, 2)}
    whole = runs[0][0]
    assert all(records == whole for records, _ in runs.values())
    rng = np.random.default_rng(2026)
    attack = Attack(rng, {workers: times for workers, (_, times) in runs.items()})
    phases, kills, lives, acknowledged, finished = Counter(), 0, 0, 0, 0
    folder = tmp_path / "killed-0"
    before = 0
    while kills < KILLS:
        life, was_killed, seen = attack.strike(folder, lives % 3)
        lives += 1
        code = life.bury()
        records = stored(folder)
        assert records == whole[: len(records)], f"kill {kills}: other records"
        assert len(records) >= max(before, seen, life.shown or 0), f"kill {kills}: an acknowledged execution is lost"
        assert "Traceback" not in life.text, life.text
        acknowledged += len(records) - before
        if was_killed and code == -signal.SIGKILL:
            kills += 1
            phases[phase(life, before, len(records))] += 1
        else:
            assert (code, len(records)) == (0, BUDGET), life.text
        print(f"{kills} kills, {acknowledged} acknowledged", dict(phases), flush=True)  # noqa: T201 - it takes long
        before = len(records)
        if before == BUDGET:
            finished += 1
            folder, before = tmp_path / f"killed-{finished}", 0
    last = Life(folder, 1)
    last.wait(PATIENCE)
    assert last.bury() == 0, last.text
    assert stored(folder) == whole
    figures = f"{kills} kills in {lives} lives of {finished + 1} campaigns, {acknowledged} acknowledged executions"
    print(figures, phases)  # noqa: T201 - the figures of docs/robustness.md
    assert {"start", "warm-up", "replay of what was stored", "run", "commit"} <= set(phases)


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="the search for orphans reads /proc")
def test_a_search_in_highway_env_does_not_depend_on_workers_or_kills(tmp_path):
    campaign = ["--ads", "constant:IDLE", "--env", "highway-fast-v0", "--budget", str(BUDGET), "--seed", "3"]
    campaign += ["--method", "niching"]
    whole, *others = [uninterrupted(tmp_path / f"whole-{workers}", workers, campaign)[0] for workers in (0, 1, 2)]
    assert others == [whole, whole]
    assert {record.origin for record in whole} == {"uniform", "child"}
    folder = tmp_path / "killed"
    for workers, count in ((0, 60), (1, 120), (2, 180)):
        life = Life(folder, workers, campaign)
        assert not life.wait(PATIENCE, lambda count=count: len(stored(folder)) >= count)
        life.kill(whole_group=True)
        assert life.bury() == -signal.SIGKILL
        records = stored(folder)
        assert records == whole[: len(records)]
        assert count <= len(records) < BUDGET
    assert uninterrupted(folder, 2)[0] == whole
