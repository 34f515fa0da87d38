"""Executor: calls the functions of a service, in this process, in worker processes or on a cluster."""

import os
from abc import ABC, abstractmethod
from concurrent.futures import Future
from types import TracebackType
from typing import ClassVar, Final, Self


class Executor(ABC):
    """Calls functions of a service by name. Results do not depend on which executor calls them.

    An executor is a context manager: on exit it finishes all calls and shuts down.

    Attributes:
        runs_here: whether calls run in this process, while their results are waited for.
    """

    runs_here: ClassVar[bool] = False

    @abstractmethod
    def submit(self, function: str, data: bytes) -> "Future[bytes]":
        """Call a function of the service.

        Args:
            function: name of the function.
            data: argument of the function.

        Returns:
            The future result. Its exception is an `ADSError` if the ADS failed, and an `InputError` if the service
            could not begin or rejected the data.
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
        self.shutdown()


MOST_WORKERS: Final = 64  # processes on one machine


def available_cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
