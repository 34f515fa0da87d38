"""Campaigns on Ray: the same records, also when one of two nodes is killed. Ray takes its time to start."""

import json
import os
import secrets
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from behavexplor.campaign.config import CampaignConfig
from behavexplor.campaign.opening import opened
from behavexplor.errors import InputError
from behavexplor.execution import ray_cluster
from behavexplor.execution.fingerprint import machine_fingerprint

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]  # Ray's own, of its Python and its libraries

BUDGET = 300
CONFIG = CampaignConfig(env="lane-follow", ads="rule:hardened", budget=str(BUDGET), seed=2)
SHORT = CampaignConfig(env="lane-follow", ads="constant", budget="10", seed=2)
KILLED_AT = 150  # executions, when both nodes have been at work for a while
PATIENCE = 60.0  # [s]


@pytest.fixture(autouse=True, scope="module")
def token():
    """No cluster that others can use, and no file of Ray's at home; it reads this when it is imported."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_AUTH_MODE", "token")
        patch.setenv("RAY_AUTH_TOKEN", secrets.token_hex(32))
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        pytest.importorskip("ray")
        yield


@pytest.fixture
def machines():
    """A head that executes nothing, and two nodes of one core."""
    cluster = pytest.importorskip("ray.cluster_utils").Cluster(
        initialize_head=True, head_node_args={"num_cpus": 0, "include_dashboard": False}
    )
    nodes = [cluster.add_node(num_cpus=1) for _ in range(2)]
    cluster.wait_for_nodes()
    yield cluster, nodes
    cluster.shutdown()


def records(folder, workers, cluster="", observe=lambda _: None, config=CONFIG):
    """The records of a campaign."""
    with opened(config, folder, workers, resume=False, cluster=cluster) as ready:
        ready.campaign.run(observe)
        return list(ready.store.records())


def processes():
    """The processes of workers that run below Ray on this machine."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            command, variables = (process / "cmdline").read_bytes(), (process / "environ").read_bytes()
        except OSError:  # it has just ended, or is none of ours
            continue
        if b"multiprocessing.forkserver" in command and b"RAY_RAYLET_PID=" in variables:
            found.append(int(process.name))
    return found


def are_gone(seconds=PATIENCE):
    deadline = time.monotonic() + seconds
    while processes() and time.monotonic() < deadline:
        time.sleep(0.05)
    return not processes()


def test_a_node_that_is_killed_costs_no_record(machines, tmp_path):
    cluster, (mortal, _) = machines
    alone = records(tmp_path / "alone", 1)
    killed = []

    def kill(progress):
        if not killed and progress.executions >= KILLED_AT:
            killed.append(len(processes()))
            cluster.remove_node(mortal, allow_graceful=False)

    found = records(tmp_path / "cluster", 2, f"ray:{cluster.address}", kill)
    assert killed == [4]  # on each node, what starts workers, and a worker
    assert found == alone
    assert are_gone()


def test_a_cluster_on_this_machine_gives_the_same_records(tmp_path):
    alone = records(tmp_path / "alone", 0, config=SHORT)
    assert records(tmp_path / "cluster", 0, "ray", config=SHORT) == alone
    assert are_gone()


def test_a_machine_that_differs_is_refused(tmp_path, monkeypatch):
    ours = {**json.loads(machine_fingerprint(("constant",))), "numpy": "other"}
    monkeypatch.setattr(ray_cluster, "machine_fingerprint", lambda _: json.dumps(ours).encode())
    with pytest.raises(InputError, match=r"The node .* has a different numpy \(.*\) than this machine \(other\)"):
        records(tmp_path / "run", 1, "ray", config=SHORT)
    assert are_gone()


def test_a_campaign_that_is_killed_leaves_no_process(machines, tmp_path):
    cluster, _ = machines
    command = [sys.executable, "-m", "behavexplor", "fuzz", "--env", "lane-follow", "--ads", "constant"]
    flags = ["--budget", "100000", "--cluster", f"ray:{cluster.address}", "--out", str(tmp_path / "run"), "--quiet"]
    campaign = subprocess.Popen([*command, *flags], start_new_session=True, env=dict(os.environ))
    try:
        deadline = time.monotonic() + PATIENCE
        while len(processes()) < 4 and time.monotonic() < deadline:
            time.sleep(0.05)
        assert len(processes()) == 4
    finally:
        campaign.send_signal(signal.SIGKILL)
        campaign.wait()
    assert are_gone()
