"""The campaigns of an experiment, each in a process of its own, as many at a time as there are cores."""

import json
import multiprocessing
import signal
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, Final

import yaml
from threadpoolctl import threadpool_limits

from behavexplor.bench.experiment import Cell
from behavexplor.bench.timing import Stopwatch, read_timing
from behavexplor.campaign.campaign import Campaign, ExecutionError
from behavexplor.campaign.campaign import Progress as CampaignProgress
from behavexplor.campaign.config import campaign_config, stored_config
from behavexplor.campaign.damage import DATABASE
from behavexplor.campaign.opening import opened
from behavexplor.campaign.store import Store
from behavexplor.errors import InputError

PROGRESS, WARNING, FAILED, DONE = "progress", "warning", "failed", "done"  # what a cell's process says
_LISTEN_SECONDS: Final = 0.5
_PRELOAD: Final = [
    "behavexplor.campaign.opening",
    "behavexplor.envs.driving",
    "sklearn.cluster",
]


@dataclass(frozen=True)
class State:
    """How far a cell has come.

    Attributes:
        executions: how many are stored.
        finished: whether there is nothing left to do.
    """

    executions: int
    finished: bool


@dataclass(frozen=True)
class Progress:
    """How far an experiment has come.

    Attributes:
        cells: how many there are.
        finished: how many are finished.
        failed: what went wrong, by cell.
        executions: stored by now, of all cells.
        total: as many as there will be in the end.
        left: time until then, as far as can be told [s].
        warnings: what is odd about the systems under test.
    """

    cells: int
    finished: int = 0
    failed: Mapping[Cell, str] = field(default_factory=dict)
    executions: int = 0
    total: int = 0
    left: float | None = None
    warnings: tuple[str, ...] = ()


def state(cell: Cell, root: Path) -> State:
    """How far a cell has come.

    Raises:
        InputError: if its folder holds another campaign, or cannot be read.
    """
    folder = root / cell.folder
    if not (folder / DATABASE).is_file():
        return State(0, finished=False)
    stored = stored_config(folder)
    if replace(stored, budget=cell.config.budget) != cell.config:
        raise InputError(f"{folder} holds another campaign than the experiment's now: choose another --out")
    store = Store.read(folder)
    count, budget = len(store), int(cell.config.budget)
    store.close()
    if count > budget:
        raise InputError(f"{folder} has {count} executions, more than the budget {budget}: choose another --out")
    return State(count, finished=count == budget or read_timing(folder).ended is not None)


class Cells:
    """Runs the cells that are not finished.

    Args:
        cells: all of the experiment, in the order in which they are run.
        root: the experiment's folder.
        jobs: how many run at a time.
        workers: processes that execute the scenarios of one; 0 is its own.

    Raises:
        InputError: see `state`.
    """

    def __init__(self, cells: Sequence[Cell], root: Path, jobs: int, workers: int) -> None:
        self._root, self._jobs, self._workers = root, jobs, workers
        states = {cell: state(cell, root) for cell in cells}
        self._waiting = deque(cell for cell in cells if not states[cell].finished)
        self._running: dict[Connection, _Process] = {}
        self._executions = {cell: states[cell].executions for cell in cells}
        self._at_start = sum(self._executions.values())
        self._start = time.monotonic()
        self._open = {cell: int(cell.config.budget) - states[cell].executions for cell in self._waiting}
        self.progress = Progress(len(cells), finished=len(cells) - len(self._waiting))
        self.stopping = False

    def stop(self) -> None:
        """End the running cells after the execution that each of them is at."""
        self.stopping = True
        for running in self._running.values():
            running.process.terminate()

    def run(self, observe: Callable[[Progress], None]) -> Progress:
        """Run until all is finished, or has failed, or `stop` is called.

        Args:
            observe: called whenever something is new.
        """
        try:
            while self._running or (self._waiting and not self.stopping):
                self._fill()
                for connection in wait(list(self._running), timeout=_LISTEN_SECONDS):
                    self._listen(self._running[connection])  # type: ignore[index]
                self._count()
                observe(self.progress)
        finally:
            for running in self._running.values():
                running.process.kill()
        self._count()
        return self.progress

    def _fill(self) -> None:
        while self._waiting and len(self._running) < self._jobs and not self.stopping:
            cell = self._waiting.popleft()
            running = _Process(cell, self._root / cell.folder, self._workers)
            self._running[running.connection] = running

    def _listen(self, running: "_Process") -> None:
        """Take in one thing that a cell's process says, or its end."""
        try:
            kind, value = json.loads(running.connection.recv_bytes())
        except (EOFError, OSError):
            self._end(running)
            return
        if kind == PROGRESS:
            self._executions[running.cell] = value
            self._open[running.cell] = int(running.cell.config.budget) - value
        elif kind == WARNING and value not in self.progress.warnings:
            self.progress = replace(self.progress, warnings=(*self.progress.warnings, value))
        elif kind == FAILED:
            running.failure = value
        elif kind == DONE:
            running.done = bool(value)

    def _end(self, running: "_Process") -> None:
        del self._running[running.connection]
        running.connection.close()
        running.process.join()
        code = running.process.exitcode
        if running.failure is None and code and not self.stopping:
            running.failure = f"its process ended with exit code {code}"
        if running.failure is not None:
            self.progress = replace(self.progress, failed={**self.progress.failed, running.cell: running.failure})
        if running.done:
            self.progress = replace(self.progress, finished=self.progress.finished + 1)
        if running.done or running.failure is not None:
            self._open[running.cell] = 0

    def _count(self) -> None:
        done, left = sum(self._executions.values()), sum(self._open.values())
        rate = (done - self._at_start) / (time.monotonic() - self._start)
        self.progress = replace(
            self.progress, executions=done, total=done + left, left=left / rate if rate > 0 else None
        )


