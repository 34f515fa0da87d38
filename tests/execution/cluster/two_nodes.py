"""A campaign on a cluster of two nodes, one of which is killed while it works, beside one on this machine."""

import time
from pathlib import Path

from behavexplor.campaign.config import CampaignConfig
from behavexplor.campaign.opening import opened

BUDGET = 300
CONFIG = CampaignConfig(env="lane-follow", ads="rule:hardened", budget=str(BUDGET), seed=2)
SHORT = CampaignConfig(env="lane-follow", ads="constant", budget="10", seed=2)
KILLED_AT = 150  # executions, when both nodes have been at work for a while
PATIENCE = 60.0  # [s]


def records(folder, workers, cluster="", observe=lambda _: None, config=CONFIG):
    """The records of a campaign."""
    with opened(config, folder, workers, resume=False, cluster=cluster) as ready:
        ready.campaign.run(observe)
        return list(ready.store.records())


class Killing:
    """Kills a node, once, when some executions are stored and others are under way."""

    def __init__(self, kill):
        self.kill, self.killed_at = kill, None

    def __call__(self, progress):
        if self.killed_at is None and progress.executions >= KILLED_AT:
            self.killed_at = progress.executions
            self.kill()


def starts_of(kind, monkeypatch):
    """The arguments of each node that is started on clusters of a kind from now on."""
    begun, start = [], kind.start
    monkeypatch.setattr(kind, "start", lambda cluster, *args: begun.append(args) or start(cluster, *args))
    return begun


def is_over(condition):
    """Whether a condition ends before long."""
    deadline = time.monotonic() + PATIENCE
    while condition() and time.monotonic() < deadline:
        time.sleep(0.05)
    return not condition()


def processes_of_nodes(session=None):
    """The processes that nodes have started on this machine and that still run, of one session or of all."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            command = (process / "cmdline").read_bytes().split(b"\0")
            fields = (process / "stat").read_text().rpartition(") ")[2].split()
        except (FileNotFoundError, ProcessLookupError):  # it has just ended
            continue
        if command[1:3] == [b"-m", b"behavexplor.execution.cluster"] and session in (None, int(fields[3])):
            found.append(int(process.name))
    return found
