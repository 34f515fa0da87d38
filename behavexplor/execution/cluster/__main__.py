"""The process of a cluster node: `python -m behavexplor.execution.cluster SETTINGS` takes calls on stdin."""

import json
import os
import signal
import socket
import sys
from concurrent.futures import Future
from contextlib import suppress
from functools import partial
from threading import Lock
from typing import IO

from behavexplor.execution.cluster.node import read_message, write_message
from behavexplor.execution.executor import FUNCTIONS, make_executor
from behavexplor.execution.rollout import ADSError
from behavexplor.execution.worker import ADS_FAILED, FAILED, KEY_BYTES, RESULT, Request


def main(settings: str) -> None:
    """Answer calls until stdin is closed.

    Args:
        settings: arguments of `behavexplor.execution.executor.make_executor`, as JSON.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what an ADS prints is no answer
    executor, lock = make_executor(1, **json.loads(settings)), Lock()
    try:
        while (message := read_message(sys.stdin.buffer)) is not None:
            request = Request.from_bytes(message)
            future = executor.submit(FUNCTIONS[request.function], request.data)
            future.add_done_callback(partial(_answer, answers, lock, request.key))
    finally:
        executor.shutdown(wait=False, cancel_futures=True)


def _answer(answers: IO[bytes], lock: Lock, key: int, future: "Future[bytes]") -> None:
    with lock, suppress(OSError):  # nobody waits for it any more
        write_message(answers, key.to_bytes(KEY_BYTES) + _tagged(future))


def _tagged(future: "Future[bytes]") -> bytes:
    """The outcome of a call, as `behavexplor.execution.worker` says it."""
    if future.cancelled():
        return FAILED + b"it was cancelled"
    error = future.exception()
    if error is None:
        return RESULT + future.result()
    if isinstance(error, ADSError):
        return ADS_FAILED + json.dumps({"kind": error.kind, "message": error.message}).encode()
    return FAILED + f"{error} (on the node {socket.gethostname()})".encode(errors="replace")


if __name__ == "__main__":
    main(sys.argv[1])
