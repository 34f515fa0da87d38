"""Progress display of long tasks: a bar on a terminal, and otherwise a line every few seconds."""

import time
from types import TracebackType
from typing import Self, TextIO

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from behavexplor.api.plain_console import PlainConsole
from behavexplor.errors import printable

LINE_SECONDS = 10.0  # interval between plain lines [s]


class Meter:
    """Shows how many items of a task are done.

    Args:
        stream: output stream. A terminal shows a bar; any other stream gets a line every few seconds.
        total: total number of items.
        things: name of the items, such as "executions".
        quiet: whether to show nothing.
    """

    def __init__(self, stream: TextIO, total: int, things: str, *, quiet: bool) -> None:
        self._console = PlainConsole(file=stream, quiet=quiet)
        self._total, self._things = total, things
        self._last_line = time.monotonic()
        texts = [TextColumn(f"{{task.{name}}}", markup=False) for name in ("fields[things]", "description")]
        columns = (BarColumn(), MofNCompleteColumn(), texts[0], TimeRemainingColumn(), texts[1])
        shows_bar = self._console.is_terminal and not quiet
        self._bar = Progress(*columns, console=self._console) if shows_bar else None
        self._task = self._bar.add_task("", total=total, things=printable(things)) if self._bar else None

    def __enter__(self) -> Self:
        """Show the bar, if there is one."""
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop the bar and leave its last state visible."""
        if self._bar is not None:
            self._bar.stop()

    def show(self, done: int, text: str = "") -> None:
        """Show the number of finished items, followed by a text."""
        if self._bar is not None and self._task is not None:
            self._bar.update(self._task, completed=done, description=printable(text))
        elif time.monotonic() - self._last_line >= LINE_SECONDS:
            self._last_line = time.monotonic()
            self._console.print(f"{done} of {self._total} {self._things}  {text}".rstrip(), soft_wrap=True)
