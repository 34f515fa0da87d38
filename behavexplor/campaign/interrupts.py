"""Handling of Ctrl-C in long-running commands."""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

Handler = Callable[[int, FrameType | None], object] | signal.Handlers


@contextmanager
def stopped_by_signals(stop: Callable[[], None], again: Handler) -> Iterator[None]:
    """Make the first Ctrl-C (or SIGTERM) stop the code in this context cleanly, and the second one at once.

    Args:
        stop: function that is called on the first signal.
        again: handler of the second signal.
    """

    def first(number: int, _frame: FrameType | None) -> None:
        stop()
        signal.signal(number, again)

    previous = {number: signal.signal(number, first) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
