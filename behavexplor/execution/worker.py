"""The child's side of the process boundary: receive requests, call the service alone or in batches, and answer."""

import gc
import logging
import math
import multiprocessing
import os
import queue
import signal
import stat
import sys
import tempfile
import time
from collections.abc import Mapping
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from pathlib import Path
from threading import Thread
from typing import Any, Final

from threadpoolctl import threadpool_limits

from behavexplor.errors import InputError, described
from behavexplor.execution.executor import ADSError
from behavexplor.execution.messages import READY, RESULT, SUSPECT, Request, error_answer, packed, unpacked, with_key
from behavexplor.execution.rollout import share_asking
from behavexplor.execution.service import Batch, Recipe, Service
from behavexplor.execution.worker_output import leave_terminal

try:
    import fcntl
    import resource
except ImportError:  # Windows has neither
    fcntl = resource = None  # type: ignore[assignment]

_STDERR: Final = 2  # number of the last of the standard files
CLOSED: Final = 83  # exit code of a worker whose connection was closed
_LONGEST_WAIT: Final = 0.1  # longest time that an answer waits for others, to be sent with them [s]
_MOST_WAITING: Final = 2**20  # size of waiting answers above which they are sent [bytes]


def serve(
    connection: Connection,
    asking: Any,
    recipe: Recipe,
    memory_limit: float,
    folder: str,
    environment: Mapping[str, str],
    output: Connection | None,
) -> None:
    """Answer requests until the other end of the connection is closed.

    The process ignores Ctrl-C, computes in one thread, and ends when its supervisor ends.

    Args:
        connection: connection to the supervisor.
        asking: see `behavexplor.execution.rollout.share_asking`.
        recipe: recipe of the service.
        memory_limit: memory limit of the process [GiB], where the system supports it.
        folder: folder for temporary files.
        environment: environment variables of the supervisor; the process that this one was forked from may have had
            others.
        output: pipe into which the process prints; None to print where its supervisor does.
    """
    os.environ.clear()
    os.environ.update(environment)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ["TMPDIR"] = tempfile.tempdir = folder
    os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))
    logging.getLogger("behavexplor.jit").setLevel(logging.ERROR)  # the command says what it waits for
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # it complains about a HOME that cannot be written
    share_asking(asking)
    _limit_memory(memory_limit)
    if output is not None:
        leave_terminal(output)
    with suppress(EOFError, OSError):  # the supervisor has ended
        connection.recv_bytes()  # `STARTED`
        _be_killed_with_supervisor(with_children=output is not None)
    _keep_from_copies(connection)
    _leave_pipes()
    service = recipe.make()
    if recipe.long_calls:
        signal.signal(signal.SIGTERM, lambda *_: service.stop())
    try:
        service.confine()
        Thread(target=_end_with_supervisor, daemon=True).start()
        service.begin()
        threadpool_limits(1)  # includes libraries that the ADS has loaded
        gc.freeze()  # modules live as long as the process: garbage collections need not look at them
    except InputError as error:
        _send(connection, [with_key(0, error_answer(error))])
        return
    ready = READY + str(service.batch.capacity if service.batch else 1).encode()
    _send(connection, [with_key(0, ready)])
    requests: queue.SimpleQueue[Request | None] = queue.SimpleQueue()
    Thread(target=_receive, args=(connection, requests), daemon=True).start()
    try:
        _work(_Answers(connection, recipe.together), requests, service)
    except KeyboardInterrupt:  # workers ignore the key, so an ADS has raised it: it is asked again, alone
        os._exit(1)


def _keep_from_copies(connection: Connection) -> None:
    """Close the connection in each copy that an ADS makes of this process, so that the copy answers nothing."""
    if hasattr(os, "register_at_fork"):  # not on Windows
        os.register_at_fork(after_in_child=connection.close)


def _leave_pipes() -> None:
    """Lead all pipes into which this process can write to nowhere, except its output.

    They are those of the processes that begin workers, which end if a driver writes into them.
    """
    files = Path("/dev/fd")
    if not files.is_dir():  # on Windows
        return
    with Path(os.devnull).open("wb") as nowhere:
        for number in [int(entry.name) for entry in files.iterdir()]:
            if number > _STDERR and _leads_away(number):
                os.dup2(nowhere.fileno(), number)


def _leads_away(number: int) -> bool:
    """Return whether an open file is a pipe into which this process can write."""
    try:
        is_pipe = stat.S_ISFIFO(os.fstat(number).st_mode)
        return is_pipe and fcntl.fcntl(number, fcntl.F_GETFL) & os.O_ACCMODE == os.O_WRONLY
    except OSError:  # it was open while the folder was listed
        return False