class _Process:
    """A cell's process, and what it has said."""

    def __init__(self, cell: Cell, folder: Path, workers: int) -> None:
        methods = multiprocessing.get_all_start_methods()
        context: Any = multiprocessing.get_context("forkserver" if "forkserver" in methods else "spawn")
        if context.get_start_method() == "forkserver":
            context.set_forkserver_preload(_PRELOAD)
        self.cell = cell
        self.failure: str | None = None
        self.done = False
        self.connection, theirs = context.Pipe(duplex=False)
        self.process = context.Process(target=_run, args=(theirs, cell.config.to_yaml(), str(folder), workers))
        self.process.start()
        theirs.close()


class _Stop:
    """Stops a campaign, also if that is asked for before there is one."""

    def __init__(self) -> None:
        self._campaign: Campaign | None = None
        self.asked = False

    def __call__(self, *_: object) -> None:
        self.asked = True
        if self._campaign is not None:
            self._campaign.stop()

    def watch(self, campaign: Campaign) -> None:
        self._campaign = campaign
        if self.asked:
            campaign.stop()


def _run(connection: Connection, config: str, folder: str, workers: int) -> None:
    """What a cell's process does. It leaves Ctrl-C to the experiment's, and ends with it: nobody listens then."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    stop = _Stop()
    signal.signal(signal.SIGTERM, stop)

    def say(kind: str, value: object) -> None:
        connection.send_bytes(json.dumps([kind, value]).encode())

    try:
        say(DONE, _campaign(yaml.safe_load(config), Path(folder), workers, stop, say))
    except (InputError, ExecutionError) as error:
        say(FAILED, str(error))
    except BrokenPipeError:
        return
    except Exception as error:
        with suppress(BrokenPipeError):
            say(FAILED, f"{type(error).__name__}: {error}")


def _campaign(
    values: Mapping[str, Any], folder: Path, workers: int, stop: _Stop, say: Callable[[str, object], None]
) -> bool:
    """Run a campaign, or go on with it; whether it came to its end."""
    with opened(campaign_config(values), folder, workers, resume=(folder / DATABASE).is_file()) as ready:
        stop.watch(ready.campaign)
        for warning in ready.warnings:
            say(WARNING, warning)
        threadpool_limits(1)  # of what the ADS has loaded, too
        watch = Stopwatch(folder, ready.campaign.elapsed)

        def observe(progress: CampaignProgress) -> None:
            watch.observe(progress)
            say(PROGRESS, progress.executions)

        try:
            watch.end(ready.campaign.run(observe))
        finally:
            watch.write()
        return not ready.campaign.stopping
