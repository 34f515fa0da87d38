"""Progress of a campaign or of another long task, on a terminal or as plain lines; and the summary of a campaign."""

import shlex
import time
from collections import Counter
from collections.abc import Sequence
from itertools import zip_longest
from threading import Timer
from typing import Self, TextIO

from rich.live import Live
from rich.panel import Panel
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as ProgressBar
from rich.table import Table

from behavexplor.api.observers import PlainConsole
from behavexplor.campaign.config import Budget
from behavexplor.campaign.confirmation import not_confirmed, read_confirmations
from behavexplor.campaign.progress import Progress
from behavexplor.campaign.run_summary import class_count, words_of_others_faults
from behavexplor.campaign.store import Store
from behavexplor.campaign.uniform_rate import UniformRate, explained, own_rate
from behavexplor.commands.wording import clock, hanging, wrapped
from behavexplor.errors import printable, sentence
from behavexplor.judge.discovery import Discovery
from behavexplor.judge.specs import ERROR

LINE_SECONDS = 10.0  # interval between plain lines [s]
_WIDE = 100  # least width of a terminal that shows two columns, and the figures of the search [characters]
_LISTED_CLASSES = 8  # number of listed classes
_FIGURES = {  # figures of search methods, in words
    "corpus": "kept scenarios",
    "mean_energy": "mean weight in selection",
    "max_energy": "greatest weight in selection",
    "novel_kept": "kept for new behavior",
}


