"""The start of executors: for one target or for any service, in this process, in workers or on a cluster.

Also what is asked of an executor before a campaign: its logical scenario, and checks of the ADS.
"""

import json
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from itertools import count
from typing import Any

from behavexplor.ads.interface import ADS
from behavexplor.ads.loading import check_name
from behavexplor.data.drawn_logical import DrawnLogicalScenario
from behavexplor.data.scenario import LogicalScenario
from behavexplor.data.target import Target
from behavexplor.errors import InputError, sentence
from behavexplor.execution.evaluator import LOGICAL, PREFLIGHT, evaluator_recipe, needs_confinement
from behavexplor.execution.executor import BATCHES, Executor
from behavexplor.execution.pool import WorkerPool
from behavexplor.execution.ray_cluster import Limits, RayExecutor
from behavexplor.execution.service import Batch, Recipe, Service
from behavexplor.execution.simulation import logical_scenario


def start_executor(
    target: Target, workers: int, cluster: str = "", recipe: Recipe | None = None, driver: ADS | None = None
) -> Executor:
    """Start the executor for the scenarios of a target.

    Args:
        target: the target.
        workers: greatest number of worker processes, or number of nodes of a cluster. 0 means this process, without
            limits of time and memory, or on a cluster one node for each core.
        cluster: name of a cluster, see `behavexplor.execution.ray_cluster.parse_cluster`; empty for this machine.
        recipe: recipe of the service; by default that of an `Evaluator` for the target.
        driver: a driver that exists in this process only, named by `target.ads`, and drives here: `workers` and
            `cluster` are then ignored.

    Raises:
        InputError: if the environment, the ADS or the cluster cannot be used, or if an ADS that must be confined
            would run in this process.
    """
    recipe = recipe or evaluator_recipe(target)
    if driver is not None:
        return _start_here(recipe, driver)
    check_name(target.ads)
    if cluster:
        limits = Limits(target.time_limit, target.memory_limit)
        return RayExecutor(cluster, workers, recipe, limits, (target.ads,))
    if workers < fewest_workers(target):
        raise InputError(
            f"--workers 0 would run {target.ads!r} in this process, which cannot be confined: use --workers 1, or let "
            "the driver write files and use the network with --unconfined"
        )
    if workers == 0:
        return _start_here(recipe)
    return WorkerPool(workers, recipe, target.time_limit, target.memory_limit)


def _start_here(recipe: Recipe, driver: ADS | None = None) -> Executor:
    """Start the executor of a service in this process. With a `driver`, it is an `Evaluator`, which gets it."""
    service: Any = recipe.make()
    if driver is not None:
        service.driver = driver
    service.begin()
    return InProcessExecutor(service, recipe.batched)


def fewest_workers(target: Target) -> int:
    """Return the least number of workers: 1 if the ADS must be confined, which only a process of its own can be."""
    return int(needs_confinement(target))


def logical_of_target(executor: Executor, env: str) -> LogicalScenario:
    """Return the logical scenario of a target, whose configuration may depend on what the ADS declares.

    Raises:
        InputError: if the ADS or the environment cannot be loaded.
    """
    try:
        described = executor.submit(LOGICAL, b"").result()
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"The driving system ended its process while it was loaded: {error}") from error
    return DrawnLogicalScenario.from_json(described.decode()) if described else logical_scenario(env)


def check_ads(executor: Executor, meanwhile: Callable[[], None] = lambda: None) -> list[str]:
    """Check the ADS in the place where it will run. This also compiles the kernels for all workers.

    `meanwhile` is work to do in this process while the ADS is loaded in another one. Return warnings, each of them a
    printable sentence.

    Raises:
        InputError: if the ADS cannot be loaded.
    """
    checking = executor.submit(PREFLIGHT, b"")
    meanwhile()
    try:
        return [sentence(str(warning)) for warning in json.loads(checking.result())]
    except InputError:
        raise
    except Exception:  # an ADS that ends its process will do so again in the campaign, where it is recorded
        return []


class InProcessExecutor(Executor):
    """Calls the functions of a service in this process, the `batched` one in batches, see `Recipe`.

    The service has begun.
    """

    runs_here = True

    def __init__(self, service: Service, batched: str = "") -> None:
        self._functions = service.functions
        self._batched = batched
        self._batch = service.batch
        self._waiting: deque[tuple[_DrivenFuture, bytes]] = deque()
        self._running: dict[int, tuple[_DrivenFuture, bytes]] = {}
        self._keys = count()

    @property
    def room(self) -> int:  # type: ignore[override]
        """Number of further calls for the batch; see `Executor`."""
        capacity = self._batch.capacity if self._batch else 0
        return BATCHES * capacity - len(self._waiting) - len(self._running)

    def submit(self, function: str, data: bytes) -> "Future[bytes]":
        """Call a function at once, or in a batch that advances while the result is waited for."""
        if self._batch is not None and function == self._batched:
            driven = _DrivenFuture(self.advance)
            self._waiting.append((driven, data))
            return driven
        future: Future[bytes] = Future()
        self._settle(future, function, data)
        return future

    def advance(self) -> None:
        """Advance the batch by one step."""
        batch = self._batch
        if batch is None:
            return
        while self._waiting and len(self._running) < batch.capacity:
            self._begin(batch, *self._waiting.popleft())
        for key, result in batch.advance() if self._running else ():
            future, data = self._running.pop(key)
            if result is None:
                self._settle(future, self._batched, data)
            elif isinstance(result, Exception):
                future.set_exception(result)
            else:
                future.set_result(result)

    def stop(self) -> None:
        """Cancel the calls that have not started."""
        for future, _ in self._waiting:
            future.cancel()
        self._waiting.clear()

    def shutdown(self, *, wait: bool = True) -> None:
        """Finish all calls if `wait`, else cancel the calls that have not started."""
        if not wait:
            self.stop()
        while wait and (self._waiting or self._running):
            self.advance()

    def _begin(self, batch: Batch, future: "_DrivenFuture", data: bytes) -> None:
        key = next(self._keys)
        try:
            batch.begin(key, data)
        except Exception as error:
            future.set_exception(error)
            return
        self._running[key] = (future, data)

    def _settle(self, future: "Future[bytes]", function: str, data: bytes) -> None:
        """Make a call and set its outcome on a future."""
        try:
            future.set_result(self._functions[function](data))
        except Exception as error:
            future.set_exception(error)


class _DrivenFuture(Future[bytes]):
    """A future that drives the executor while its result is waited for."""

    def __init__(self, advance: Callable[[], None]) -> None:
        super().__init__()
        self._advance = advance

    def result(self, timeout: float | None = None) -> bytes:
        """Return the result; the timeout does not limit the wait."""
        while not self.done():
            self._advance()
        return super().result(timeout)
