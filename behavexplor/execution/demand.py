"""Demand for workers: how much of the time the caller of a pool waits for results."""

import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from typing import Any, Final

_MOST: Final = 0.5  # greatest share of the time for which the caller should wait
_PERIOD: Final = 1.0  # least time over which this share is measured [s]


class Demand:
    """Measures the share of the time that a caller waits, anew in each period.

    An older share says little, because the caller's work changes. One thread waits, and another one asks for the share.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._waits_since: float | None = None
        self.measure_anew()

    def measure_anew(self) -> None:
        """Forget what has been measured."""
        with self._lock:
            self._begun, self._waited, self._share = time.monotonic(), 0.0, 0.0

    @property
    def is_high(self) -> bool:
        """True if the caller waited for most of the latest period, so that another worker would help."""
        with self._lock:
            now = time.monotonic()
            elapsed = now - self._begun
            if elapsed >= _PERIOD:
                share = (self._waited + self._waits_for(now)) / elapsed
                self._begun, self._waited, self._share = now, 0.0, share
            return self._share > _MOST

    def _waits_for(self, now: float) -> float:
        """Return for how long the caller has been waiting in this period, if it waits now [s]."""
        since = self._waits_since
        return 0.0 if since is None else now - max(since, self._begun)

    @contextmanager
    def waiting(self) -> Iterator[None]:
        """Return a context in which the caller waits."""
        with self._lock:
            self._waits_since = time.monotonic()
        try:
            yield
        finally:
            with self._lock:
                self._waited += self._waits_for(time.monotonic())
                self._waits_since = None


class AwaitedFuture(Future[Any]):
    """A future that measures how long the caller waits for its result. All futures add this time to one `demand`."""

    def __init__(self, demand: Demand) -> None:
        super().__init__()
        self._demand = demand

    def result(self, timeout: float | None = None) -> Any:
        """Wait for the result, and return it; see `concurrent.futures.Future.result`."""
        if self.done():
            return super().result()
        with self._demand.waiting():
            return super().result(timeout)
