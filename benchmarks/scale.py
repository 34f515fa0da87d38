"""What limits a campaign with many workers: CPU time of its own process for each execution, and what it can feed."""

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import Future
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from behavexplor.campaign.campaign import Campaign, search_method
from behavexplor.campaign.config import CampaignConfig
from behavexplor.campaign.judges import Judges
from behavexplor.campaign.opening import opened
from behavexplor.campaign.progress import Stage, StageClock
from behavexplor.campaign.store import Store
from behavexplor.execution.executor import Executor

Row = dict[str, Any]

CAMPAIGNS = (
    ("intersection-straight", "constant", "uniform"),
    ("intersection-straight", "constant", "nsga2"),
    ("intersection-straight", "constant", "behavexplor"),
    ("lane-change", "learned:lane-change", "uniform"),
    ("lane-change", "learned:lane-change", "behavexplor"),
    ("highway-fast-v0", "constant:FASTER", "uniform"),
    ("roundabout-v0", "constant:FASTER", "uniform"),
)
STAGES = (Stage.ASKING, Stage.WAITING, Stage.JUDGING, Stage.MINING, Stage.STORING)
FIRST = 200  # executions that are left out: processes start, and machine code is loaded


class CPUClock(StageClock):
    """A clock of the CPU time of the thread that conducts a campaign."""

    @contextmanager
    def during(self, stage: Stage) -> Iterator[None]:
        """Return a context whose CPU time counts for a stage."""
        begun = time.thread_time()
        try:
            yield
        finally:
            self.seconds[stage] += time.thread_time() - begun


class MemoryExecutor(Executor):
    """Stands for any number of workers: it answers from memory.

    Args:
        answers: the trace for each request, both as bytes.
    """

    room = 256

    def __init__(self, answers: Mapping[bytes, bytes]) -> None:
        self._answers = answers

    def submit(self, function: str, data: bytes) -> "Future[bytes]":  # noqa: ARG002
        """Answer at once."""
        future: Future[bytes] = Future()
        future.set_result(self._answers[data])
        return future

    def shutdown(self, *, wait: bool = True) -> None:
        """Do nothing."""

    def stop(self) -> None:
        """Do nothing."""


class Laps:
    """Times of a campaign from its execution `FIRST` to its end.

    Args:
        campaign: the campaign, whose clock is replaced.
    """

    def __init__(self, campaign: Campaign) -> None:
        campaign.clock = CPUClock()
        self._clock, self._at = campaign.clock, self._now(campaign.clock)
        self._from = 0
        begun: list[int] = []

        def observe(progress: Any) -> None:
            if progress.executions >= FIRST and not begun:
                begun.append(progress.executions)
                self._at, self._from = self._now(self._clock), progress.executions

        campaign.run(observe)
        n = campaign.progress.executions - self._from
        self.figures = {name: (value - self._at[name]) / n for name, value in self._now(self._clock).items()}

    @staticmethod
    def _now(clock: StageClock) -> dict[str, float]:
        times = {"wall": time.monotonic(), "own CPU": time.process_time()}
        return times | {stage: clock.seconds[stage] for stage in STAGES}


def measured(env: str, ads: str, method: str, workers: int, budget: int) -> Row:
    """Return the figures of one campaign [s for each execution], for `scale_rows`, in this process."""
    config = CampaignConfig(env=env, ads=ads, method=method, budget=str(budget), confirm=False)
    with tempfile.TemporaryDirectory() as folder:
        with opened(config, Path(folder, "run"), workers, resume=False) as ready:
            row = Laps(ready.campaign).figures
            logical = ready.campaign.logical
        if workers == 1:
            with closing(Store.read(Path(folder, "run"))) as store:
                answers = {
                    request.encode(): one.trace
                    for one in store.executions()
                    for request in (json.dumps(one.record.scenario), json.dumps([config.seed, one.id]))
                }
            store, judges = Store.create(Path(folder, "fed"), config.to_yaml()), Judges(workers, logical)
            fed = Campaign(
                config, search_method(config, logical), logical, store, MemoryExecutor(answers), judges=judges
            )
            row["from memory"] = Laps(fed).figures["wall"]
            judges.shutdown()
            store.close()
    return row


def scale_rows(budget: int) -> list[Row]:
    """Return a row for each of `CAMPAIGNS`, each measured in processes of its own.

    Args:
        budget: number of executions of each campaign, more than `FIRST`.
    """
    rows = []
    for env, ads, method in CAMPAIGNS:
        one, two = (_in_process(env, ads, method, str(workers), str(budget)) for workers in (1, 2))
        figures = {f"{name} [ms]": 1000 * one[name] for name in ("own CPU", *STAGES)}
        speeds = {"1 worker, per second": 1 / one["wall"], "2 workers": 1 / two["wall"]}
        rows.append({"env": env, "ads": ads, "method": method, **figures, **speeds, "memory": 1 / one["from memory"]})
    return rows


def _in_process(*arguments: str) -> Row:
    command = [sys.executable, "-m", "benchmarks.scale", *arguments]
    found: Row = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
    return found


if __name__ == "__main__":
    print(json.dumps(measured(*sys.argv[1:4], *map(int, sys.argv[4:]))))