class Display:
    """Shows the progress of a campaign, unless `quiet`: a live screen on a terminal, else a line every few seconds."""

    def __init__(self, stream: TextIO, budget: Budget, *, quiet: bool) -> None:
        self._stream, self._console = stream, PlainConsole(file=stream, quiet=quiet)
        self.budget = budget
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
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Leave the last state of the live screen on the terminal."""
        if self._live is not None:
            self._live.stop()

    def meter(self, total: int, things: str) -> "Meter":
        """Return a meter for another task of the campaign, once the live screen is closed."""
        return Meter(self._stream, total, things, quiet=self._console.quiet)

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
        found = f"{progress.failed} failed in {class_count(len(progress.classes))}"
        times = f"{rate(progress):.1f}/s, {self._left(progress)} left"
        return f"{clock(progress.elapsed)}  {self._done(progress)}, {found}; {times}"

    def _screen(self, progress: Progress) -> Panel:
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
        right += [("by another's fault", str(progress.failed - progress.at_fault))]
        if self._console.width >= _WIDE:
            figures = {_FIGURES.get(name, name.replace("_", " ")): value for name, value in progress.method.items()}
            right += [(name, f"{value:.4g}") for name, value in figures.items()]
            table = _side_by_side([left, right])
        else:
            table = _side_by_side([left + right])
        return Panel(table, title="behavexplor", title_align="left", expand=False)

    def _done(self, progress: Progress) -> str:
        if self.budget.executions is None:
            return f"{progress.executions} executions"
        return f"{progress.executions} of {self.budget.executions} executions"

    def _left(self, progress: Progress) -> str:
        if self.budget.seconds is not None:
            return clock(max(self.budget.seconds - progress.elapsed, 0.0))
        fresh = progress.executions - progress.resumed
        if self.budget.executions is None or not fresh or not rate(progress):
            return "?"
        return clock((self.budget.executions - progress.executions) / rate(progress))


def _side_by_side(columns: Sequence[Sequence[tuple[str, str]]]) -> Table:
    """Return names and values as a table without lines."""
    table = Table.grid(padding=(0, 2))
    for style in ("dim", "") * len(columns):
        table.add_column(style=style, no_wrap=True)
    for row in zip_longest(*columns, fillvalue=("", "")):
        table.add_row(*(cell for pair in row for cell in pair))
    return table


def summary(progress: Progress, store: Store, program: str, method: str, budget: Budget) -> str:
    """Return the summary of a campaign: its findings, its run folder, and commands to continue with."""
    head = f"{progress.executions} executions in {clock(progress.elapsed)} ({rate(progress):.1f} per second), "
    lines = [wrapped(f"{head}{share(progress.novel, progress)} of them with new behavior")]
    uniform = UniformRate.stored(store)
    found = own_rate(method, progress.executions, progress.failed, budget, progress.elapsed, uniform)
    rate_words = explained(method, found)
    if not progress.failed:
        command = f"{program} fuzz --resume {shlex.quote(str(store.folder))} --budget N"
        lines += [
            wrapped(f"None failed. {rate_words}"),
            f"All results are in {store.folder}",
            "Search with a larger budget:",
            command,
        ]
        return "\n".join(lines)
    classes = f"{class_count(len(progress.classes))}{words_of_others_faults(progress.failed - progress.at_fault)}"
    failed = f"{progress.failed} failed ({share(progress.failed, progress)}) in {classes}"
    lines += [wrapped(f"{failed}. {rate_words}"), "Each failure is counted under its most severe type:"]
    width = max(12, *map(len, progress.violations))
    lines += [_line_of(name, width, progress) for name, count in progress.violations.items() if count]
    kinds = Counter({one.id: one.count for one in progress.classes.values()})
    outlook = Discovery.of(kinds.elements(), progress.executions).outlook(method)
    lines += [*_errors(progress, store), *_listed_classes(progress), wrapped(outlook)]
    lines += [f"All results are in {store.folder}", "with a file for each failure in its folder failures."]
    folder = shlex.quote(str(store.folder))
    first = min(one.first for one in progress.classes.values())
    lines += ["Replay the first failure:", f"{program} replay {folder} {first}"]  # on lines of their own,
    lines += ["Write a report on the run:", f"{program} report {folder}"]  # so that they can be copied
    lines += ["Drive it in a loop of your own (replay shows the loop):"]
    lines += [f"env = behavexplor.open_run({str(store.folder)!r}).env({first})"]
    return "\n".join(lines)


def _errors(progress: Progress, store: Store) -> list[str]:
    """Return a line about a driver that failed instead of driving, and lines on what highway-env did not confirm."""
    found = [one for one in progress.classes.values() if one.id.startswith(f"{ERROR}/")]
    lines = []
    if found:
        number, first = sum(one.count for one in found), min(one.first for one in found)
        count = "every execution" if number == progress.executions else f"{number} executions"
        error = store.execution(first).record.error or {}
        text = f"The driver itself failed in {count}, first in {first}: {sentence(error.get('message', ''))}"
        lines.append(wrapped(text))
    return lines + [wrapped(line) for line in not_confirmed(read_confirmations(store.folder))]


def _line_of(spec: str, width: int, progress: Progress) -> str:
    """Return a line with the number of violations of a spec and the first of them."""
    count, listed = progress.violations[spec], progress.examples[spec]
    more = ", ..." if count > len(listed) else ""
    return f"  {spec:{width}} {count:5}   executions {', '.join(map(str, listed))}{more}"


def _listed_classes(progress: Progress) -> list[str]:
    """Return the most frequent classes with a title, each as a sentence and by its id."""
    shown, count = progress.largest_first[:_LISTED_CLASSES], len(progress.classes)
    lines = ["The classes:" if len(shown) == count else f"The {len(shown)} most frequent classes:"]
    for one in shown:
        lines += [hanging(f"{one.count:7}  ", one.words), hanging(" " * 9, f"{one.id}, first {one.first}")]
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
    """Shows how many `things` of a task are done, unless `quiet`: by a bar on a terminal, else by lines."""

    def __init__(self, stream: TextIO, total: int, things: str, *, quiet: bool) -> None:
        self._console = PlainConsole(file=stream, quiet=quiet)
        self._total, self._things = total, things
        self._begin = self._last_line = time.monotonic()
        names = TextColumn("{task.fields[things]}", markup=False)
        text = TextColumn("{task.description}", markup=False)
        columns = (BarColumn(), MofNCompleteColumn(), names, TimeRemainingColumn(), text)
        shows_bar = self._console.is_terminal and not quiet
        self._bar = ProgressBar(*columns, console=self._console) if shows_bar else None
        self._task = self._bar.add_task("", total=total, things=printable(things)) if self._bar else None
        self._waiting = Timer(LINE_SECONDS, self.show, [0])  # for those who wait for the first item
        self._waiting.daemon = True

    def __enter__(self) -> Self:
        """Show the bar, if there is one."""
        if self._bar is not None:
            self._bar.start()
        else:
            self._waiting.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop the bar and leave its last state visible."""
        self._waiting.cancel()
        if self._bar is not None:
            self._bar.stop()

    def show(self, done: int, text: str = "") -> None:
        """Show the number of finished items, followed by a text."""
        self._waiting.cancel()
        if self._bar is not None and self._task is not None:
            self._bar.update(self._task, completed=done, description=printable(text))
        elif time.monotonic() - self._last_line >= LINE_SECONDS:
            self._last_line = time.monotonic()
            remaining = max(self._total - done, 0)  # a training may do more than its total
            about = f", about {clock((self._last_line - self._begin) * remaining / done)} left" if done else ""
            line = f"{done} of {self._total} {self._things}{about}  {text}"
            self._console.print(line.rstrip(), soft_wrap=True)
