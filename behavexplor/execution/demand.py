"""Demand for workers: how much of the time the caller of a pool waits for results."""

import time
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from typing import Any, Final

_MOST: Final = 0.5  # greatest share of the time for which the caller should wait
_PERIOD: Final = 0.25  # least time over which this share is measured [s]


class Demand:
    """Measures for which share of the time a caller waits. One thread waits, and another one asks for the share."""

    def __init__(self) -> None:
        self.measure_anew()

    def measure_anew(self) -> None:
        """Forget what has been measured."""
        self._begun, self._waited = time.monotonic(), 0.0

    @property
    def is_high(self) -> bool:
        """True if the caller waits for most of the time, so that another worker would help."""
        elapsed = time.monotonic() - self._begun
        return elapsed >= _PERIOD and self._waited > _MOST * elapsed

    @contextmanager
    def waiting(self) -> Iterator[None]:
        """Return a context in which the caller waits."""
        begun = time.monotonic()
        try:
            yield
        finally:
            self._waited += time.monotonic() - max(begun, self._begun)


class AwaitedFuture(Future[Any]):
    """A future that measures how long the caller waits for its result.

    Args:
        demand: the measured demand of all futures.
    """

    def __init__(self, demand: Demand) -> None:
        super().__init__()
        self._demand = demand

    def result(self, timeout: float | None = None) -> Any:
        """Wait for the result, and return it; see `concurrent.futures.Future.result`."""
        with self._demand.waiting():
            return super().result(timeout)
