"""`behavexplor triage`: classes, fault and causes of the failures of a run."""

import re
import shlex
import sys
from collections.abc import Sequence

from rich.table import Table

from behavexplor.campaign.confirmation import not_confirmed, read_confirmations
from behavexplor.campaign.run_summary import class_count
from behavexplor.commands import OK, execution_failed, program
from behavexplor.commands.display import Meter
from behavexplor.commands.plain_tables import grid, plain_text
from behavexplor.commands.shared_flags import HowToRun, RunFolder, Switch
from behavexplor.commands.wording import counted, hanging, say, wrapped
from behavexplor.judge.classes import words_of
from behavexplor.triage.findings import Finding, Sighting, Triage, fault_words, tally
from behavexplor.triage.run_triage import RunTriage

_NUMBER = re.compile(r" \d+$")  # at the end of "random actions 7"
_BELOW = " " * 9  # as wide as the number of failures before a class


def triage(run: RunFolder, *, running: HowToRun, afresh: Switch = False) -> int:
    """Classify the failures of a run, and find out whose fault they were and how they could have been avoided.

    Each failure is executed again first. For the rule planner, replays find the weakness that caused the failure. The
    findings are kept in the run folder, in triage.json and witnesses/, and only new failures are examined.

    Args:
        run: The run folder.
        running: Flags; see `behavexplor.commands.shared_flags.Running`.
        afresh: Examine all failures again.
    """
    work = RunTriage(run, running.accepted_config(run), running.n_workers, afresh=afresh)
    try:
        with Meter(sys.stderr, len(work.waiting), "failures", quiet=running.quiet) as meter:
            found = work.examine(meter.show)
    except RuntimeError as error:
        return execution_failed(f"A failure could not be examined or confirmed: {error}")
    unconfirmed = [wrapped(line) for line in not_confirmed(read_confirmations(run))]
    say("\n".join([report(found), *unconfirmed]))
    preventable = next((finding for finding in found.findings if finding.avoidance), None)
    if preventable is not None:
        command = f"{program()} replay {shlex.quote(str(run))} {preventable.id}"
        say(f"\nHow the first preventable collision could have been avoided:\n{command} --avoided")
    return OK


def report(found: Triage) -> str:
    """Return the findings as text for the terminal."""
    flaky = sum(not finding.same_verdict for finding in found.findings)
    again = f"{flaky} did not happen again" if flaky else "all happened again when they were driven again"
    failures, classes = counted(len(found.findings), "failure"), class_count(len(found.classes))
    summary = f"{failures} in {found.executions} executions, in {classes}; {again}"
    lines = [
        wrapped(summary),
        "",
        *_class_lines(found),
        *_witnesses(found.findings),
        *_last_chances(found.findings),
        "",
        wrapped(
            "A class groups failures that look alike. "
            "It begins with the violated requirement: R1 collision, R2 illegal line touched, R3 destination missed."
        ),
    ]
    if found.weaknesses:
        lines += [
            wrapped(
                "Causes such as R2-2 are weaknesses of the rule planner, not requirements: "
                "R2-2 is the second weakness that leads to violations of R2."
            ),
            "",
            plain_text(_weakness_table(found)),
            "",
            wrapped(
                "reached: executions in which the weakness could matter; "
                "triggered: in which it changed the planner's output; "
                "detected: failures that it caused; first: number of the first such execution."
            ),
        ]
    return "\n".join(lines)


def _witnesses(findings: Sequence[Finding]) -> list[str]:
    """Return who or what avoided the preventable collisions."""
    names = tally(_NUMBER.sub("", finding.avoidance) for finding in findings if finding.avoidance)
    return ["", wrapped(f"Preventable collisions were avoided by: {names}")] if names else []


def _last_chances(findings: Sequence[Finding]) -> list[str]:
    """Return what the policy did at the last decisions at which its crashes could still be avoided."""
    words = tally(finding.last_chance.words for finding in findings if finding.last_chance)
    return ["", wrapped(f"At the last chance to avoid a crash, the driver chose: {words}")] if words else []


def _class_lines(found: Triage) -> list[str]:
    """Return each class as a sentence with its number of failures, and below it its id, examples, faults and causes."""
    lines = []
    for class_id, findings in found.classes.items():
        first = findings[0].id
        shown = next((finding.id for finding in findings if finding.same_trace), first)
        hint = "" if shown == first else f", look at {shown}"
        faults = tally(fault_words(finding.fault) for finding in findings if finding.fault)
        causes = tally(finding.cause for finding in findings)
        lines.append(hanging(f"{len(findings):7}  ", words_of(class_id)))
        lines.append(hanging(_BELOW, f"{class_id}, first {first}{hint}"))
        for name, text in (("fault", faults), ("cause", causes)):
            if text:
                lines.append(hanging(f"{_BELOW}{name}: ", text))
    return lines


def _weakness_table(found: Triage) -> Table:
    columns = ("weakness", "reached", "first", "triggered", "first", "detected", "first")
    table = grid(*columns, numbers=columns[1:])
    for name, record in found.weaknesses.items():
        sightings = (record.reached, record.triggered, record.detected)
        table.add_row(name, *(cell for sighting in sightings for cell in _cells(sighting)))
    return table


def _cells(sighting: Sighting) -> tuple[str, str]:
    """Return the number of executions, and that of the first one, which is empty if there is none."""
    return str(sighting.count), "" if sighting.first is None else str(sighting.first)