def _receive(connection: Connection, requests: "queue.SimpleQueue[Request | None]") -> None:
    """Queue requests as soon as they arrive, so that sending never blocks. None marks the end of the connection."""
    with suppress(EOFError, OSError):
        while True:
            for request in unpacked(connection.recv_bytes()):
                requests.put(Request.from_bytes(request))
    requests.put(None)


class _Answers:
    """Answers that are sent in one message: as many as are wanted together, or those that have waited for a while."""

    def __init__(self, connection: Connection, together: int) -> None:
        self._connection, self._together = connection, together
        self._waiting: list[bytes] = []
        self._since = 0.0

    def add(self, key: int, answer: bytes) -> None:
        """Take one more answer."""
        if not self._waiting:
            self._since = time.monotonic()
        self._waiting.append(with_key(key, answer))

    def send(self, *, at_once: bool) -> None:
        """Send the answers if they are enough or have waited for long; `at_once`, send them if there are any."""
        is_due = at_once or len(self._waiting) >= self._together or time.monotonic() - self._since > _LONGEST_WAIT
        if self._waiting and (is_due or sum(map(len, self._waiting)) > _MOST_WAITING):
            _send(self._connection, self._waiting)
            self._waiting = []


def _work(answers: _Answers, requests: "queue.SimpleQueue[Request | None]", service: Service) -> None:
    batch, working = service.batch, 0
    capacity = batch.capacity if batch else 1
    while True:
        while working == 0 or (working < capacity and not requests.empty()):
            answers.send(at_once=working == 0)
            if (request := requests.get()) is None:
                return
            if request.alone or batch is None:
                answers.add(request.key, _call(service, request))
                answers.send(at_once=True)
            elif (refused := _begin(batch, request)) is not None:
                answers.add(request.key, refused)
            else:
                working += 1
        for key, result in batch.advance() if batch else ():
            answers.add(key, _answer(result))
            working -= 1
        answers.send(at_once=False)


def _answer(result: bytes | Exception | None) -> bytes:
    if result is None:
        return SUSPECT
    return error_answer(result) if isinstance(result, Exception) else RESULT + result


def _send(connection: Connection, answers: list[bytes]) -> None:
    try:
        connection.send_bytes(packed(answers))
    except OSError:  # the ADS has closed our files, or the campaign has ended
        os._exit(CLOSED)


def _call(service: Service, request: Request) -> bytes:
    try:
        return RESULT + service.functions[request.function](request.data)
    except (OSError, ImportError) as error:  # only if the ADS has used up file descriptors or removed modules
        cannot = ADSError("crash", f"its process cannot go on: {described(error)}")
        return error_answer(cannot if service.is_confined else error)
    except Exception as error:
        return error_answer(error)
    except BaseException as error:  # such as KeyboardInterrupt, which only an ADS can raise here
        return error_answer(ADSError("raised", described(error)))


def _begin(batch: Batch, request: Request) -> bytes | None:
    try:
        batch.begin(request.key, request.data)
    except Exception as error:
        return error_answer(error)
    return None


def _limit_memory(gibibytes: float) -> None:
    """Make allocations beyond the limit fail, so that an ADS that uses too much memory gets a MemoryError."""
    if resource is not None and hasattr(resource, "RLIMIT_DATA") and math.isfinite(gibibytes):
        with suppress(ValueError, OSError):  # a lower limit is set already
            resource.setrlimit(resource.RLIMIT_DATA, (int(gibibytes * 2**30),) * 2)


def _be_killed_with_supervisor(*, with_children: bool) -> None:
    """Let Linux kill this process when the supervisor's process ends, even while an ADS keeps all threads from running.

    Linux sends the signal at any event on the pipe by which this process was started. Once the supervisor has written
    all, only its end is left. `with_children` kills all processes of this one's group, too, which must be its own.
    """
    supervisor = multiprocessing.parent_process()
    if supervisor is None or sys.platform != "linux":
        return
    fcntl.fcntl(supervisor.sentinel, fcntl.F_SETOWN, -os.getpid() if with_children else os.getpid())
    fcntl.fcntl(supervisor.sentinel, fcntl.F_SETSIG, signal.SIGKILL)
    fcntl.fcntl(supervisor.sentinel, fcntl.F_SETFL, os.O_ASYNC)


def _end_with_supervisor() -> None:
    """End this process when the supervisor's process ends for any reason."""
    supervisor = multiprocessing.parent_process()
    if supervisor is not None:
        wait([supervisor.sentinel])
        os._exit(1)
