"""Worker processes under supervision: whatever an ADS does in one, the campaign and the other workers go on."""

import json
import logging
import multiprocessing
import os
import queue
import signal
from collections.abc import Callable, Mapping
from concurrent.futures import Executor, Future
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from threading import Thread
from typing import Any, Final, ParamSpec, TypeVar, cast

from threadpoolctl import threadpool_limits

from behavexplor.errors import InputError
from behavexplor.rollout import ADSError, share_asking

try:
    import resource
except ImportError:  # Windows cannot limit a process so
    resource = None  # type: ignore[assignment]

P = ParamSpec("P")
T = TypeVar("T")

BEGIN_SECONDS: Final = 600.0  # in which a worker must be ready [s]
ENDING_SECONDS: Final = 2.0  # in which a worker that has closed its connection must have ended [s]
CLOSED: Final = 83  # exit code of a worker that finds its connection closed
RESULT, ADS_FAILED, FAILED = b"R", b"A", b"E"  # what an answer begins with

Serve = Mapping[str, Callable[[bytes], bytes]]


class WorkerDiedError(RuntimeError):
    """A worker ended while its ADS was not being asked: an error of ours, or of the environment."""


class WorkerPool(Executor):
    """Runs functions from bytes to bytes in worker processes, each of them replaced when it dies or hangs.

    What comes back from a worker is bytes; nothing of it is unpickled.

    Args:
        count: number of processes.
        functions: those that may be submitted, by name.
        begin: called first in each process.
        arguments: of `begin`.
        time_limit: of one call [s]; the process is killed after it.
        memory_limit: of one process [GiB], where the system can set it.
    """

    def __init__(
        self,
        count: int,
        functions: Serve,
        begin: Callable[..., object],
        arguments: tuple[Any, ...],
        time_limit: float,
        memory_limit: float,
    ) -> None:
        self._functions = functions
        self._names = {function: name for name, function in functions.items()}
        self._begin = (begin, arguments, memory_limit)
        self._time_limit = time_limit
        self._tasks: queue.SimpleQueue[tuple[Future[Any], bytes] | None] = queue.SimpleQueue()
        self._workers: dict[int, _Worker] = {}
        self._closed = False
        self._threads = [Thread(target=self._supervise, args=(place,), daemon=True) for place in range(count)]
        for thread in self._threads:
            thread.start()

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Call one of the functions on bytes, as soon as a worker is free.

        The future's exception is an `ADSError` for what the ADS has done, whatever that was.
        """
        if self._closed:
            raise RuntimeError("the workers have been shut down")
        if kwargs or len(args) != 1 or not isinstance(args[0], bytes):
            raise TypeError("a worker's function takes bytes and nothing else")
        name = self._names[cast("Callable[[bytes], bytes]", fn)]
        future: Future[T] = Future()
        self._tasks.put((future, name.encode() + b"\0" + args[0]))
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the workers: after their work if it is waited for, else at once."""
        self._closed = True
        if cancel_futures:
            with suppress(queue.Empty):
                while task := self._tasks.get_nowait():
                    task[0].cancel()
        for _ in self._threads:
            self._tasks.put(None)
        if wait:
            for thread in self._threads:
                thread.join()
        for worker in list(self._workers.values()):
            worker.stop()

    def _supervise(self, place: int) -> None:
        """Hand one task after the other to a worker."""
        while (task := self._tasks.get()) is not None:
            future, request = task
            if not future.set_running_or_notify_cancel():
                continue
            try:
                if place not in self._workers:
                    self._workers[place] = _Worker(self._functions, *self._begin)
                future.set_result(self._workers[place].ask(request, self._time_limit))
            except BaseException as error:
                future.set_exception(error)
            if place in self._workers and not self._workers[place].alive:
                self._workers.pop(place).kill()
        if place in self._workers:
            self._workers.pop(place).kill()


