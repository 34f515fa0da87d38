"""The parent's side of the process boundary: worker processes under supervision.

The campaign and the other workers go on whatever an ADS does in one of them.
"""

import math
import multiprocessing
import signal
import time
from collections import deque
from collections.abc import Iterable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from itertools import count
from multiprocessing.connection import Connection, wait
from tempfile import TemporaryDirectory
from threading import Lock, Thread
from typing import Any, Final

from behavexplor.errors import InputError
from behavexplor.execution.executor import Executor
from behavexplor.execution.messages import READY, SUSPECT, Request, settle, split_key
from behavexplor.execution.rollout import ADSError
from behavexplor.execution.service import Recipe
from behavexplor.execution.worker import CLOSED, serve

BEGIN_SECONDS: Final = 600.0  # in which a worker must be ready [s]
CRASHES: Final = 2  # of a process that an execution has to itself, until they are laid to its ADS
ENDING_SECONDS: Final = 2.0  # in which a worker that has closed its connection must have ended [s]


class WorkerDiedError(RuntimeError):
    """A worker ended while its ADS was not being asked: an error of ours, or of the environment."""


@dataclass(eq=False)
class _Task:
    """A call that has not been answered.

    Attributes:
        future: of its result.
        function: by name.
        data: that it is called on.
        alone: whether it needs a worker to itself.
        crashes: how many workers have died while they had nothing else to do.
    """

    future: Future[Any]
    function: str
    data: bytes
    alone: bool
    crashes: int = 0


