"""What stands on a node of a cluster, in a process of Ray's or Dask's: it hands calls on to a process of our own.

That process (`behavexplor.execution.cluster.__main__`) supervises the worker in which the ADS runs. It is not Ray's or
Dask's own, so that a worker starts as it does without a cluster: from a clean process, which may have children.
"""

import asyncio
import subprocess
import sys
import weakref
from concurrent.futures import Future, InvalidStateError
from contextlib import suppress
from itertools import count
from pathlib import Path
from threading import Lock, Thread
from typing import IO, Final

from behavexplor.execution.messages import Request, split_key

SIZE_BYTES: Final = 8
_ENDED: Final = "its process has ended"
ENDING_SECONDS: Final = 5.0  # in which the process must have ended that has nobody to answer any more [s]


class NodeLostError(RuntimeError):
    """The process has ended that a node's calls were handed to."""


class Node:
    """Answers calls in tagged bytes, as `behavexplor.execution.messages` defines, many at a time.

    Args:
        settings: JSON object with the recipe of the service and the limits of its worker.
        folder: in which the campaign was started; the process works there, if this node has such a folder.
    """

    def __init__(self, settings: str, folder: str) -> None:
        self._process = subprocess.Popen(  # noqa: S603 - this package, in this Python
            [sys.executable, "-m", "behavexplor.execution.cluster", settings],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            cwd=folder if Path(folder).is_dir() else None,
            process_group=0,  # Ctrl-C is the campaign's
        )
        self._keys = count()
        self._calls = _Calls()
        Thread(target=_listen, args=(self._process.stdout, self._calls), daemon=True).start()
        self._writing = Lock()
        self._end = weakref.finalize(self, _end, self._process)

    async def ask(self, function: str, data: bytes) -> bytes:
        """Call a function by its name.

        Raises:
            NodeLostError: if it cannot be called here any more.
        """
        request = Request(next(self._keys), function, False, data)
        future = self._calls.add(request.key)
        try:
            await asyncio.to_thread(self._send, request.to_bytes())
        except OSError:
            raise NodeLostError(_ENDED) from None
        return await asyncio.wrap_future(future)

    async def end(self) -> None:
        """End the process, whatever it does."""
        await asyncio.to_thread(self._end)

    def _send(self, message: bytes) -> None:
        with self._writing:
            write_message(self._process.stdin, message)


class _Calls:
    """Calls that wait for their answers."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._waiting: dict[int, Future[bytes]] | None = {}

    def add(self, key: int) -> "Future[bytes]":
        """The future of a call.

        Raises:
            NodeLostError: if there will be no more answers.
        """
        future: Future[bytes] = Future()
        with self._lock:
            if self._waiting is None:
                raise NodeLostError(_ENDED)
            self._waiting[key] = future
        return future

    def answer(self, key: int, answer: bytes) -> None:
        """Give a call its answer."""
        with self._lock:
            future = self._waiting.pop(key) if self._waiting else None
        if future is not None:
            with suppress(InvalidStateError):  # nobody waits for it any more
                future.set_result(answer)

    def close(self) -> None:
        """There will be no more answers."""
        with self._lock:
            waiting, self._waiting = self._waiting or {}, None
        for future in waiting.values():
            with suppress(InvalidStateError):
                future.set_exception(NodeLostError(_ENDED))


def write_message(stream: IO[bytes] | None, message: bytes) -> None:
    """Write a message with its size before it.

    Raises:
        OSError: if nobody reads it.
    """
    if stream is None or stream.closed:
        raise BrokenPipeError("the stream has been closed")
    stream.write(len(message).to_bytes(SIZE_BYTES) + message)
    stream.flush()


def read_message(stream: IO[bytes]) -> bytes | None:
    """The next message; None at the end."""
    size = stream.read(SIZE_BYTES)
    message = stream.read(int.from_bytes(size)) if len(size) == SIZE_BYTES else b""
    return message if message and len(message) == int.from_bytes(size) else None


def _listen(stream: IO[bytes], calls: _Calls) -> None:
    """Take in answers until the process has ended; knows nothing of the `Node`, which may be forgotten meanwhile."""
    while (message := read_message(stream)) is not None:
        calls.answer(*split_key(message))
    calls.close()
    stream.close()


def _end(process: subprocess.Popen[bytes]) -> None:
    if process.stdin is not None:
        with suppress(OSError):  # it has ended before
            process.stdin.close()
    try:
        process.wait(ENDING_SECONDS)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
