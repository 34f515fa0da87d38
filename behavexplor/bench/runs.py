"""The runs of an experiment: their states, and a runner that executes the unfinished ones.

`CampaignService` runs whole campaigns in worker processes and on clusters.
"""

import io
import json
import math
import tarfile
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import closing, suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from threadpoolctl import threadpool_limits

from behavexplor.bench.experiment import PlannedRun
from behavexplor.campaign.campaign import Campaign, ExecutionError
from behavexplor.campaign.config import CampaignConfig, campaign_config, check_revision, stored_config
from behavexplor.campaign.folder_format import DATABASE
from behavexplor.campaign.opening import opened
from behavexplor.campaign.provenance import own_run, remember
from behavexplor.campaign.store import Store
from behavexplor.data.durable import make_folder
from behavexplor.data.target import Target
from behavexplor.errors import InputError
from behavexplor.execution.evaluator import evaluator_recipe
from behavexplor.execution.executor import Executor
from behavexplor.execution.fingerprint import FINGERPRINT, machine_fingerprint
from behavexplor.execution.pool import WorkerPool
from behavexplor.execution.ray_cluster import Limits, RayExecutor
from behavexplor.execution.service import Recipe, Service
from behavexplor.execution.start import fewest_workers

RUN: Final = "run"  # name of the service's function
_PRELOAD: Final = ("behavexplor.bench.runs", "behavexplor.envs.driving", "sklearn.cluster")


@dataclass(frozen=True)
class Outcome:
    """Outcome of a campaign."""

    finished: bool  # whether the campaign is complete
    failure: str | None = None  # sentence on why the campaign failed; None if it did not
    warnings: tuple[str, ...] = ()  # warnings about the ADS, each of them a sentence


class CampaignService(Service):
    """Runs one whole campaign for each call, and stops it on request."""

    def __init__(self) -> None:
        self.functions: Mapping[str, Callable[[bytes], bytes]] = {
            RUN: self.run,
            FINGERPRINT: lambda ads: machine_fingerprint(json.loads(ads)),
        }
        self._campaign: Campaign | None = None
        self._stopping = False

    def stop(self) -> None:
        """End the campaign after the current execution, or before the first one if it has not begun."""
        self._stopping = True
        if self._campaign is not None:
            self._campaign.stop()

    def run(self, request: bytes) -> bytes:
        """Run or resume a campaign, as `campaign_request` asks for it.

        Returns:
            An `Outcome` as JSON and a newline, followed by the packed run folder if the request has no folder on this
            machine.
        """
        head, _, packed = request.partition(b"\n")
        values = json.loads(head)
        config, workers = campaign_config(values["config"]), values["workers"]
        if values["folder"] is not None:
            return _to_json(self.run_in(config, Path(values["folder"]), workers)) + b"\n"
        with TemporaryDirectory() as scratch:
            folder = Path(scratch) / "run"
            unpack(packed, folder)
            outcome = self.run_in(config, folder, workers)
            return _to_json(outcome) + b"\n" + pack(folder)

    def run_in(self, config: CampaignConfig, folder: Path, workers: int) -> Outcome:
        """Run or resume a campaign in a run folder. `workers` processes execute its scenarios; if 0, this one does."""
        warnings: list[str] = []
        try:
            finished = self._run(config, folder, workers, warnings)
        except (InputError, ExecutionError) as error:
            return Outcome(finished=False, failure=str(error), warnings=tuple(warnings))
        return Outcome(finished, warnings=tuple(warnings))

    def _run(self, config: CampaignConfig, folder: Path, workers: int, warnings: list[str]) -> bool:
        workers = max(workers, fewest_workers(config.target))
        with opened(config, folder, workers, resume=(folder / DATABASE).is_file()) as ready:
            self._campaign = ready.campaign
            if self._stopping:
                ready.campaign.stop()
            warnings += ready.warnings
            threadpool_limits(1)  # includes libraries that the ADS has loaded
            ready.campaign.run(lambda _: None)
            ready.campaign.confirm()
            return not ready.campaign.stopping


def campaign_recipe(targets: Iterable[Target]) -> Recipe:
    """Return the recipe by which worker processes make the service for campaigns with these targets.

    Each process runs a single campaign.
    """
    modules = dict.fromkeys(module for target in targets for module in evaluator_recipe(target).preload)
    name = f"{CampaignService.__module__}:{CampaignService.__qualname__}"
    return Recipe(name, preload=(*_PRELOAD, *modules), long_calls=True)


