"""The actor on a cluster node, in a process of Ray or Dask. It forwards calls to a process of this package.

That process (`behavexplor.execution.cluster.__main__`) supervises the worker in which the ADS runs. It is separate from
Ray and Dask so that a worker starts as it does without a cluster: from a clean process, which may have children.
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
ENDING_SECONDS: Final = 5.0  # time limit for the process to end after its stdin was closed [s]


class NodeLostError(RuntimeError):
    """The process that answers a node's calls has ended."""


class Node:
    """Answers many calls at a time with tagged bytes, see `behavexplor.execution.messages`.

    Args:
        settings: JSON object with the recipe of the service and the limits of its worker.
        folder: working directory of the campaign. The process works there if this node has such a folder.
    """

    def __init__(self, settings: str, folder: str) -> None:
        self._process = subprocess.Popen(  # noqa: S603 - this package, in this Python
            [sys.executable, "-m", "behavexplor.execution.cluster", settings],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            cwd=folder if Path(folder).is_dir() else None,
            process_group=0,  # Ctrl-C is for the campaign only
        )
        self._keys = count()
        self._calls = _Calls()
        Thread(target=_listen, args=(self._process.stdout, self._calls), daemon=True).start()
        self._writing = Lock()
        self._end = weakref.finalize(self, _end, self._process)

    async def ask(self, function: str, data: bytes) -> bytes:
        """Call a function by its name.

        Raises:
            NodeLostError: if the process has ended.
        """
        request = Request(next(self._keys), function, False, data)
        future = self._calls.add(request.key)
        try:
            await asyncio.to_thread(self._send, request.to_bytes())
        except OSError:
            raise NodeLostError(_ENDED) from None
        return await asyncio.wrap_future(future)

    async def end(self) -> None:
        """End the process, by force if it does not end in time."""
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
        """Add a call and return its future.

        Raises:
            NodeLostError: if the process has ended.
        """
        future: Future[bytes] = Future()
        with self._lock:
            if self._waiting is None:
                raise NodeLostError(_ENDED)
            self._waiting[key] = future
        return future

    def answer(self, key: int, answer: bytes) -> None:
        """Set the answer of a call."""
        with self._lock:
            future = self._waiting.pop(key) if self._waiting else None
        if future is not None:
            with suppress(InvalidStateError):  # the call was canceled
                future.set_result(answer)

    def close(self) -> None:
        """Fail all waiting calls and refuse new ones, because the process has ended."""
        with self._lock:
            waiting, self._waiting = self._waiting or {}, None
        for future in waiting.values():
            with suppress(InvalidStateError):
                future.set_exception(NodeLostError(_ENDED))


def write_message(stream: IO[bytes] | None, message: bytes) -> None:
    """Write a message, preceded by its size.

    Raises:
        OSError: if the stream has been closed at either end.
    """
    if stream is None or stream.closed:
        raise BrokenPipeError("the stream has been closed")
    stream.write(len(message).to_bytes(SIZE_BYTES) + message)
    stream.flush()


def read_message(stream: IO[bytes]) -> bytes | None:
    """Read the next message; None at the end of the stream."""
    size = stream.read(SIZE_BYTES)
    message = stream.read(int.from_bytes(size)) if len(size) == SIZE_BYTES else b""
    return message if message and len(message) == int.from_bytes(size) else None


def _listen(stream: IO[bytes], calls: _Calls) -> None:
    """Receive answers until the process has ended. Holds no reference to the `Node`, so that it can be collected."""
    while (message := read_message(stream)) is not None:
        calls.answer(*split_key(message))
    calls.close()
    stream.close()


def _end(process: subprocess.Popen[bytes]) -> None:
    if process.stdin is not None:
        with suppress(OSError):  # the process has already ended
            process.stdin.close()
    try:
        process.wait(ENDING_SECONDS)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
