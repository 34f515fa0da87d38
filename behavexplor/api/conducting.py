"""The conduct of a campaign from Python: in this process or in workers, silent, and stopped by Ctrl-C."""

import logging
import signal
import threading
import warnings
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from pathlib import Path

from threadpoolctl import threadpool_limits

from behavexplor.ads.in_memory import GivenDriver
from behavexplor.api.observers import Observer, observed
from behavexplor.campaign.campaign import Campaign
from behavexplor.campaign.config import Budget, CampaignConfig
from behavexplor.campaign.opening import opened, stopped_by_signals
from behavexplor.data.target import Target
from behavexplor.errors import InputError
from behavexplor.execution.executor import MOST_WORKERS
from behavexplor.execution.start import fewest_workers


class Interrupted(KeyboardInterrupt):
    """Ctrl-C has ended the campaign in `folder`, the run folder. The message says how to continue it."""

    def __init__(self, folder: Path) -> None:
        super().__init__(f"Continue with behavexplor.open_run({str(folder)!r}, driver).resume()")
        self.folder = folder


def conduct(
    config: CampaignConfig,
    folder: Path,
    given: GivenDriver,
    *,
    resume: bool = False,
    workers: int | None = None,
    stop_after: int | None = None,
    progress: bool | Observer | None = None,
) -> None:
    """Conduct a campaign until its budget is used up; or with `resume`, go on with the one in its run folder.

    For `workers`, `stop_after` and `progress`, see `behavexplor.find_failures`. It raises what
    `behavexplor.campaign.opening.opened` does, and `Interrupted` after Ctrl-C.
    """
    if stop_after is not None and stop_after < 1:
        raise InputError(f"stop_after={stop_after} must be at least 1")
    count = worker_count(given, config.target, workers)
    with ExitStack() as stack:
        stack.enter_context(in_this_process(count))
        ready = stack.enter_context(
            opened(config, folder, count, resume=resume, driver=given.driver, stop_after=stop_after)
        )
        for warning in ready.warnings:
            warnings.warn(warning, stacklevel=3)
        show = stack.enter_context(observed(progress, Budget.parse(config.budget)))
        stack.enter_context(_stoppable(ready.campaign))
        ready.campaign.run(show)
        ready.campaign.drive_uniformly()
        ready.campaign.confirm()
        was_stopped = ready.campaign.stopping
    if was_stopped:
        raise Interrupted(folder)


def worker_count(given: GivenDriver, target: Target, workers: int | None) -> int:
    """Return the number of worker processes: 0 for a driver in memory, else `workers`, or as few as possible for None.

    Raises:
        InputError: if there cannot be that many, or the driver cannot drive in them.
    """
    if workers is not None and not (isinstance(workers, int) and 0 <= workers <= MOST_WORKERS):
        raise InputError(f"workers={workers!r} must lie between 0 and {MOST_WORKERS}")
    if given.driver is None:
        return fewest_workers(target) if workers is None else workers
    if workers not in (None, 0, 1):
        raise InputError(
            f"workers={workers} needs a driver that other processes can load: give it by name, as a policy file or "
            f'"module:attribute"; an object in memory drives in this process'
        )
    return 0


@contextmanager
def in_this_process(workers: int) -> Iterator[None]:
    """Execute scenarios as worker processes do: silently and, if there are no workers, in a single thread."""
    logger = logging.getLogger("behavexplor.jit")  # tells that kernels are being compiled
    before = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with nullcontext() if workers else threadpool_limits(1):
            yield
    finally:
        logger.setLevel(before)


def _stoppable(campaign: Campaign) -> AbstractContextManager[None]:
    """Return a context in which the first Ctrl-C lets the current execution end, and the second one ends it at once."""
    if threading.current_thread() is not threading.main_thread():  # which alone may handle signals
        return nullcontext()
    return stopped_by_signals(campaign.stop, signal.default_int_handler)