class _Worker:
    """One process, and this end of the pipe to it."""

    def __init__(
        self, functions: Serve, begin: Callable[..., object], arguments: tuple[Any, ...], memory_limit: float
    ) -> None:
        methods = multiprocessing.get_all_start_methods()
        context: Any = multiprocessing.get_context("forkserver" if "forkserver" in methods else "spawn")
        if context.get_start_method() == "forkserver":
            context.set_forkserver_preload(["behavexplor.executor"])
        self._connection, theirs = context.Pipe()
        self._asking = context.RawValue("b", 0)
        serving = (theirs, self._asking, functions, begin, arguments, memory_limit)
        self._process = context.Process(target=_serve, args=serving, daemon=True)
        self._process.start()
        theirs.close()
        self.alive = True
        self._answer(BEGIN_SECONDS)

    def ask(self, request: bytes, time_limit: float) -> bytes:
        """Have a request answered.

        Raises:
            ADSError: for what the ADS has done.
            WorkerDiedError: if the process died of something else.
            RuntimeError: for any other failure in the worker.
        """
        with suppress(OSError):  # it has died since; that shows when it is listened to
            self._connection.send_bytes(request)
        return self._answer(time_limit)

    def stop(self) -> None:
        """End the process at once; whoever waits for its answer is told that it died."""
        self._process.kill()

    def kill(self) -> None:
        """End the process and release the pipe; only for the thread that asks it."""
        self.alive = False
        self._process.kill()
        self._process.join()
        self._connection.close()

    def _answer(self, time_limit: float) -> bytes:
        try:
            if not self._connection.poll(time_limit):
                raise self._death("hang", f"no answer within {time_limit:g} s")
            answer: bytes = self._connection.recv_bytes()
        except (EOFError, OSError):
            self._process.join(ENDING_SECONDS)
            raise self._death("crash", _ending(self._process.exitcode)) from None
        tag, content = answer[:1], answer[1:]
        if tag == ADS_FAILED:
            raise ADSError(**json.loads(content))
        if tag == FAILED:
            raise RuntimeError(content.decode())
        return content

    def _death(self, kind: str, message: str) -> Exception:
        """What has ended this worker, which can be laid to the ADS only if it was being asked."""
        was_asking = bool(self._asking.value) or (kind == "crash" and _has_closed(self._process.exitcode))
        self.kill()
        return ADSError(kind, message) if was_asking else WorkerDiedError(f"a worker ended: {message}")


def _serve(
    connection: Connection,
    asking: Any,
    functions: Serve,
    begin: Callable[..., object],
    arguments: tuple[Any, ...],
    memory_limit: float,
) -> None:
    """What a worker does: it leaves Ctrl-C to the campaign, uses one thread, and does not outlive it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_end_with_campaign, daemon=True).start()
    os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))
    logging.getLogger("behavexplor").setLevel(logging.ERROR)  # the campaign's own process has warned already
    share_asking(asking)
    _limit_memory(memory_limit)
    try:
        begin(*arguments)
        threadpool_limits(1)  # of what the ADS has loaded, too
    except InputError as error:
        connection.send_bytes(FAILED + str(error).encode())
        return
    connection.send_bytes(RESULT)
    while True:
        try:
            name, _, data = connection.recv_bytes().partition(b"\0")
        except (EOFError, OSError):  # the campaign has ended, perhaps in the middle of a request
            return
        answer = _answered(functions[name.decode()], data)
        try:
            connection.send_bytes(answer)
        except OSError:  # the ADS has closed our files, or the campaign has ended
            os._exit(CLOSED)


def _answered(function: Callable[[bytes], bytes], data: bytes) -> bytes:
    try:
        return RESULT + function(data)
    except ADSError as error:
        return ADS_FAILED + json.dumps({"kind": error.kind, "message": error.message}).encode()
    except Exception as error:
        return FAILED + f"{type(error).__name__}: {error}".encode(errors="replace")
    except BaseException as error:  # such as KeyboardInterrupt, which here nobody raises but an ADS
        return ADS_FAILED + json.dumps({"kind": "raised", "message": f"{type(error).__name__}: {error}"}).encode()


def _limit_memory(gibibytes: float) -> None:
    """Let allocations beyond the limit fail, so that an ADS that eats memory gets a MemoryError."""
    if resource is not None and hasattr(resource, "RLIMIT_DATA"):
        with suppress(ValueError, OSError):  # a lower limit is set already
            resource.setrlimit(resource.RLIMIT_DATA, (int(gibibytes * 2**30),) * 2)


def _has_closed(exit_code: int | None) -> bool:
    """Whether a worker has lost its connection, which nobody closes but an ADS: it has said so, or still runs."""
    return exit_code in (CLOSED, None)


def _ending(exit_code: int | None) -> str:
    if _has_closed(exit_code):
        return "it closed the files of its process"
    if exit_code is not None and exit_code < 0:
        return f"its process was ended by {signal.Signals(-exit_code).name}"
    return f"its process ended with exit code {exit_code}"


def _end_with_campaign() -> None:
    """End this process when the campaign's process has ended, however it did."""
    campaign = multiprocessing.parent_process()
    if campaign is not None:
        wait([campaign.sentinel])
        os._exit(1)
