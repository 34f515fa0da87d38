"""Executor: calls the functions of a service, in this process, in worker processes or on a cluster.

A call fails with an `ADSError` if the ADS does. `in_order` limits the number of calls under way.
"""

import os
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future
from types import TracebackType
from typing import ClassVar, Final, Self

MOST_WORKERS: Final = 64  # processes on one machine
AHEAD: Final = 4  # calls that `in_order` keeps under way for each worker, in triage and minimization
LOCK_STEP: Final = 32  # greatest number of episodes that run in lock-step in one process
BATCHES: Final = 2  # batches of calls for each worker: one under way, and one ahead


class Executor(ABC):
    """Calls functions of a service by name. Results do not depend on which executor calls them.

    An executor is a context manager: on exit it finishes all calls and shuts down. After an error, it cancels
    waiting calls and shuts down at once.
    """

    runs_here: ClassVar[bool] = False  # whether calls run in this process, while their results are waited for
    # number of further calls until each worker that has begun has `BATCHES` batches of them; negative if there are more
    room: int = 0

    @abstractmethod
    def submit(self, function: str, data: bytes) -> "Future[bytes]":
        """Call the service's function that is named `function`, with the argument `data`, and return the future result.

        The exception of the future is an `ADSError` if the ADS failed, and an `InputError` if the service could not
        begin or rejected the data.
        """

    @abstractmethod
    def shutdown(self, *, wait: bool = True) -> None:
        """Shut the executor down: after all calls if `wait`, else at once, with waiting calls canceled."""

    @abstractmethod
    def stop(self) -> None:
        """Cancel calls that have not started, and ask long calls to end early."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.shutdown(wait=error is None)


def available_cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


# How an ADS fails. raised: it raised an exception; invalid: its answer is not a valid action; exit: it called
# `sys.exit`; memory: it ran out of memory; hang: it did not answer in time; crash: its process died.
ADS_FAILURES: Final = ("raised", "invalid", "exit", "memory", "hang", "crash")


class ADSError(Exception):
    """An ADS failed instead of returning an action."""

    def __init__(self, kind: str, message: str, place: str = "") -> None:
        super().__init__(f"the ADS failed ({kind}): {message}{place}")
        self.kind = kind  # one of `ADS_FAILURES`
        self.message = message
        self.place = place  # where the ADS raised, see `behavexplor.errors.place_of`; no part of a record


def in_order(executor: Executor, calls: Iterable[tuple[str, bytes]], ahead: int) -> Iterator["Future[bytes]"]:
    """Call functions, each given by its name and argument, and yield the futures in order.

    While one is waited for, at most `ahead` calls behind it are under way.
    """
    pending: deque[Future[bytes]] = deque()
    for function, data in calls:
        pending.append(executor.submit(function, data))
        if len(pending) > ahead:
            yield pending.popleft()
    yield from pending
