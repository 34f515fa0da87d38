"""`behavexplor minimize`: the simplest scenario in which a failure still happens."""

import sys
from collections.abc import Sequence
from statistics import median
from typing import Annotated

import tyro

from behavexplor.commands import OK, execution_failed
from behavexplor.commands.display import Meter
from behavexplor.commands.plain_tables import grid, plain_text
from behavexplor.commands.shared_flags import HowToRun, RunFolder, Switch
from behavexplor.commands.wording import counted, hanging, say, wrapped
from behavexplor.errors import InputError
from behavexplor.judge.classes import words_of
from behavexplor.triage.findings import Minimized, fault_words
from behavexplor.triage.minimization import LIMIT, RunMinimization

_COLUMNS = ("id", "parts", "free values", "executions")


def minimize(
    run: RunFolder,
    numbers: Annotated[tuple[int, ...], tyro.conf.Positional, tyro.conf.arg(name="ids", metavar="[ID ...]")] = (),
    *,
    every: Annotated[Switch, tyro.conf.arg(name="all")] = False,
    running: HowToRun,
    afresh: Switch = False,
) -> int:
    """Find the simplest scenario in which a failure still happens: the fewest parts, and the plainest values.

    The class of the failure and the fault for it stay the same. After `triage`, the cause stays the same, too. The
    results are kept in the run folder, in minimized/, and shown by `report`.

    Args:
        run: The run folder.
        numbers: Numbers of failed executions; by default the first failure of each class.
        every: Minimize all failures.
        running: Flags; see `behavexplor.commands.shared_flags.Running`.
        afresh: Minimize failures again that have been minimized before. Those for which triage has found another fault
            or cause since then are always minimized again.
    """
    if every and numbers:
        raise InputError("Give either numbers of executions or --all")
    work = RunMinimization(run, running.accepted_config(run), running.n_workers, numbers, every=every, afresh=afresh)
    if work.waiting and not running.quiet:
        many = counted(len(work.waiting), "failure")
        text = f"{many} to minimize, each in at most {LIMIT} executions of simpler scenarios"
        say(wrapped(text), file=sys.stderr)
    try:
        with Meter(sys.stderr, len(work.waiting), "failures", quiet=running.quiet) as meter:
            found = work.minimize(meter.show)
    except RuntimeError as error:
        return execution_failed(f"A failure could not be minimized: {error}")
    say(table(found))
    return OK


def table(found: Sequence[Minimized]) -> str:
    """Return the table for the terminal, with a summary."""
    if not found:
        return "The run has no failures, so there is nothing to minimize."
    lost = [minimal for minimal in found if not minimal.reproduced]
    kept = [minimal for minimal in found if minimal.reproduced]
    lines = [
        wrapped(
            f"Execution {minimal.id} did not fail in the same way when it was repeated, or its driver ended or blocked "
            "its process, so it was not minimized"
        )
        for minimal in lost
    ]
    if kept:
        made = grid(*_COLUMNS, numbers=_COLUMNS)
        for one in kept:
            sizes = (f"{one.found.parts} -> {one.minimal.parts}", f"{one.found.values} -> {one.minimal.values}")
            made.add_row(str(one.id), *sizes, str(one.executions))
        parts, values = (
            (median(one.found[i] for one in kept), median(one.minimal[i] for one in kept)) for i in range(2)
        )
        lines += [
            plain_text(made),
            "",
            *(line for one in kept for line in _named(one)),
            "",
            wrapped(
                f"{counted(len(kept), 'failure')}; in the median, parts {parts[0]:g} -> {parts[1]:g}, free values "
                f"{values[0]:g} -> {values[1]:g} (a part: a scripted vehicle, or draws of highway-env that belong "
                "together)"
            ),
        ]
        unfinished = sum(not one.is_minimal for one in kept)
        lines += (
            [f"{unfinished} of them may have an even simpler scenario: the limit was reached"] if unfinished else []
        )
    return "\n".join(lines)


def _named(one: Minimized) -> list[str]:
    """Return the class of a failure in lines, with the fault if it is known."""
    lines = [hanging(f"{one.id:6}  ", f"{words_of(one.class_id)} ({one.class_id})")]
    return lines + ([hanging(" " * 8, f"fault: {fault_words(one.fault)}")] if one.fault else [])
