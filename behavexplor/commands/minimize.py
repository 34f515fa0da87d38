"""`behavexplor minimize`: the simplest scenario in which a failure still happens."""

import sys
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from statistics import median
from typing import Annotated

import tyro

from behavexplor.campaign.provenance import JUDGED, Consent
from behavexplor.campaign.same_driver import accepted_run
from behavexplor.campaign.store import Store
from behavexplor.commands import EXECUTION_FAILED, OK, program
from behavexplor.commands.display import Meter
from behavexplor.commands.flags import Switch, Trust, chosen_workers
from behavexplor.commands.wording import counted, grid, plain_text, say
from behavexplor.errors import InputError, sentence
from behavexplor.triage.findings import known_findings
from behavexplor.triage.minimization import chosen_failures, minimize_failures
from behavexplor.triage.minimized import Minimized, known_minimized

_NUMBERS = ("vehicles", "free values", "executions")


def minimize(
    run: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")],
    numbers: Annotated[tuple[int, ...], tyro.conf.Positional, tyro.conf.arg(name="ids", metavar="[ID ...]")] = (),
    *,
    every: Annotated[Switch, tyro.conf.arg(name="all")] = False,
    workers: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: the cores)")] = None,
    trust: Trust = (),
    afresh: Switch = False,
    unconfined: Switch = False,
    quiet: Switch = False,
) -> int:
    """Find the simplest scenario in which a failure still happens: the fewest vehicles, and the plainest values.

    The class of the failure and the fault for it stay the same. After `triage`, the cause stays the same, too. The
    results are kept in the run folder, in minimized/, and shown by `report`.

    Args:
        run: The run folder.
        numbers: Numbers of failed executions; by default the first failure of each class.
        every: Minimize all failures.
        workers: Number of worker processes; 0 uses this process. The results do not depend on it.
        trust: Allow the folder or policy file with this digest ("sha256:...") to execute code. May be repeated.
        afresh: Minimize failures again that have been minimized before. Those for which triage has found another fault
            or cause since then are always minimized again.
        unconfined: Allow a driver that is not shipped with behavexplor to write files and use the network.
        quiet: Print only the table.
    """
    if every and numbers:
        raise InputError("Give either numbers of executions or --all")
    count, config = chosen_workers(workers), accepted_run(run, Consent(trust, unconfined), JUDGED)
    with closing(Store.read(run)) as store:
        chosen = chosen_failures(store, numbers, every=every)
        findings = known_findings(run)
        known = {} if afresh else known_minimized(run, findings)
        found = {number: known[number] for number in chosen if number in known}
        waiting = [number for number in chosen if number not in found]
        try:
            with Meter(sys.stderr, len(waiting), "failures", quiet=quiet) as meter:
                for minimal in minimize_failures(store, config, waiting, findings, count):
                    found[minimal.id] = minimal
                    meter.show(len(found) - len(chosen) + len(waiting))
        except OSError as error:
            raise InputError(f"The run folder {run} cannot be written: {error.strerror}") from None
        except RuntimeError as error:
            say(f"{program()}: {sentence(f'A failure could not be minimized: {error}')}", file=sys.stderr)
            return EXECUTION_FAILED
    say(table([found[number] for number in chosen]))
    return OK


def table(found: Sequence[Minimized]) -> str:
    """Return the table for the terminal, with a summary."""
    if not found:
        return "The run has no failures, so there is nothing to minimize."
    lost = [minimal for minimal in found if not minimal.reproduced]
    kept = [minimal for minimal in found if minimal.reproduced]
    lines = [
        f"Execution {minimal.id} did not fail in the same way when it was repeated, or its driver ended or blocked its "
        "process, so it was not minimized"
        for minimal in lost
    ]
    if kept:
        made = grid("class", "fault", "id", *_NUMBERS, numbers=("id", *_NUMBERS))
        for one in kept:
            sizes = (f"{one.found.parts} -> {one.minimal.parts}", f"{one.found.values} -> {one.minimal.values}")
            fault = (one.fault or "").replace("_", " ")
            made.add_row(one.class_id, fault, str(one.id), *sizes, str(one.executions))
        parts, values = (
            (median(one.found[i] for one in kept), median(one.minimal[i] for one in kept)) for i in range(2)
        )
        lines += [
            plain_text(made),
            "",
            f"{counted(len(kept), 'failure')}; in the median, vehicles {parts[0]:g} -> {parts[1]:g}, "
            f"free values {values[0]:g} -> {values[1]:g}",
        ]
        unfinished = sum(not one.is_minimal for one in kept)
        lines += (
            [f"{unfinished} of them may have an even simpler scenario: the limit was reached"] if unfinished else []
        )
    return "\n".join(lines)
