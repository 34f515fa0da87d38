"""Checks of a campaign's findings for CI: a threshold of failures, and classes that are known already."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from behavexplor.campaign.progress import ClassSummary
from behavexplor.campaign.run_summary import RunSummary
from behavexplor.commands.wording import class_count
from behavexplor.data.durable import write_given
from behavexplor.data.untrusted import read_file
from behavexplor.errors import InputError


@dataclass(frozen=True)
class Checks:
    """What makes a campaign fail as a check.

    Attributes:
        on_violation: whether any failure makes it fail.
        above: share of failed executions above which it fails; None for no limit.
        known: classes of failures that do not count.

    Raises:
        InputError: if the share is out of range.
    """

    on_violation: bool = False
    above: float | None = None
    known: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        if self.above is not None and not 0.0 <= self.above < 1.0:
            raise InputError(f"--fail-above {self.above} must be a share from 0 to below 1, such as 0.05")

    def new_classes(self, found: RunSummary) -> Sequence[ClassSummary]:
        """Return the classes of a run that are not known."""
        return [one for one in found.classes if one.id not in self.known]

    def failed(self, found: RunSummary) -> str | None:
        """Return a sentence on why a run fails the check; None if it does not."""
        new = self.new_classes(found)
        counted = found.failed - sum(one.count for one in found.classes if one.id in self.known)
        share = counted / max(found.executions, 1)
        kind = " that are not known" if self.known else ""
        what = f"{counted} of {found.executions} executions ({share:.1%}) failed, in {class_count(len(new))}{kind}"
        if self.above is not None and share > self.above:
            return f"The check failed: {what}, more than {self.above:.1%}"
        return f"The check failed: {what}" if self.on_violation and counted else None


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


def write_json(path: Path, values: Mapping[str, Any]) -> None:
    """Write values to a JSON file.

    Raises:
        InputError: if it cannot be written.
    """
    try:
        write_given(path, json.dumps(values, indent=1) + "\n")
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror}") from None
