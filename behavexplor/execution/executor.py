"""Where scenarios are executed: in this process, or in worker processes.

An executor is a `concurrent.futures.Executor` to which `evaluate` is submitted: bytes go out, bytes come back,
whatever stands between. Results do not depend on the executor.
"""

import json
import os
from collections import deque
from collections.abc import Callable, Collection
from concurrent.futures import Executor, Future
from itertools import count
from typing import Final, ParamSpec, TypeVar, cast

from behavexplor.ads.loading import check_name, is_shipped
from behavexplor.data.scenario import Scenario
from behavexplor.errors import InputError
from behavexplor.execution.confinement import confine
from behavexplor.execution.fingerprint import identify
from behavexplor.execution.pool import WorkerPool
from behavexplor.execution.preflight import health_warnings
from behavexplor.execution.rollout import ADSError, LockStep
from behavexplor.execution.simulation import Simulation, compile_kernels
from behavexplor.execution.worker import Functions
from behavexplor.jit import keep_no_code

P = ParamSpec("P")
T = TypeVar("T")

LOCK_STEP: Final = 32  # episodes at a time in one process, at most

_simulation: list[Simulation] = []  # the one of this process, once it has begun to evaluate
_loose: list[str] = []  # what this process may still do although it is confined


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
    return _simulation[0].run(_scenario(scenario)).to_bytes()


def examine(_: bytes) -> bytes:
    """What is wrong with the ADS of this process, a JSON list of sentences; see `behavexplor.execution.preflight`."""
    loose = [f"This system cannot prevent that the ADS may {right}" for right in _loose]
    return json.dumps([*map(_explained, health_warnings(_simulation[0])), *loose]).encode()


FUNCTIONS: Final[Functions] = {function.__name__: function for function in (evaluate, examine, identify)}


class Evaluations:
    """`evaluate` for many scenarios in lock-step; see `behavexplor.execution.worker.Together`.

    Args:
        simulation: whose ADS drives.
        episodes: as many at a time as there are free now.
    """

    def __init__(self, simulation: Simulation, episodes: LockStep) -> None:
        self._simulation = simulation
        self._episodes = episodes
        self.capacity = episodes.free

    def begin(self, key: int, request: bytes) -> None:
        """Take one more scenario, as JSON in UTF-8.

        Raises:
            InputError: if it cannot be run here.
        """
        scenario = _scenario(request)
        self._simulation.logical.check(scenario)
        self._episodes.begin(key, scenario)

    def advance(self) -> list[tuple[int, bytes | None]]:
        """Have the ADS asked once; if it fails, all of its episodes have to be run alone."""
        try:
            return [(key, trace.to_bytes()) for key, trace in self._episodes.step()]
        except ADSError:
            return [(key, None) for key in self._episodes.give_up()]


def evaluations(simulation: Simulation) -> Evaluations | None:
    """The means to run many scenarios at a time; None where only one can run."""
    episodes = simulation.lock_step(LOCK_STEP)
    return None if episodes is None else Evaluations(simulation, episodes)


def prepare_worker(env: str, ads: str, trust: Collection[str], unconfined: bool) -> None:  # noqa: ARG001
    """Confine this process if the ADS is somebody else's program; see `behavexplor.execution.confinement`."""
    if not (unconfined or is_shipped(ads)):
        keep_no_code()
        _loose[:] = confine()


def compile_for_workers(env: str, ads: str, *, unconfined: bool) -> None:
    """Have the machine code ready before workers begin that are to be confined: they cannot keep what they compile."""
    if not (unconfined or is_shipped(ads)):
        compile_kernels(env)


def _begin_worker(env: str, ads: str, trust: Collection[str], unconfined: bool) -> Evaluations | None:  # noqa: ARG001
    try:
        return evaluations(begin(env, ads, trust))
    except InputError as error:
        raise InputError(_explained(str(error))) from None


def _explained(sentence: str) -> str:
    """With the cause that nobody would think of, if that may be it."""
    if "PermissionError" not in sentence:
        return sentence
    return f"{sentence}: an ADS may neither write files nor use the network, unless with --unconfined"


