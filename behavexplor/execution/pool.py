"""The parent's side of the process boundary: supervised worker processes.

If an ADS crashes or blocks one worker, the campaign and the other workers go on.
"""

import math
import multiprocessing
import os
import signal
import socket
import struct
import sys
import time
from collections import deque
from collections.abc import Iterable, Mapping
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from itertools import count
from multiprocessing.connection import Connection, wait
from tempfile import TemporaryDirectory
from threading import Lock, Thread
from typing import Any, Final

from behavexplor.errors import InputError, described
from behavexplor.execution.demand import AwaitedFuture, Demand
from behavexplor.execution.executor import BATCHES, ADSError, Executor
from behavexplor.execution.forkserver import CAN_SHARE, clean_start, share_imports
from behavexplor.execution.messages import READY, STARTED, SUSPECT, Request, answers_in, packed, settle
from behavexplor.execution.service import Recipe
from behavexplor.execution.worker import CLOSED, serve
from behavexplor.execution.worker_output import CAN_LEAVE, WorkerOutput

BEGIN_SECONDS: Final = 600.0  # time limit for a worker to get ready [s]
CRASHES: Final = 2  # an ADS is blamed after this many worker crashes during the same single execution
MOST_BYTES: Final = 2**29  # of an answer; a trace has at most 450 MB
PAUSE_SECONDS: Final = 10  # greatest pause within an answer [s]
ENDING_SECONDS: Final = 2.0  # time limit for the end of a worker that has closed its connection [s]


class WorkerDiedError(RuntimeError):
    """A worker ended while its ADS was not running: an error of this package or of the environment."""


@dataclass(eq=False)
class _Task:
    """A call that has not been answered."""

    future: Future[Any]
    function: str  # name of the function
    data: bytes  # its argument
    alone: bool  # whether the call needs a worker to itself
    crashes: int = 0  # number of workers that died while they processed only this call


