"""What Ctrl-C does to a command that runs for long."""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

Handler = Callable[[int, FrameType | None], object] | signal.Handlers


@contextmanager
def stopped_by_signals(stop: Callable[[], None], again: Handler) -> Iterator[None]:
    """The first Ctrl-C (or SIGTERM) ends what runs inside cleanly, the second at once.

    Args:
        stop: called for the first.
        again: handles the second.
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