class InProcessExecutor(Executor):
    """Executes in this process: at once, or many scenarios in lock-step as soon as a result is asked for.

    Args:
        together: evaluates many scenarios at a time, if it can be done.
    """

    def __init__(self, together: Evaluations | None = None) -> None:
        self._together = together
        self._waiting: deque[tuple[_Driven, bytes]] = deque()
        self._running: dict[int, tuple[_Driven, bytes]] = {}
        self._keys = count()

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Call the function and return its result as a future, which is done or drives this executor till it is."""
        if self._together is not None and fn is evaluate:
            driven = _Driven(self.advance)
            self._waiting.append((driven, cast("bytes", args[0])))
            return cast("Future[T]", driven)
        future: Future[T] = Future()
        _settle(future, lambda: fn(*args, **kwargs))
        return future

    def advance(self) -> None:
        """Have the ADS asked once."""
        together = self._together
        if together is None:
            return
        while self._waiting and len(self._running) < together.capacity:
            self._begin(together, *self._waiting.popleft())
        for key, result in together.advance() if self._running else ():
            future, request = self._running.pop(key)
            if result is None:
                _settle(future, lambda: evaluate(request))  # noqa: B023 - called at once
            else:
                future.set_result(result)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Finish what was submitted if it is waited for, else leave it."""
        if cancel_futures:
            for future, _ in self._waiting:
                future.cancel()
            self._waiting.clear()
        while wait and (self._waiting or self._running):
            self.advance()

    def _begin(self, together: Evaluations, future: "_Driven", request: bytes) -> None:
        key = next(self._keys)
        try:
            together.begin(key, request)
        except Exception as error:
            future.set_exception(error)
            return
        self._running[key] = (future, request)


class _Driven(Future[bytes]):
    """A future whose result comes about only while somebody waits for it."""

    def __init__(self, advance: Callable[[], None]) -> None:
        super().__init__()
        self._advance = advance

    def result(self, timeout: float | None = None) -> bytes:
        """The result, once it is there; however long that takes."""
        while not self.done():
            self._advance()
        return super().result(timeout)


def _settle(future: Future[T], call: Callable[[], T]) -> None:
    """Give a future the outcome of a call."""
    try:
        future.set_result(call())
    except Exception as error:
        future.set_exception(error)


def _scenario(data: bytes) -> Scenario:
    return Scenario.from_json(data.decode())


def make_executor(
    workers: int,
    env: str,
    ads: str,
    trust: Collection[str] = (),
    time_limit: float = 300.0,
    memory_limit: float = 8.0,
    unconfined: bool = False,
) -> Executor:
    """An executor for `evaluate` and `examine`.

    Args:
        workers: how many processes run scenarios; with 0 it is this one, which must have begun already.
        env: see `Simulation`.
        ads: see `Simulation`.
        trust: see `Simulation`.
        time_limit: of one execution [s]; not in this process.
        memory_limit: of one worker [GiB]; not in this process.
        unconfined: whether an ADS that is not shipped with this package may write files and use the network; in this
            process it always may.

    Raises:
        InputError: if there is no such environment, or no ADS can have such a name.
    """
    if workers == 0:
        return InProcessExecutor(evaluations(_simulation[0]))
    check_name(ads)
    compile_for_workers(env, ads, unconfined=unconfined)
    limits = (time_limit, memory_limit)
    arguments = (env, ads, tuple(trust), unconfined)
    return WorkerPool(
        workers, FUNCTIONS, _begin_worker, arguments, *limits, together=evaluate.__name__, prepare=prepare_worker
    )


def warm_up(executor: Executor) -> list[str]:
    """Examine the ADS where it will run; what is compiled once and for all is ready afterwards, also for other workers.

    Returns:
        What is wrong with the ADS, a sentence each.

    Raises:
        InputError: if it cannot be made.
    """
    try:
        return list(json.loads(executor.submit(examine, b"").result()))
    except InputError:
        raise
    except Exception:  # an ADS that takes its process down will do so again, in an execution that counts
        return []


def available_cores() -> int:
    """How many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
