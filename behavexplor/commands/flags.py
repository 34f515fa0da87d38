"""Flags that override a configuration."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from threading import Timer
from typing import Annotated, Any, Final

import tyro

from behavexplor.errors import InputError
from behavexplor.execution.executor import MOST_WORKERS, available_cores

Trust = Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="DIGEST")]
Switch = Annotated[bool | None, tyro.conf.DisallowNone]  # --name or --no-name; None without either
WAITING: Final = "Loading the driver; first-time compilation can take a minute ..."


def flag(metavar: str | None, default: object, text: str | None = None) -> Any:
    """Return the argument settings of a flag that overrides the configuration.

    Args:
        metavar: name of the value in the help text; None for a `Switch`, which has no value.
        default: value without the flag, for the help text; None for none.
        text: help text; by default, that of the command's docstring.
    """
    return tyro.conf.arg(
        metavar=metavar, help_behavior_hint=f"(default: {default})" if default is not None else "", help=text
    )


def check_unchanged(given: Mapping[str, Any], stored: Any, what: str) -> None:
    """Check that flags beside --resume do not change the configuration of what is resumed.

    Args:
        given: values of the flags by key of the configuration.
        stored: the configuration.
        what: what is resumed, for the message.

    Raises:
        InputError: if a value differs.
    """
    for name, value in given.items():
        if value != getattr(stored, name):
            option = name.replace("_", "-")
            raise InputError(f"--{option} cannot be changed with --resume: the {what} has {getattr(stored, name)!r}")


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
