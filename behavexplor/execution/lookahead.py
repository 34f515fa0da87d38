"""Calls of an executor in order, with a limited number of calls under way."""

from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future
from typing import Final

from behavexplor.execution.executor import Executor

AHEAD: Final = 4  # calls under way for each worker


def in_order(executor: Executor, calls: Iterable[tuple[str, bytes]], ahead: int) -> Iterator["Future[bytes]"]:
    """Call functions of a service, and yield the finished calls in order.

    Args:
        executor: the executor.
        calls: name of the function and its argument, for each call.
        ahead: greatest number of calls that are under way behind the one that is waited for.
    """
    pending: deque[Future[bytes]] = deque()
    for function, data in calls:
        pending.append(executor.submit(function, data))
        if len(pending) > ahead:
            yield pending.popleft()
    yield from pending
