"""The process of a cluster node: `python -m behavexplor.execution.cluster SETTINGS` reads calls from stdin."""

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
from behavexplor.execution.messages import RESULT, Request, error_answer, with_key
from behavexplor.execution.pool import WorkerPool
from behavexplor.execution.service import Recipe


def main(settings: str) -> None:
    """Answer calls until stdin is closed.

    Args:
        settings: JSON object with the recipe of the service and the limits of its worker.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # stdout carries answers, so send what an ADS prints to stderr
    values, lock = json.loads(settings), Lock()
    pool = WorkerPool(1, Recipe.from_json(values["recipe"]), values["time_limit"], values["memory_limit"])
    try:
        while (message := read_message(sys.stdin.buffer)) is not None:
            request = Request.from_bytes(message)
            future = pool.submit(request.function, request.data)
            future.add_done_callback(partial(_answer, answers, lock, request.key))
    finally:
        pool.shutdown(wait=False)


def _answer(answers: IO[bytes], lock: Lock, key: int, future: "Future[bytes]") -> None:
    with lock, suppress(OSError):  # the campaign may have ended
        write_message(answers, with_key(key, _outcome(future)))


def _outcome(future: "Future[bytes]") -> bytes:
    """Return the answer for a finished call."""
    error = RuntimeError("the call was canceled") if future.cancelled() else future.exception()
    return RESULT + future.result() if error is None else error_answer(error, f" (on the node {socket.gethostname()})")


if __name__ == "__main__":
    main(sys.argv[1])
