"""Execution in this process, many calls in lock-step as soon as a result is asked for."""

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from itertools import count

from behavexplor.execution.executor import Executor
from behavexplor.execution.service import Batch, Service


class InProcessExecutor(Executor):
    """Calls the functions of a service in this process.

    Args:
        service: a service that has begun.
        batched: name of the function that is called in batches, see `behavexplor.execution.service.Recipe`.
    """

    def __init__(self, service: Service, batched: str = "") -> None:
        self._functions = service.functions
        self._batched = batched
        self._batch = service.batch
        self._waiting: deque[tuple[_DrivenFuture, bytes]] = deque()
        self._running: dict[int, tuple[_DrivenFuture, bytes]] = {}
        self._keys = count()

    def submit(self, function: str, data: bytes) -> "Future[bytes]":
        """Call a function: at once, or in a batch, which advances while the result is waited for."""
        if self._batch is not None and function == self._batched:
            driven = _DrivenFuture(self.advance)
            self._waiting.append((driven, data))
            return driven
        future: Future[bytes] = Future()
        self._settle(future, function, data)
        return future

    def advance(self) -> None:
        """Advance the batch by one step."""
        batch = self._batch
        if batch is None:
            return
        while self._waiting and len(self._running) < batch.capacity:
            self._begin(batch, *self._waiting.popleft())
        for key, result in batch.advance() if self._running else ():
            future, data = self._running.pop(key)
            if result is None:
                self._settle(future, self._batched, data)
            else:
                future.set_result(result)

    def stop(self) -> None:
        """Cancel the calls that have not begun."""
        for future, _ in self._waiting:
            future.cancel()
        self._waiting.clear()

    def shutdown(self, *, wait: bool = True) -> None:
        """Finish all calls if `wait`, else cancel those that have not begun."""
        if not wait:
            self.stop()
        while wait and (self._waiting or self._running):
            self.advance()

    def _begin(self, batch: Batch, future: "_DrivenFuture", data: bytes) -> None:
        key = next(self._keys)
        try:
            batch.begin(key, data)
        except Exception as error:
            future.set_exception(error)
            return
        self._running[key] = (future, data)

    def _settle(self, future: "Future[bytes]", function: str, data: bytes) -> None:
        """Give a future the outcome of a call."""
        try:
            future.set_result(self._functions[function](data))
        except Exception as error:
            future.set_exception(error)


class _DrivenFuture(Future[bytes]):
    """A future that drives the executor while its result is waited for."""

    def __init__(self, advance: Callable[[], None]) -> None:
        super().__init__()
        self._advance = advance

    def result(self, timeout: float | None = None) -> bytes:
        """Return the result, however long it takes."""
        while not self.done():
            self._advance()
        return super().result(timeout)