class WorkerPool(Executor):
    """Calls functions of a service in worker processes. A process that dies or hangs is replaced.

    One thread supervises all workers. The first one compiles the kernels for all. Others start when there are more
    calls than the running ones can process in `BATCHES` batches, or when the caller waits for results most of the time.
    For a service that is fast compared with its caller, a single worker with a full batch is faster than several.

    When a batch fails, it is unknown which of its calls is to blame. Each call is then made again alone, so that its
    outcome does not depend on the other calls.

    Args:
        n_workers: greatest number of processes.
        recipe: recipe of the service of each process.
        time_limit: time limit [s]. It applies to a call that has a worker to itself, and to the time between two
            answers of a worker that processes a batch. A process that exceeds it is killed.
        memory_limit: memory limit of one process [GiB], where the system supports it.
    """

    def __init__(self, n_workers: int, recipe: Recipe, time_limit: float, memory_limit: float) -> None:
        share_imports(recipe.preload)
        service = recipe.make()
        service.prepare()
        self._recipe = recipe
        self._folder = TemporaryDirectory(prefix="behavexplor-", ignore_cleanup_errors=True)
        self._serving = (recipe, memory_limit, self._folder.name, service.is_confined)
        self._time_limit = time_limit
        self._keys = count()
        self._demand = Demand()
        self._lock = Lock()  # guards the following fields, which submitting threads change
        self._waiting: deque[_Task] = deque()
        self._closed = self._aborted = self._stopped = False
        self._failed = ""  # why the pool has ended by itself
        self._is_woken = False  # whether the supervising thread has been woken, and has not looked yet
        self._woken, self._wake = multiprocessing.Pipe(duplex=False)
        self._workers: list[_Worker | None] = [None] * n_workers
        self._thread = Thread(target=self._supervise, daemon=True)
        self._thread.start()

    def submit(self, function: str, data: bytes) -> "Future[bytes]":
        """Call a function as soon as a worker is free; see `Executor.submit`."""
        alone = function != self._recipe.batched
        future: Future[bytes] = Future() if alone else AwaitedFuture(self._demand)
        with self._lock:
            if self._failed:
                future.set_exception(WorkerDiedError(self._failed))
                return future
            if self._closed:
                raise RuntimeError("the workers have been shut down")
            self._waiting.append(_Task(future, function, data, alone))
        self._interrupt()
        return future

    @property
    def room(self) -> int:  # type: ignore[override]
        """Number of further calls for the workers that are ready; see `Executor`."""
        workers = [worker for worker in self._workers if worker]
        calls = len(self._waiting) + sum(len(worker.tasks) for worker in workers)
        return BATCHES * sum(worker.capacity for worker in workers if worker.is_ready) - calls

    def stop(self) -> None:
        """Cancel calls that have not started, and ask running calls to end early."""
        with self._lock:
            self._stopped = True
            self._cancel_waiting()
        for worker in self._workers:
            if worker is not None:
                worker.stop()

    def shutdown(self, *, wait: bool = True) -> None:
        """Shut the workers down: after all calls if `wait`, else at once."""
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
        """Wake the supervising thread, unless it will look anyway."""
        if self._is_woken:
            return
        self._is_woken = True
        with suppress(OSError):  # the pool was shut down before
            self._wake.send_bytes(b"")

    def _supervise(self) -> None:
        """Hand out calls and listen to the workers until all calls are done."""
        try:
            while not self._aborted and not self._is_done():
                self._start_others()
                self._hand_out()
                started = [worker for worker in self._workers if worker]
                busy = {worker.connection: worker for worker in started if worker.is_listened_to}
                pipes = [worker.output for worker in started if worker.output]
                outputs = {output.connection: output for output in pipes if not output.connection.closed}
                deadline = min((worker.deadline for worker in busy.values()), default=None)
                patience = None if deadline in (None, math.inf) else max(deadline - time.monotonic(), 0.0)
                ready = set(wait([self._woken, *busy, *outputs], patience))
                if self._woken in ready:
                    self._woken.recv_bytes()
                    self._is_woken = False
                for connection, worker in busy.items():
                    self._listen(worker, answered=connection in ready)
                for connection, output in outputs.items():
                    if connection in ready:
                        output.pass_on()
        except OSError as error:  # the system is out of processes, files or memory
            self._failed = f"no worker could be started: {error}"
        except Exception as error:
            self._failed = f"the supervision of the workers has failed: {described(error)}"
            raise
        finally:
            with self._lock:
                self._failed = self._failed or ("" if self._closed else "the workers have failed")
                left, self._waiting = list(self._waiting), deque()
            for worker in filter(None, self._workers):
                worker.kill()
                _fail(worker.tasks.values(), WorkerDiedError(self._failed or "the workers have been shut down"))
            left = [task for task in left if self._failed or not task.future.cancel()]
            _fail(left, WorkerDiedError(self._failed or "it was not run again"))
            self._wake.close()
            self._woken.close()
            self._folder.cleanup()

    def _is_done(self) -> bool:
        return self._closed and not self._waiting and not any(worker and worker.tasks for worker in self._workers)

    def _hand_out(self) -> None:
        """Give waiting calls to workers in order. A call that needs a worker to itself holds up the calls behind it."""
        while True:
            with self._lock:  # another thread may cancel the calls
                place, room = self._free_place(alone=self._waiting[0].alone) if self._waiting else (None, 0)
            if place is None:
                return
            worker = self._workers[place] = self._workers[place] or _Worker(*self._serving)
            with self._lock:
                if not self._waiting:
                    return
                tasks = [self._waiting.popleft()]
                while len(tasks) < room and self._waiting and not self._waiting[0].alone:
                    tasks.append(self._waiting.popleft())
            begun = {}
            for task in tasks:
                if task.future.running() or task.future.set_running_or_notify_cancel():
                    begun[next(self._keys)] = task
            if begun:
                worker.ask(begun, self._time_limit)

    def _free_place(self, *, alone: bool) -> tuple[int | None, int]:
        """Return the place of the least busy worker that can take more calls, None if all are busy; and how many.

        A place without a worker is free if the call needs a worker to itself, or if there is no worker at all.
        """
        loads = [len(worker.tasks) if worker else 0 for worker in self._workers]
        started = [worker is not None for worker in self._workers]
        ready = [worker is not None and worker.is_ready for worker in self._workers]
        if alone or not any(started):
            free = {place: 1 for place, load in enumerate(loads) if load == 0}
        else:
            usable = ready if any(ready) else started
            share = -(-(sum(loads) + len(self._waiting)) // sum(usable))
            places = [(place, worker) for place, worker in enumerate(self._workers) if worker and usable[place]]
            rooms = {place: worker.room(share) for place, worker in places}
            free = {place: room for place, room in rooms.items() if room > 0}
        place = min(free, key=lambda place: (loads[place], not ready[place], not started[place]), default=None)
        return (None, 0) if place is None else (place, free[place])

    def _listen(self, worker: "_Worker", *, answered: bool) -> None:
        """Process a worker's answer, its death or its timeout."""
        try:
            message = worker.message(self._time_limit) if answered else None
        except (EOFError, OSError):
            self._lost(worker, "crash", worker.ending())
            return
        if message is not None:
            try:
                for answer in answers_in(message):
                    self._take(worker, *answer)
            except (KeyError, ValueError, RecursionError):  # the ADS has written to the pipe
                self._lost(worker, "crash", "its process sent what is no answer")
        elif time.monotonic() > worker.deadline:
            self._lost(worker, "hang", f"no answer within {worker.patience:g} s")

    def _take(self, worker: "_Worker", key: int, answer: bytes) -> None:
        tag, content = answer[:1], answer[1:]
        if tag == READY and not worker.is_ready:
            worker.capacity, worker.is_ready = int(content), True
            self._demand.measure_anew()
        elif not worker.is_ready:
            _fail(worker.tasks.values(), InputError(content.decode()))
            self._remove(worker)
        elif tag == SUSPECT and not worker.tasks[key].alone:  # otherwise it is no answer
            self._again([worker.tasks.pop(key)])
        else:
            settle(worker.tasks[key].future, answer)  # raises if it is no answer; its call must stay then
            del worker.tasks[key]
            if self._recipe.long_calls:
                self._remove(worker)

    def _start_others(self) -> None:
        """Start other workers if there is work for them, once the first one has compiled the kernels for all."""
        workers = [worker for worker in self._workers if worker]
        ready = [worker for worker in workers if worker.is_ready]
        if self._recipe.long_calls or not ready or len(workers) == len(self._workers):
            return
        calls = len(self._waiting) + sum(len(worker.tasks) for worker in workers)
        capacity = max(worker.capacity for worker in ready)
        calls_of_worker = capacity if capacity == 1 else BATCHES * capacity  # without batches, none waits in a worker
        wanted = math.ceil(calls / calls_of_worker)
        if self._demand.is_high and len(ready) == len(workers):
            wanted = max(wanted, 2 * len(workers))
        for place, worker in enumerate(self._workers):
            if worker is None and len(workers) < wanted:
                self._workers[place] = started = _Worker(*self._serving)
                workers.append(started)

    def _lost(self, worker: "_Worker", kind: str, message: str) -> None:
        """Remove a worker that has died or hangs, and repeat or fail its calls."""
        is_ads_to_blame = bool(worker.asking.value) or (kind == "crash" and (worker.is_confined or worker.has_closed()))
        self._remove(worker)
        tasks = list(worker.tasks.values())
        if worker.capacity == 1 or worker.is_alone:
            for task in tasks:
                task.crashes += 1
            if kind == "hang" or not worker.is_ready or any(task.crashes >= CRASHES for task in tasks):
                _fail(tasks, _error(worker, kind, message, is_ads_to_blame=is_ads_to_blame))
                return
        self._again(tasks)

    def _again(self, tasks: list[_Task]) -> None:
        """Make calls again, each with a worker to itself, unless calls have been asked to end early."""
        if self._stopped:
            _fail(tasks, WorkerDiedError("a worker ended before its call could end early"))
            return
        for task in tasks:
            task.alone = True
        with self._lock:
            self._waiting.extendleft(reversed(tasks))

    def _remove(self, worker: "_Worker") -> None:
        worker.kill()
        self._workers[self._workers.index(worker)] = None


class _Worker:
    """One worker process, and the supervisor's end of the pipe to it."""

    def __init__(self, recipe: Recipe, memory_limit: float, folder: str, is_confined: bool) -> None:
        context: Any = multiprocessing.get_context("forkserver" if CAN_SHARE else "spawn")
        self.connection: Connection
        self.connection, theirs = context.Pipe()
        self.asking = context.RawValue("b", 0)  # shared; 1 while the worker calls its ADS, see `asking.share_asking`
        self._together = recipe.together
        self.is_confined = is_confined  # third-party code runs in it, which is to blame if it dies at any time
        self.output = WorkerOutput() if is_confined and CAN_LEAVE else None  # others print on our terminal
        pipe = self.output.theirs if self.output else None
        arguments = (theirs, self.asking, recipe, memory_limit, folder, dict(os.environ), pipe)
        self._process = context.Process(target=serve, args=arguments, daemon=not recipe.long_calls)
        with clean_start():
            self._process.start()
        theirs.close()
        _limit_waiting(self.connection)
        if pipe is not None:
            pipe.close()
        with suppress(OSError):  # the worker has died, which `_listen` will notice
            self.connection.send_bytes(STARTED)
        self.tasks: dict[int, _Task] = {}  # unanswered calls by key
        self.capacity = 1  # number of calls that it can process in one batch
        self.is_ready = False  # whether it has loaded its service
        self.patience = math.inf  # time limit for the next answer [s]
        self.deadline = math.inf  # time at which the answer is overdue, on the monotonic clock [s]
        self._wait_for(BEGIN_SECONDS)

    @property
    def is_listened_to(self) -> bool:
        """True if an answer of the worker is due."""
        return bool(self.tasks) or not self.is_ready

    @property
    def is_alone(self) -> bool:
        """True if the worker processes a call that needs it to itself."""
        return any(task.alone for task in self.tasks.values())

    def room(self, share: int) -> int:
        """Return how many more calls the worker can take beside others, up to a share of all calls; none if below 1."""
        if self.is_alone:
            return 0
        # answers may wait in the worker for others, to be sent together; their places in the batch are free already
        unsent = self._together - 1 if self.capacity > 1 else 0
        return min(self.capacity + unsent, share) - len(self.tasks)

    def ask(self, tasks: Mapping[int, _Task], time_limit: float) -> None:
        """Send calls to the worker, by their keys."""
        if self.is_ready and not self.tasks:
            self._wait_for(time_limit)
        self.tasks.update(tasks)
        requests = [Request(key, one.function, one.alone, one.data).to_bytes() for key, one in tasks.items()]
        with suppress(OSError):  # the worker has died, which `_listen` will notice
            self.connection.send_bytes(packed(requests))

    def message(self, time_limit: float) -> bytes:
        """Receive a message with answers; EOFError or OSError if the process has died."""
        message = self.connection.recv_bytes(MOST_BYTES)
        self._wait_for(time_limit)
        return message

    def has_closed(self) -> bool:
        """Return whether the worker lost its connection because the ADS closed it.

        In that case the process exits with the code `CLOSED`, or still runs.
        """
        self._process.join(ENDING_SECONDS)
        return self._process.exitcode in (CLOSED, None)

    def ending(self) -> str:
        """Describe how the process ended."""
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
        """Kill the process, with the children of a confined one, and close the pipes."""
        if self.output is not None and self._process.is_alive():
            with suppress(ProcessLookupError):  # it has no group of its own yet
                os.killpg(self._process.pid, signal.SIGKILL)
        self._process.kill()
        self._process.join()
        self.connection.close()
        if self.output is not None:
            self.output.pass_on(ended=True)

    def _wait_for(self, seconds: float) -> None:
        self.patience, self.deadline = seconds, time.monotonic() + seconds


def _limit_waiting(connection: Connection) -> None:
    """Let the reading of a message fail if the rest of it does not come, where the connection is a socket."""
    if sys.platform == "win32":
        return
    with socket.socket(fileno=os.dup(connection.fileno())) as same:
        same.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("ll", PAUSE_SECONDS, 0))


def _error(worker: _Worker, kind: str, message: str, *, is_ads_to_blame: bool) -> Exception:
    """Return the exception for the calls of a lost worker."""
    if not worker.is_ready:
        return InputError(f"The ADS cannot be loaded: {message}")
    return ADSError(kind, message) if is_ads_to_blame else WorkerDiedError(f"a worker ended: {message}")


def _fail(tasks: Iterable[_Task], error: Exception) -> None:
    for task in tasks:
        if task.future.running() or task.future.set_running_or_notify_cancel():
            task.future.set_exception(error)
