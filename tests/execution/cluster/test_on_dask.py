"""Campaigns on Dask: the same records, also when one of two nodes is killed."""

import json
import os
import signal
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import pytest

from behavexplor.execution.cluster.on_dask import DaskCluster
from tests.execution.cluster.two_nodes import (
    BUDGET,
    KILLED_AT,
    PATIENCE,
    SHORT,
    Killing,
    is_over,
    processes_of_nodes,
    records,
    starts_of,
)

pytestmark = pytest.mark.skipif(find_spec("distributed") is None, reason="needs the extra dask")
ROOT = Path(__file__).parents[3]


class Machines:
    """A scheduler and workers, each as on a machine of its own: in a session of its own."""

    def __init__(self, folder):
        self._folder = folder
        self._file = folder / "scheduler.json"
        self._processes = []
        self._start("dask_scheduler", "--port", "0", "--scheduler-file", str(self._file))
        self._wait(self._file.exists)
        self.address = json.loads(self._file.read_text())["address"]

    def add(self, *flags):
        """One more machine; its process."""
        log = self._folder / f"{len(self._processes)}.log"
        process = self._start("dask_worker", self.address, "--nthreads", "1", "--host", "127.0.0.1", *flags)
        self._wait(lambda: "Registered to" in log.read_text())
        return process

    def close(self):
        for process in reversed(self._processes):
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
            process.wait(PATIENCE)

    def _start(self, program, *arguments):
        command = [sys.executable, "-m", f"distributed.cli.{program}", *arguments, "--no-dashboard"]
        log = (self._folder / f"{len(self._processes)}.log").open("wb")
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONWARNINGS": "ignore"}
        options = {"start_new_session": True, "cwd": self._folder, "env": environment}
        self._processes.append(subprocess.Popen(command, stdout=log, stderr=log, **options))
        log.close()
        return self._processes[-1]

    def _wait(self, condition):
        deadline = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < deadline
            time.sleep(0.05)


@pytest.fixture
def machines(tmp_path):
    machines = Machines(tmp_path)
    yield machines
    machines.close()


@pytest.fixture
def starts(monkeypatch):
    """What is started on the cluster while the test runs."""
    return starts_of(DaskCluster, monkeypatch)


@pytest.mark.slow
def test_a_node_that_is_killed_costs_no_record(machines, starts, tmp_path):
    """The one that stays has a nanny, as Dask has it by default; the one that is killed has none to begin it again."""
    alone = records(tmp_path / "alone", 1)
    machines.add()
    mortal = machines.add("--no-nanny")
    killing = Killing(lambda: os.killpg(mortal.pid, signal.SIGKILL))
    found = records(tmp_path / "cluster", 2, f"dask:{machines.address}", killing)
    assert KILLED_AT <= killing.killed_at < BUDGET
    assert found == alone
    assert len(starts) == 3  # two, and one in place of the one that was lost
    assert is_over(processes_of_nodes)


def test_a_cluster_on_this_machine_gives_the_same_records(tmp_path):
    alone = records(tmp_path / "alone", 0, config=SHORT)
    assert records(tmp_path / "cluster", 2, "dask", config=SHORT) == alone
    assert is_over(processes_of_nodes)
