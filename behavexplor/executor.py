"""Where scenarios are executed: in this process, or in worker processes.

An executor is a `concurrent.futures.Executor` to which `evaluate` is submitted: bytes go out, bytes come back,
whatever stands between. Results do not depend on the executor.
"""

import json
import os
from collections.abc import Callable, Collection
from concurrent.futures import Executor, Future
from contextlib import suppress
from typing import ParamSpec, TypeVar

from behavexplor.health import health_warnings
from behavexplor.scenario import Scenario
from behavexplor.simulation import Simulation
from behavexplor.workers import WorkerPool

P = ParamSpec("P")
T = TypeVar("T")

_simulation: list[Simulation] = []  # the one of this process, once it has begun to evaluate


def begin(env: str, ads: str, trust: Collection[str] = ()) -> Simulation:
    """Make this process ready to evaluate scenarios; see `Simulation`.

    Raises:
        InputError: see `Simulation`.
    """
    _simulation[:] = [Simulation(env, ads, trust)]
    return _simulation[0]


def evaluate(scenario: bytes) -> bytes:
    """Run a scenario.

    Args:
        scenario: as JSON in UTF-8.

    Returns:
        The trace, as `Trace.to_bytes` gives it.

    Raises:
        ADSError: for what the ADS has done instead of driving.
    """
    return _simulation[0].run(Scenario.from_json(scenario.decode())).to_bytes()


def examine(_: bytes) -> bytes:
    """What is wrong with the ADS of this process, a JSON list of sentences; see `behavexplor.health`."""
    return json.dumps(health_warnings(_simulation[0])).encode()


class InProcessExecutor(Executor):
    """Executes at once, in this process."""

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Call the function and return its result as a future that is done."""
        future: Future[T] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


def make_executor(
    workers: int,
    env: str,
    ads: str,
    trust: Collection[str] = (),
    time_limit: float = 300.0,
    memory_limit: float = 8.0,
) -> Executor:
    """An executor for `evaluate`.

    Args:
        workers: how many processes run scenarios; with 0 it is this one, which must have begun already.
        env: see `Simulation`.
        ads: see `Simulation`.
        trust: see `Simulation`.
        time_limit: of one execution [s]; not in this process.
        memory_limit: of one worker [GiB]; not in this process.
    """
    if workers == 0:
        return InProcessExecutor()
    functions = {"evaluate": evaluate, "examine": examine}
    return WorkerPool(workers, functions, begin, (env, ads, tuple(trust)), time_limit, memory_limit)


def warm_up(executor: Executor) -> list[str]:
    """Examine the ADS where it will run; what is compiled once and for all is ready afterwards, also for other workers.

    Returns:
        What is wrong with the ADS, a sentence each.
    """
    with suppress(Exception):  # an ADS that takes its process down will do so again, in an execution that counts
        return list(json.loads(executor.submit(examine, b"").result()))
    return []


def available_cores() -> int:
    """How many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