def campaign_request(config: CampaignConfig, folder: Path, workers: int, *, remote: bool) -> bytes:
    """Return the request for `CampaignService.run`; `workers` processes execute scenarios, or if 0, the campaign's own.

    A `remote` campaign may run on a machine without access to the folder, so the folder's contents are part of the
    request.
    """
    place = None if remote else str(folder.resolve())
    head = {"config": {**asdict(config)}, "folder": place, "workers": workers}
    return json.dumps(head).encode() + b"\n" + (pack(folder) if remote else b"")


def take_outcome(answer: bytes, folder: Path) -> Outcome:
    """Return the outcome in an answer. If the answer has a packed run folder, write its files to the run folder."""
    head, _, packed = answer.partition(b"\n")
    if packed:
        unpack(packed, folder)
    values: dict[str, Any] = json.loads(head)
    return Outcome(values["finished"], values["failure"], tuple(values["warnings"]))


def pack(folder: Path) -> bytes:
    """Return the regular files of a run folder as a tar archive; empty if there is no such folder."""
    if not folder.is_dir():
        return b""
    data = io.BytesIO()
    with tarfile.open(fileobj=data, mode="w") as archive:
        for path in sorted(folder.rglob("*")):
            if not path.is_file() or path.is_symlink() or path.suffix == ".lock":
                continue
            archive.add(path, path.relative_to(folder).as_posix(), recursive=False)
    return data.getvalue()


def unpack(packed: bytes, folder: Path) -> None:
    """Write the files of a packed run folder, each file atomically."""
    if not packed:
        return
    with TemporaryDirectory(dir=make_folder(folder.parent), prefix=".unpacking-") as scratch:
        with tarfile.open(fileobj=io.BytesIO(packed)) as archive:
            archive.extractall(scratch, filter="data")
        for path in sorted(path for path in Path(scratch).rglob("*") if path.is_file()):
            inner = path.relative_to(scratch)
            place = make_folder(folder, *inner.parent.parts) / inner.name
            path.replace(place)


def _to_json(outcome: Outcome) -> bytes:
    return json.dumps(asdict(outcome)).encode()


_LOOK_SECONDS: Final = 0.5  # interval at which the run folders are checked [s]


@dataclass(frozen=True)
class RunState:
    """State of a run."""

    executions: int  # number of stored executions
    finished: bool  # whether the run is complete


@dataclass(frozen=True)
class ExperimentProgress:
    """Progress of an experiment."""

    runs: int  # number of runs
    finished: int = 0  # number of finished runs
    failed: Mapping[PlannedRun, str] = field(default_factory=dict)  # failed runs, each with its reason
    executions: int = 0  # number of stored executions of all runs
    left: float | None = None  # estimated remaining time [s]; None if unknown
    warnings: tuple[str, ...] = ()  # warnings about the driving systems, one sentence each


def run_state(run: PlannedRun, root: Path) -> RunState:
    """Return the state of a run in the experiment's folder `root`.

    Raises:
        InputError: if the run folder holds another campaign, or one of another revision, or cannot be read.
    """
    folder = root / run.folder
    if not (folder / DATABASE).is_file():
        return RunState(0, finished=False)
    check_same_campaign(stored_config(folder).unverified, run, str(folder))
    with closing(Store.read(folder)) as store:
        count, ended = len(store), store.ended
    budget = int(run.config.budget)
    if count > budget:
        raise InputError(f"{folder} has {count} executions, more than the budget {budget}: choose another --out")
    return RunState(count, finished=count == budget or ended is not None)


def check_same_campaign(stored: CampaignConfig, run: PlannedRun, what: str) -> None:
    """Refuse a stored campaign that is not that of a run; `what` names it. Its budget may differ.

    Raises:
        InputError: if the campaign has another configuration or another revision.
    """
    check_revision(stored, what)
    if replace(stored, budget=run.config.budget) != run.config:
        raise InputError(f"{what} holds a campaign with a different configuration: choose another --out")


