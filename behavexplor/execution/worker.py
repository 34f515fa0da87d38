"""What runs inside a worker process: it takes requests, works on many together or on one alone, and answers."""

import json
import logging
import multiprocessing
import os
import queue
import signal
import tempfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from threading import Thread
from typing import Any, Final, NamedTuple, Protocol

from threadpoolctl import threadpool_limits

from behavexplor.errors import InputError
from behavexplor.execution.rollout import ADSError, share_asking

try:
    import resource
except ImportError:  # Windows cannot limit a process so
    resource = None  # type: ignore[assignment]

READY, RESULT, ADS_FAILED, FAILED, SUSPECT = b"C", b"R", b"A", b"E", b"S"  # what an answer says, after its key
KEY_BYTES: Final = 8
CLOSED: Final = 83  # exit code of a worker that finds its connection closed

Functions = Mapping[str, Callable[[bytes], bytes]]


class Together(Protocol):
    """Works on many requests at a time.

    Attributes:
        capacity: how many.
    """

    capacity: int

    def begin(self, key: int, request: bytes) -> None:
        """Take one more request."""

    def advance(self) -> list[tuple[int, bytes | None]]:
        """Work on all of them.

        Returns:
            The key of each that is done, and its result; None for one that has to be asked for alone.
        """


class Request(NamedTuple):
    """What is asked of a worker.

    Attributes:
        key: comes back with the answer.
        function: to be called on the data.
        alone: whether nothing else may be worked on meanwhile.
        data: of the request.
    """

    key: int
    function: str
    alone: bool
    data: bytes

    def to_bytes(self) -> bytes:
        """As it is sent."""
        return self.key.to_bytes(KEY_BYTES) + bytes([self.alone]) + self.function.encode() + b"\0" + self.data

    @classmethod
    def from_bytes(cls, message: bytes) -> "Request":
        """As it was sent."""
        function, _, data = message[KEY_BYTES + 1 :].partition(b"\0")
        return cls(int.from_bytes(message[:KEY_BYTES]), function.decode(), bool(message[KEY_BYTES]), data)


def serve(
    connection: Connection,
    asking: Any,
    functions: Functions,
    prepare: Callable[..., None] | None,
    begin: Callable[..., Together | None],
    arguments: tuple[Any, ...],
    memory_limit: float,
    folder: str,
) -> None:
    """Answer requests until the other end of the connection is closed.

    The process leaves Ctrl-C to the campaign, uses one thread for arithmetic, and does not outlive the campaign.

    Args:
        connection: to the campaign.
        asking: see `behavexplor.execution.rollout.share_asking`.
        functions: that can be called, by name.
        prepare: called first, if there is such a thing, while there is no thread beside this one.
        begin: called then; gives what works on many requests together, if there is such a thing.
        arguments: of both.
        memory_limit: of the process [GiB], where the system can set it.
        folder: for temporary files.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ["TMPDIR"] = tempfile.tempdir = folder
    os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))
    logging.getLogger("behavexplor").setLevel(logging.ERROR)  # the campaign's own process has warned already
    share_asking(asking)
    _limit_memory(memory_limit)
    try:
        if prepare is not None:
            prepare(*arguments)
        Thread(target=_end_with_campaign, daemon=True).start()
        together = begin(*arguments)
        threadpool_limits(1)  # of what the ADS has loaded, too
    except InputError as error:
        _answer(connection, 0, FAILED + str(error).encode())
        return
    _answer(connection, 0, READY + str(together.capacity if together else 1).encode())
    requests: queue.SimpleQueue[Request | None] = queue.SimpleQueue()
    Thread(target=_receive, args=(connection, requests), daemon=True).start()
    _work(connection, requests, functions, together)


def _receive(connection: Connection, requests: "queue.SimpleQueue[Request | None]") -> None:
    """Take in requests at once, so that neither end of the connection ever waits for the other to read; None ends."""
    with suppress(EOFError, OSError):
        while True:
            requests.put(Request.from_bytes(connection.recv_bytes()))
    requests.put(None)


def _work(
    connection: Connection,
    requests: "queue.SimpleQueue[Request | None]",
    functions: Functions,
    together: Together | None,
) -> None:
    working = 0
    while True:
        while working == 0 or not requests.empty():
            if (request := requests.get()) is None:
                return
            if request.alone or together is None:
                _answer(connection, request.key, _call(functions[request.function], request.data))
            elif (refused := _begin(together, request)) is not None:
                _answer(connection, request.key, refused)
            else:
                working += 1
        for key, result in together.advance() if together else ():
            _answer(connection, key, SUSPECT if result is None else RESULT + result)
            working -= 1


def _answer(connection: Connection, key: int, content: bytes) -> None:
    try:
        connection.send_bytes(key.to_bytes(KEY_BYTES) + content)
    except OSError:  # the ADS has closed our files, or the campaign has ended
        os._exit(CLOSED)


def _call(function: Callable[[bytes], bytes], data: bytes) -> bytes:
    try:
        return RESULT + function(data)
    except ADSError as error:
        return ADS_FAILED + json.dumps({"kind": error.kind, "message": error.message}).encode()
    except Exception as error:
        return FAILED + _words(error)
    except BaseException as error:  # such as KeyboardInterrupt, which here nobody raises but an ADS
        return ADS_FAILED + json.dumps({"kind": "raised", "message": f"{type(error).__name__}: {error}"}).encode()


def _begin(together: Together, request: Request) -> bytes | None:
    try:
        together.begin(request.key, request.data)
    except Exception as error:
        return FAILED + _words(error)
    return None


def _words(error: Exception) -> bytes:
    return f"{type(error).__name__}: {error}".encode(errors="replace")


def _limit_memory(gibibytes: float) -> None:
    """Let allocations beyond the limit fail, so that an ADS that eats memory gets a MemoryError."""
    if resource is not None and hasattr(resource, "RLIMIT_DATA"):
        with suppress(ValueError, OSError):  # a lower limit is set already
            resource.setrlimit(resource.RLIMIT_DATA, (int(gibibytes * 2**30),) * 2)


def _end_with_campaign() -> None:
    """End this process when the campaign's process has ended, however it did."""
    campaign = multiprocessing.parent_process()
    if campaign is not None:
        wait([campaign.sentinel])
        os._exit(1)
