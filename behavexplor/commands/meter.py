"""How far something is that takes its time: a bar on a terminal, a line now and then elsewhere."""

import time
from types import TracebackType
from typing import Self, TextIO

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

LINE_SECONDS = 10.0  # between two plain lines [s]


class Meter:
    """Shows how many of a number of things are done.

    Args:
        stream: where to; a terminal gets a bar, anything else a line now and then.
        total: how many there are.
        things: what they are called.
        quiet: show nothing.
    """

    def __init__(self, stream: TextIO, total: int, things: str, *, quiet: bool) -> None:
        self._console = Console(file=stream, quiet=quiet, highlight=False, markup=False)
        self._total, self._things = total, things
        self._last_line = time.monotonic()
        columns = (BarColumn(), MofNCompleteColumn(), TextColumn(things), TimeRemainingColumn())
        shows_bar = self._console.is_terminal and not quiet
        self._bar = Progress(*columns, TextColumn("{task.description}"), console=self._console) if shows_bar else None
        self._task = self._bar.add_task("", total=total) if self._bar else None

    def __enter__(self) -> Self:
        """Show the bar, if there is one."""
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Leave the bar as it is."""
        if self._bar is not None:
            self._bar.stop()

    def show(self, done: int, text: str = "") -> None:
        """Show how many are done, and what else there is to say."""
        if self._bar is not None and self._task is not None:
            self._bar.update(self._task, completed=done, description=text)
        elif time.monotonic() - self._last_line >= LINE_SECONDS:
            self._last_line = time.monotonic()
            self._console.print(f"{done} of {self._total} {self._things}  {text}".rstrip(), soft_wrap=True)