class ExperimentRunner:
    """Executes the unfinished runs of an experiment.

    Args:
        runs: all runs of the experiment, in the order in which they are executed.
        root: folder of the experiment.
        jobs: number of runs at a time; on a cluster, the number of nodes, or 0 for one for each core.
        workers: number of processes that execute the scenarios of a run; if 0, its own process does.
        cluster: name of a cluster, see `behavexplor.execution.ray_cluster.parse_cluster`; empty for this machine.

    Raises:
        InputError: if the folder of a run holds something else; see `run_state`.
    """

    def __init__(self, runs: Sequence[PlannedRun], root: Path, jobs: int, workers: int, cluster: str = "") -> None:
        self._root = root
        self._jobs, self._workers, self._cluster = jobs, workers, cluster
        states = {run: run_state(run, root) for run in runs}
        self._ads = tuple(dict.fromkeys(run.ads for run in runs))
        self._waiting = deque(run for run in runs if not states[run].finished)
        self._running: dict[Future[bytes], PlannedRun] = {}
        self._executions = {run: states[run].executions for run in runs}
        self._at_start = sum(self._executions.values())
        self._start = time.monotonic()
        self._open = {run: int(run.config.budget) - states[run].executions for run in self._waiting}
        self.progress = ExperimentProgress(len(runs), finished=len(runs) - len(self._waiting))
        self.stopping = False  # whether `stop` has been called

    def stop(self) -> None:
        """End the running campaigns, each after its current execution."""
        self.stopping = True

    def run(self, observe: Callable[[ExperimentProgress], None]) -> ExperimentProgress:
        """Run until every run is finished or has failed, or until `stop` is called; return the progress at the end.

        `observe` is called regularly with the progress.
        """
        if not self._waiting:
            return self.progress
        executor, at_a_time = self._start_executor()
        told = False
        with executor:
            while self._running or (self._waiting and not self.stopping):
                if self.stopping and not told:
                    executor.stop()
                    told = True
                self._fill(executor, at_a_time)
                for future in wait(self._running, timeout=_LOOK_SECONDS, return_when=FIRST_COMPLETED).done:
                    self._end(self._running.pop(future), future)
                self._count()
                observe(self.progress)
        return self.progress

    def _start_executor(self) -> tuple[Executor, int]:
        """Start the executor of the campaigns. Return it and the number of campaigns that it runs at a time."""
        recipe, without_limit = campaign_recipe(run.config.target for run in self._waiting), math.inf
        if not self._cluster:
            return WorkerPool(self._jobs, recipe, without_limit, without_limit), self._jobs
        executor = RayExecutor(self._cluster, self._jobs, recipe, Limits(without_limit, without_limit), self._ads)
        return executor, executor.n_nodes

    def _fill(self, executor: Executor, at_a_time: int) -> None:
        while self._waiting and len(self._running) < at_a_time and not self.stopping:
            run = self._waiting.popleft()
            folder = make_folder(self._root, *run.folder.parts)
            if self._cluster:  # its contents are made on a node, and come here later
                remember(own_run(run.config, folder))
            request = campaign_request(run.config, folder, self._workers, remote=bool(self._cluster))
            self._running[executor.submit(RUN, request)] = run

    def _end(self, run: PlannedRun, future: Future[bytes]) -> None:
        """Record the outcome of a run."""
        if future.cancelled() or (self.stopping and future.exception()):  # a process may end before it can be stopped
            return
        folder, error = self._root / run.folder, future.exception()
        outcome = None if error else take_outcome(future.result(), folder)
        failure = str(error) if error else (outcome.failure if outcome else None)
        progress = self.progress
        if outcome is not None:
            warnings = dict.fromkeys((*progress.warnings, *outcome.warnings))
            progress = replace(progress, finished=progress.finished + outcome.finished, warnings=tuple(warnings))
        if failure is not None:
            progress = replace(progress, failed={**progress.failed, run: failure})
        self.progress = progress
        self._look(run)
        if failure is not None or (outcome is not None and outcome.finished):
            self._open[run] = 0

    def _look(self, run: PlannedRun) -> None:
        """Count the stored executions of a run."""
        with suppress(InputError), closing(Store.read(self._root / run.folder)) as store:  # the run may not have begun
            self._executions[run] = len(store)
            self._open[run] = int(run.config.budget) - self._executions[run]

    def _count(self) -> None:
        for run in self._running.values():
            self._look(run)
        done, left = sum(self._executions.values()), sum(self._open.values())
        rate = (done - self._at_start) / (time.monotonic() - self._start)
        self.progress = replace(self.progress, executions=done, left=left / rate if rate > 0 else None)