class WorkerPool(Executor):
    """Calls functions of a service in worker processes, each of which is replaced when it dies or hangs.

    One thread supervises all workers. If a call fails in a batch, it is unknown which call of the batch is to blame:
    each of them is made again alone, so that its outcome does not depend on the others.

    Args:
        n_workers: number of processes.
        recipe: how each process makes its service.
        time_limit: limit of one call that has a worker to itself, and of the time between two answers of other workers
            [s]. The process is killed after it.
        memory_limit: limit of one process [GiB], where the system can set it.
    """

    def __init__(self, n_workers: int, recipe: Recipe, time_limit: float, memory_limit: float) -> None:
        recipe.make().prepare()
        self._recipe = recipe
        self._folder = TemporaryDirectory(prefix="behavexplor-", ignore_cleanup_errors=True)
        self._serving = (recipe, memory_limit, self._folder.name)
        self._time_limit = time_limit
        self._keys = count()
        self._lock = Lock()  # of what follows, which is changed by those who submit
        self._waiting: deque[_Task] = deque()
        self._closed = self._aborted = False
        self._woken, self._wake = multiprocessing.Pipe(duplex=False)
        self._workers: list[_Worker | None] = [None] * n_workers
        self._thread = Thread(target=self._supervise, daemon=True)
        self._thread.start()

    def submit(self, function: str, data: bytes) -> "Future[bytes]":
        """Call a function as soon as a worker is free; see `Executor.submit`."""
        future: Future[bytes] = Future()
        with self._lock:
            if self._closed:
                raise RuntimeError("the workers have been shut down")
            self._waiting.append(_Task(future, function, data, alone=function != self._recipe.batched))
        self._interrupt()
        return future

    def stop(self) -> None:
        """Cancel calls that have not begun, and ask the others to end early."""
        with self._lock:
            self._cancel_waiting()
        for worker in self._workers:
            if worker is not None:
                worker.stop()

    def shutdown(self, *, wait: bool = True) -> None:
        """End the workers: after all calls if `wait`, else at once."""
        with self._lock:
            self._closed = True
            self._aborted = not wait
            if not wait:
                self._cancel_waiting()
        self._interrupt()
        self._thread.join()

    def _cancel_waiting(self) -> None:
        self._waiting = deque(task for task in self._waiting if not task.future.cancel())

    def _interrupt(self) -> None:
        """Have the supervising thread look at what is new."""
        with suppress(OSError):  # the pool was shut down before
            self._wake.send_bytes(b"")

    def _supervise(self) -> None:
        """Hand out calls and listen to the workers, until all is done."""
        try:
            while not self._aborted and not self._is_done():
                self._hand_out()
                busy = {worker.connection: worker for worker in self._workers if worker and worker.is_listened_to}
                deadline = min((worker.deadline for worker in busy.values()), default=None)
                patience = None if deadline in (None, math.inf) else max(deadline - time.monotonic(), 0.0)
                ready = set(wait([self._woken, *busy], patience))
                if self._woken in ready:
                    self._woken.recv_bytes()
                for connection, worker in busy.items():
                    self._listen(worker, answered=connection in ready)
        finally:
            for worker in filter(None, self._workers):
                worker.kill()
                _fail(worker.tasks.values(), WorkerDiedError("the workers have been shut down"))
            _fail([task for task in self._waiting if not task.future.cancel()], WorkerDiedError("it was not run again"))
            self._wake.close()
            self._woken.close()
            self._folder.cleanup()

    def _is_done(self) -> bool:
        return self._closed and not self._waiting and not any(worker and worker.tasks for worker in self._workers)

    def _hand_out(self) -> None:
        """Give waiting calls to workers, in their order; one that needs a worker to itself holds up the others."""
        while self._waiting:
            place = self._free_place(alone=self._waiting[0].alone)
            if place is None:
                return
            with self._lock:
                if not self._waiting:
                    return
                task = self._waiting.popleft()
            if not task.future.running() and not task.future.set_running_or_notify_cancel():
                continue
            worker = self._workers[place] or _Worker(*self._serving)
            self._workers[place] = worker
            worker.ask(next(self._keys), task, self._time_limit)

    def _free_place(self, *, alone: bool) -> int | None:
        """Where the worker stands that has the least to do, if it can take one more call; None if there is none."""
        loads = [len(worker.tasks) if worker else 0 for worker in self._workers]
        share = -(-(sum(loads) + len(self._waiting)) // len(loads))
        free = []
        for place, worker in enumerate(self._workers):
            in_company = worker is not None and not alone and not worker.is_alone
            if loads[place] == 0 or (worker and in_company and loads[place] < min(worker.capacity, share)):
                free.append(place)
        return min(free, key=lambda place: loads[place], default=None)

    def _listen(self, worker: "_Worker", *, answered: bool) -> None:
        """Take a worker's answer, if it has given one, or has died, or takes too long."""
        try:
            if answered:
                self._take(worker, *worker.answer(self._time_limit))
            elif time.monotonic() > worker.deadline:
                self._lost(worker, "hang", f"no answer within {worker.patience:g} s")
        except (EOFError, OSError):
            self._lost(worker, "crash", worker.ending())

    def _take(self, worker: "_Worker", key: int, answer: bytes) -> None:
        tag, content = answer[:1], answer[1:]
        if tag == READY:
            worker.capacity, worker.is_ready = int(content), True
        elif not worker.is_ready:
            _fail(worker.tasks.values(), InputError(content.decode()))
            self._remove(worker)
        elif tag == SUSPECT:
            self._again([worker.tasks.pop(key)])
        else:
            settle(worker.tasks.pop(key).future, answer)
            if self._recipe.long_calls:
                self._remove(worker)

    def _lost(self, worker: "_Worker", kind: str, message: str) -> None:
        """Replace a worker that has died, or must."""
        was_asking = bool(worker.asking.value) or (kind == "crash" and worker.has_closed())
        self._remove(worker)
        tasks = list(worker.tasks.values())
        if worker.capacity == 1 or worker.is_alone:
            for task in tasks:
                task.crashes += 1
            if kind == "hang" or not worker.is_ready or any(task.crashes >= CRASHES for task in tasks):
                _fail(tasks, _error(worker, kind, message, was_asking=was_asking))
                return
        self._again(tasks)

    def _again(self, tasks: list[_Task]) -> None:
        """Let calls be made once more, each with a worker to itself."""
        for task in tasks:
            task.alone = True
        with self._lock:
            self._waiting.extendleft(reversed(tasks))

    def _remove(self, worker: "_Worker") -> None:
        worker.kill()
        self._workers[self._workers.index(worker)] = None


class _Worker:
    """One process, and this end of the pipe to it.

    Attributes:
        tasks: that it works on, by key.
        capacity: how many it can work on together.
        is_ready: whether it has begun.
        asking: see `behavexplor.execution.rollout.share_asking`.
        patience: how long it may take until its next answer [s].
        deadline: of its next answer, on the monotonic clock [s].
    """

    def __init__(self, recipe: Recipe, memory_limit: float, folder: str) -> None:
        methods = multiprocessing.get_all_start_methods()
        context: Any = multiprocessing.get_context("forkserver" if "forkserver" in methods else "spawn")
        if context.get_start_method() == "forkserver":
            context.set_forkserver_preload(list(recipe.preload))
        self.connection: Connection
        self.connection, theirs = context.Pipe()
        self.asking = context.RawValue("b", 0)
        arguments = (theirs, self.asking, recipe, memory_limit, folder)
        self._process = context.Process(target=serve, args=arguments, daemon=not recipe.long_calls)
        self._process.start()
        theirs.close()
        self.tasks: dict[int, _Task] = {}
        self.capacity = 1
        self.is_ready = False
        self._wait_for(BEGIN_SECONDS)

    @property
    def is_listened_to(self) -> bool:
        """Whether an answer is due."""
        return bool(self.tasks) or not self.is_ready

    @property
    def is_alone(self) -> bool:
        """Whether it works on a call that needs it to itself."""
        return any(task.alone for task in self.tasks.values())

    def ask(self, key: int, task: _Task, time_limit: float) -> None:
        """Hand it a call."""
        if self.is_ready and not self.tasks:
            self._wait_for(time_limit)
        self.tasks[key] = task
        with suppress(OSError):  # it has died since; that shows when it is listened to
            self.connection.send_bytes(Request(key, task.function, task.alone, task.data).to_bytes())

    def answer(self, time_limit: float) -> tuple[int, bytes]:
        """The key of an answer, and the answer.

        Raises:
            EOFError: if the process has died.
            OSError: the same.
        """
        message = self.connection.recv_bytes()
        self._wait_for(time_limit)
        return split_key(message)

    def has_closed(self) -> bool:
        """Whether it has lost its connection, which nobody closes but an ADS: it has said so, or still runs."""
        self._process.join(ENDING_SECONDS)
        return self._process.exitcode in (CLOSED, None)

    def ending(self) -> str:
        """How the process has ended."""
        if self.has_closed():
            return "it closed the files of its process"
        code = self._process.exitcode
        if code is not None and code < 0:
            return f"its process was ended by {signal.Signals(-code).name}"
        return f"its process ended with exit code {code}"

    def stop(self) -> None:
        """Ask the service to end its call early."""
        self._process.terminate()

    def kill(self) -> None:
        """End the process, and release the pipe."""
        self._process.kill()
        self._process.join()
        self.connection.close()

    def _wait_for(self, seconds: float) -> None:
        self.patience, self.deadline = seconds, time.monotonic() + seconds


def _error(worker: _Worker, kind: str, message: str, *, was_asking: bool) -> Exception:
    """What the loss of a worker means."""
    if not worker.is_ready:
        return InputError(f"The ADS cannot be loaded: {message}")
    return ADSError(kind, message) if was_asking else WorkerDiedError(f"a worker ended: {message}")


def _fail(tasks: Iterable[_Task], error: Exception) -> None:
    for task in tasks:
        task.future.set_exception(error)
