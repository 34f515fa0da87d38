"""Execution in this process. Calls run in lock-step batches, which advance while a result is waited for."""

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from itertools import count

from behavexplor.execution.executor import Executor
from behavexplor.execution.service import Batch, Service


class InProcessExecutor(Executor):
    """Calls the functions of a service in this process.

    Args:
        service: a service whose `begin` has been called.
        batched: name of the function that is called in batches; see `behavexplor.execution.service.Recipe`.
    """

    runs_here = True

    def __init__(self, service: Service, batched: str = "") -> None:
        self._functions = service.functions
        self._batched = batched
        self._batch = service.batch
        self._waiting: deque[tuple[_DrivenFuture, bytes]] = deque()
        self._running: dict[int, tuple[_DrivenFuture, bytes]] = {}
        self._keys = count()

    def submit(self, function: str, data: bytes) -> "Future[bytes]":
        """Call a function at once, or in a batch that advances while the result is waited for."""
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
            elif isinstance(result, Exception):
                future.set_exception(result)
            else:
                future.set_result(result)

    def stop(self) -> None:
        """Cancel the calls that have not started."""
        for future, _ in self._waiting:
            future.cancel()
        self._waiting.clear()

    def shutdown(self, *, wait: bool = True) -> None:
        """Finish all calls if `wait`, else cancel the calls that have not started."""
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
        """Make a call and set its outcome on a future."""
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
        """Return the result; the timeout does not limit the wait."""
        while not self.done():
            self._advance()
        return super().result(timeout)
