"""Where scenarios are executed: in this process, or in worker processes.

An executor is a `concurrent.futures.Executor` to which `evaluate` is submitted: bytes go out, bytes come back,
whatever stands between. Results do not depend on the executor.
"""

import logging
import multiprocessing
import os
import signal
from collections.abc import Callable, Collection
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import suppress
from multiprocessing.connection import wait
from threading import Thread
from typing import Any, ParamSpec, TypeVar

from threadpoolctl import threadpool_limits

from behavexplor.health import health_warnings
from behavexplor.scenario import Scenario
from behavexplor.simulation import Simulation

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
    """
    try:
        return _simulation[0].run(Scenario.from_json(scenario.decode())).to_bytes()
    except SystemExit as error:  # or an ADS that calls sys.exit would end the campaign, and look like a success
        raise RuntimeError(f"the ADS or its environment called sys.exit({error.code!r})") from error


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


def make_executor(workers: int, env: str, ads: str, trust: Collection[str] = ()) -> Executor:
    """An executor for `evaluate`; this process must have begun already if there are no other workers.

    Args:
        workers: how many processes run scenarios; with 1 it is this one.
        env: see `Simulation`.
        ads: see `Simulation`.
        trust: see `Simulation`.
    """
    if workers == 1:
        return InProcessExecutor()
    methods = multiprocessing.get_all_start_methods()
    context: Any = multiprocessing.get_context("forkserver" if "forkserver" in methods else "spawn")
    if context.get_start_method() == "forkserver":
        context.set_forkserver_preload(["behavexplor.executor"])
    return ProcessPoolExecutor(workers, context, _begin_worker, (env, ads, trust))


def examine() -> list[str]:
    """What is wrong with the ADS of this process; see `behavexplor.health`."""
    return health_warnings(_simulation[0])


def warm_up(executor: Executor) -> list[str]:
    """Examine the ADS where it will run; what is compiled once and for all is ready afterwards, also for other workers.

    Returns:
        What is wrong with the ADS, a sentence each.
    """
    with suppress(Exception):  # an ADS that takes its process down will do so again, in an execution that counts
        return executor.submit(examine).result()
    return []


def available_cores() -> int:
    """How many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _begin_worker(env: str, ads: str, trust: Collection[str]) -> None:
    """Workers leave Ctrl-C to the campaign, use one thread each, and do not outlive it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_end_with_campaign, daemon=True).start()
    os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))
    logging.getLogger("behavexplor").setLevel(logging.ERROR)  # the campaign's own process has warned already
    begin(env, ads, trust)
    threadpool_limits(1)  # of what the ADS has loaded, too


def _end_with_campaign() -> None:
    """End this process when the campaign's process has ended, however it did."""
    campaign = multiprocessing.parent_process()
    if campaign is not None:
        wait([campaign.sentinel])
        os._exit(1)
