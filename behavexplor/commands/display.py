"""Output of a campaign: a live screen on a terminal or plain lines elsewhere, and the summary."""

import shlex
import time
from collections import Counter
from collections.abc import Sequence
from types import TracebackType
from typing import NamedTuple, Self, TextIO

from rich.live import Live
from rich.panel import Panel
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as ProgressBar
from rich.table import Table

from behavexplor.api.observers import PlainConsole
from behavexplor.campaign.config import Budget
from behavexplor.campaign.progress import Progress
from behavexplor.campaign.store import Store
from behavexplor.commands.wording import class_count, clock, hanging
from behavexplor.errors import printable, sentence
from behavexplor.judge.classes import words_of
from behavexplor.judge.discovery import Discovery
from behavexplor.judge.specs import DIFFERS, ERROR

LINE_SECONDS = 10.0  # interval between plain lines [s]
_LISTED_FAILURES = 3  # number of listed failures for each spec
_LISTED_CLASSES = 8  # number of listed classes
_FIGURES = {  # figures of search methods, in words
    "corpus": "kept scenarios",
    "mean_energy": "mean weight in selection",
    "max_energy": "greatest weight in selection",
    "novel_kept": "kept for new behavior",
}


class Display:
    """Shows the progress of a campaign.

    Args:
        stream: output stream. A terminal shows a live screen; any other stream gets a line every few seconds.
        budget: budget of the campaign.
        quiet: whether to show nothing.
    """

    def __init__(self, stream: TextIO, budget: Budget, *, quiet: bool) -> None:
        self._console = PlainConsole(file=stream, quiet=quiet)
        self._budget = budget
        self._live = (
            Live(console=self._console, auto_refresh=False) if self._console.is_terminal and not quiet else None
        )
        self._last_line: float | None = None

    def say(self, sentence: str) -> None:
        """Print a line."""
        self._console.print(sentence, soft_wrap=True)

    def __enter__(self) -> Self:
        """Open the live screen, if there is one."""
        if self._live is not None:
            self._live.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Leave the last state of the live screen on the terminal."""
        if self._live is not None:
            self._live.__exit__(kind, error, trace)

    def show(self, progress: Progress) -> None:
        """Show the progress of the campaign."""
        if self._live is not None:
            self._live.update(self._screen(progress), refresh=True)
            return
        if self._last_line is None:
            self._last_line = time.monotonic()
        if time.monotonic() - self._last_line >= LINE_SECONDS:
            self._last_line = time.monotonic()
            self.say(self._line(progress))

    def _line(self, progress: Progress) -> str:
        violations = ", ".join(f"{name} {count}" for name, count in progress.violations.items())
        return (
            f"{clock(progress.elapsed)}  {self._done(progress)}, {rate(progress):.1f}/s, "
            f"{progress.failed} failed ({violations}) in {class_count(len(progress.classes))}, {_at_fault(progress)}, "
            f"{share(progress.novel, progress)} with new behavior, "
            f"{self._left(progress)} left"
        )

    def _screen(self, progress: Progress) -> Panel:
        table = Table.grid(padding=(0, 2))
        for style in ("dim", "", "dim", ""):
            table.add_column(style=style, no_wrap=True)
        left = [
            ("running", clock(progress.elapsed)),
            ("time left", self._left(progress)),
            ("executions", self._done(progress)),
            ("speed", f"{rate(progress):.1f} per second"),
            ("executing", f"{progress.executing / max(progress.elapsed - progress.earlier, 1e-9):.0%} of the time"),
            ("new behavior", f"{share(progress.novel, progress)}{_ago(progress, 'novel')}"),
        ]
        right = [("failed", f"{progress.failed} ({share(progress.failed, progress)})")]
        right += [(name, f"{count}{_ago(progress, name)}") for name, count in progress.violations.items()]
        right += [("classes of failures", f"{len(progress.classes)}{_ago(progress, 'class')}")]
        right += [("at fault", f"{sum(progress.at_fault.values())} in {class_count(len(progress.at_fault))}")]
        figures = {_FIGURES.get(name, name.replace("_", " ")): value for name, value in progress.method.items()}
        right += [(name, f"{value:.4g}") for name, value in figures.items()]
        blank = ("", "")
        for i in range(max(len(left), len(right))):
            table.add_row(*(left[i] if i < len(left) else blank), *(right[i] if i < len(right) else blank))
        return Panel(table, title="behavexplor", title_align="left", expand=False)

    def _done(self, progress: Progress) -> str:
        if self._budget.executions is None:
            return f"{progress.executions} executions"
        return f"{progress.executions} of {self._budget.executions} executions"

    def _left(self, progress: Progress) -> str:
        if self._budget.seconds is not None:
            return clock(max(self._budget.seconds - progress.elapsed, 0.0))
        fresh = progress.executions - progress.resumed
        if self._budget.executions is None or not fresh or not rate(progress):
            return "?"
        return clock((self._budget.executions - progress.executions) / rate(progress))


def summary(progress: Progress, store: Store, program: str, method: str) -> str:
    """Return the summary of a campaign: its findings, its run folder, and commands to continue with."""
    lines = [
        f"{progress.executions} executions in {clock(progress.elapsed)} ({rate(progress):.1f} per second), "
        f"{share(progress.novel, progress)} of them with new behavior"
    ]
    if not progress.failed:
        command = f"{program} fuzz --resume {shlex.quote(str(store.folder))} --budget N"
        lines += [f"None failed. All results are in {store.folder}", "Search with a larger budget:", command]
        return "\n".join(lines)
    failures = [_Failure(*row) for row in store.failures()]
    kinds = [failure.kind for failure in failures if failure.kind is not None]
    unique = f" in {class_count(len(set(kinds)))}, {_at_fault(progress)}" if kinds else ""
    failed = f"{progress.failed} failed ({share(progress.failed, progress)}){unique}"
    lines += [hanging("", f"{failed}; each failure is counted under its most severe type:")]
    width = max(12, *map(len, progress.violations))
    lines += [_line_of(name, width, [one for one in failures if one.spec == name]) for name in progress.violations]
    lines += [*_errors(failures, progress, store), *_listed_classes(failures), *_outlook(kinds, progress, method)]
    lines += [f"All results are in {store.folder}", "with a file for each failure in its folder failures."]
    folder = shlex.quote(str(store.folder))
    lines += ["Replay the first failure:", f"{program} replay {folder} {failures[0].number}"]  # on lines of their own,
    lines += ["Write a report on the run:", f"{program} report {folder}"]  # so that they can be copied
    return "\n".join(line for line in lines if line)


def _at_fault(progress: Progress) -> str:
    """Return the failures for which the driving system was at fault, in words."""
    return f"{sum(progress.at_fault.values())} at fault in {class_count(len(progress.at_fault))}"


def _outlook(kinds: Sequence[str], progress: Progress, method: str) -> list[str]:
    """Return a line on what has not been found yet; none without classes."""
    if not kinds:
        return []
    return [hanging("", Discovery.of(kinds, progress.executions).outlook(method))]


class _Failure(NamedTuple):
    number: int
    spec: str
    kind: str | None


def _errors(failures: list["_Failure"], progress: Progress, store: Store) -> list[str]:
    """Return a line about a driver that failed instead of driving, and one about what highway-env did not confirm."""
    errors = [failure for failure in failures if failure.spec == ERROR]
    own, unconfirmed = (
        [failure.number for failure in errors if (failure.kind == f"{ERROR}/{DIFFERS}") == is_ours]
        for is_ours in (False, True)
    )
    lines = []
    for numbers, what in ((own, "The driver itself failed"), (unconfirmed, "highway-env did not confirm the failure")):
        if numbers:
            count = "every execution" if len(numbers) == progress.executions else f"{len(numbers)} executions"
            error = store.execution(numbers[0]).record.error or {}
            lines.append(f"{what} in {count}, first in {numbers[0]}: {sentence(error.get('message', ''))}")
    return lines


def _line_of(spec: str, width: int, failures: list[_Failure]) -> str:
    """Return a line with the number of violations of a spec and the first of them; empty if there are none."""
    if not failures:
        return ""
    more = ", ..." if len(failures) > _LISTED_FAILURES else ""
    listed = ", ".join(str(failure.number) for failure in failures[:_LISTED_FAILURES])
    return f"  {spec:{width}} {len(failures):5}   executions {listed}{more}"


def _listed_classes(failures: list[_Failure]) -> list[str]:
    """Return the most frequent classes with a title, each as a sentence and by its id."""
    counts = Counter(failure.kind for failure in failures if failure.kind is not None)
    if not counts:
        return []
    first = {failure.kind: failure.number for failure in reversed(failures)}
    shown = counts.most_common(_LISTED_CLASSES)
    title = "The classes:" if len(shown) == len(counts) else f"The {len(shown)} most frequent classes:"
    lines = [title]
    for kind, count in shown:
        lines += [hanging(f"{count:7}  ", words_of(str(kind))), f"         {kind}, first {first[kind]}"]
    return lines


def rate(progress: Progress) -> float:
    """Return the number of executions per second of running time."""
    return progress.executions / progress.elapsed if progress.elapsed else 0.0


def share(count: int, progress: Progress) -> str:
    """Return a number of executions as a percentage of all executions."""
    return f"{count / max(progress.executions, 1):.1%}"


def _ago(progress: Progress, mark: str) -> str:
    """Return how many executions ago something last happened, in words; empty if it never happened."""
    if mark not in progress.last:
        return ""
    ago = progress.executions - 1 - progress.last[mark]
    return f", last {ago} ago" if ago else ", the latest"


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
        self._begin = self._last_line = time.monotonic()
        texts = [TextColumn(f"{{task.{name}}}", markup=False) for name in ("fields[things]", "description")]
        columns = (BarColumn(), MofNCompleteColumn(), texts[0], TimeRemainingColumn(), texts[1])
        shows_bar = self._console.is_terminal and not quiet
        self._bar = ProgressBar(*columns, console=self._console) if shows_bar else None
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
            left = clock((self._total / done - 1) * (self._last_line - self._begin)) if done else "unknown time"
            line = f"{done} of {self._total} {self._things}, about {left} left  {text}"
            self._console.print(line.rstrip(), soft_wrap=True)
