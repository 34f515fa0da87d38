"""The flag `--workers`, and the note that a driver is being loaded."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Timer
from typing import Final

from behavexplor.errors import InputError
from behavexplor.execution.executor import MOST_WORKERS, available_cores

WAITING: Final = "Loading the driver; first-time compilation can take a minute ..."


def chosen_workers(workers: int | None) -> int:
    """Return the number of worker processes on this machine; by default one for each available core.

    Raises:
        InputError: if the number is out of range.
    """
    if workers is None:
        return min(available_cores(), MOST_WORKERS)
    if not 0 <= workers <= MOST_WORKERS:
        raise InputError(f"--workers {workers} must lie between 0 and {MOST_WORKERS}")
    return workers


@contextmanager
def patience(say: Callable[[str], object], note: str = WAITING, after: float = 5.0) -> Iterator[None]:
    """Say something if the code in this context takes longer than `after` seconds."""
    timer = Timer(after, say, [note])
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
