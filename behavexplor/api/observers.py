"""Progress of a campaign for users of the Python interface: nothing in scripts, one line in notebooks, or a bar.

Also the console on which this and the tables of the commands are printed.
"""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from html import escape
from importlib import import_module
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar
from rich.text import Text

from behavexplor.campaign.config import Budget
from behavexplor.campaign.progress import Progress
from behavexplor.errors import printable

Observer = Callable[[Progress], None]


class PlainConsole(Console):
    """A console on which a text is nothing but text: control characters, markup and emoji codes have no effect."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(highlight=False, markup=False, emoji=False, **settings)

    def render_str(self, text: str, **settings: Any) -> Text:
        """Return a text as it is shown. All strings that are printed, also in tables, go through this."""
        return super().render_str(printable(text), **settings)


def in_notebook() -> bool:
    """Return whether this process is the kernel of a notebook."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    return type(shell).__name__ == "ZMQInteractiveShell"


@contextmanager
def observed(progress: bool | Observer | None, budget: Budget) -> Iterator[Observer]:
    """Return a function that shows the progress of a campaign: `progress` itself, or a line or a bar if asked for.

    True shows a bar, or a line in a notebook; False shows nothing; None shows the line in notebooks only.
    """
    if callable(progress):
        yield progress
    elif progress is False or (progress is None and not in_notebook()):
        yield lambda _: None
    elif in_notebook():
        yield _notebook_line(budget)
    else:
        with _bar(budget) as show:
            yield show


def progress_words(progress: Progress) -> str:
    """Return what a campaign has found so far in a few words."""
    count = len(progress.classes)
    failed = f"{progress.failed} failed in {count} class{'' if count == 1 else 'es'}"
    return f"{progress.executions} executions, {failed}"


def _notebook_line(budget: Budget) -> Observer:
    """Return a function that keeps one line of a notebook's output up to date."""
    notebook: Any = import_module("IPython.display")  # which is there, and need not be installed elsewhere
    shown = notebook.display(notebook.HTML(""), display_id=True)

    def show(progress: Progress) -> None:
        done, total = _share(progress, budget)
        words = escape(progress_words(progress))
        shown.update(notebook.HTML(f'<progress value="{done:g}" max="{total:g}"></progress> {words}'))

    return show


@contextmanager
def _bar(budget: Budget) -> Iterator[Observer]:
    """Show a bar on standard error."""
    console = PlainConsole(stderr=True)
    with Bar(BarColumn(), TextColumn("{task.description}"), TimeRemainingColumn(), console=console) as bar:
        task = bar.add_task("", total=budget.executions or budget.seconds)

        def show(progress: Progress) -> None:
            done, _ = _share(progress, budget)
            bar.update(task, completed=done, description=progress_words(progress))

        yield show


def _share(progress: Progress, budget: Budget) -> tuple[float, float]:
    """Return the used and the whole budget, both in executions or in seconds."""
    if budget.executions is not None:
        return progress.executions, budget.executions
    seconds: Any = budget.seconds
    return min(progress.elapsed, seconds), seconds
