"""Checks of a campaign's findings for CI: a threshold of failures, and classes that are known already."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from behavexplor.campaign.progress import ClassSummary
from behavexplor.campaign.run_summary import RunSummary
from behavexplor.commands.outputs import Tested
from behavexplor.commands.wording import class_count
from behavexplor.data.untrusted import read_file
from behavexplor.errors import InputError


@dataclass(frozen=True)
class Checks:
    """What makes a campaign fail as a check.

    Raises:
        InputError: if the share is out of range.
    """

    on_violation: bool = False  # whether any failure makes it fail
    above: float | None = None  # share of failed executions above which it fails; None for no limit
    known: frozenset[str] = frozenset()  # classes of failures that do not count

    def __post_init__(self) -> None:
        if self.above is not None and not 0.0 <= self.above < 1.0:
            raise InputError(f"--fail-above {self.above} must be a share from 0 to below 1, such as 0.05")

    def new_classes(self, found: RunSummary) -> Sequence[ClassSummary]:
        """Return the classes of a run that are not known."""
        return [one for one in found.classes if one.id not in self.known]

    def outcome(self, found: RunSummary) -> tuple[bool, str]:
        """Return whether a run passes, and a sentence on it; an empty one if nothing is checked."""
        new = self.new_classes(found)
        counted = found.failed - sum(one.count for one in found.classes if one.id in self.known)
        share = counted / max(found.executions, 1)
        kind = " that are not known" if self.known else ""
        what = f"{counted} of {found.executions} executions ({share:.1%}) failed, in {class_count(len(new))}{kind}"
        has_failed = self.on_violation and counted > 0
        if self.above is not None:
            has_failed |= share > self.above
            what += f"; {'more' if share > self.above else 'not more'} than {self.above:.1%}"
        if self.above is None and not self.on_violation:
            return True, ""
        return not has_failed, f"The check {'failed' if has_failed else 'passed'}: {what}"


def summary_values(found: RunSummary, run: Path, checks: Checks) -> Mapping[str, Any]:
    """Return the figures of a run, its folder, and its classes that are not known, as JSON values."""
    return {"run": str(run), **found.to_dict(), "new_classes": [one.id for one in checks.new_classes(found)]}


def read_known_classes(path: Path | None) -> frozenset[str]:
    """Return the classes in a file: one in each line, after which a # begins a comment, or a summary in JSON.

    Raises:
        InputError: if the file cannot be read.
    """
    if path is None:
        return frozenset()
    try:
        text = read_file(path, pipes=True).decode()
        if text.lstrip().startswith("{"):
            return frozenset(str(one["id"]) for one in json.loads(text)["classes"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path} is neither a list of classes nor a summary: {error}") from None
    lines = (line.partition("#")[0].strip() for line in text.splitlines())
    return frozenset(line for line in lines if line)


def tested_classes(found: RunSummary, checks: Checks) -> list[Tested]:
    """Return a test case of JUnit for each class of failures, which fails if the class is not known."""
    new = {one.id for one in checks.new_classes(found)}
    return [
        Tested(one.id, f"{one.words}: {one.count} times, first in execution {one.first}" if one.id in new else "")
        for one in found.classes
    ] or [Tested("no failures")]
