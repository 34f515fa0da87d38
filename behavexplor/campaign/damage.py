"""Reports on data that a run folder has lost."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from behavexplor.campaign.config import CONFIG

DATABASE, FAILURES = "campaign.db", "failures"


@dataclass
class Losses:
    """Data that a run folder has lost.

    Attributes:
        damaged: numbers of executions that are damaged or missing.
        cut_off: whether an unknown number of executions after the last of them is lost, too.
        files: numbers of failed executions whose file is missing.
    """

    damaged: list[int] = field(default_factory=list)
    cut_off: bool = False
    files: list[int] = field(default_factory=list)

    def sentences(self, folder: Path) -> list[str]:
        """Return a sentence for each kind of loss."""
        said = []
        if self.damaged:
            numbers = _ranges(self.damaged) + (" and everything after" if self.cut_off else "")
            said.append(f"Damaged or missing in {folder / DATABASE}: {numbers}; fuzz --resume executes that again")
        if self.files:
            said.append(f"Missing in {folder / FAILURES}: files of {_ranges(self.files)}; fuzz --resume writes them")
        if not (folder / CONFIG).is_file():
            said.append(f"{folder / CONFIG} is missing: restore it, or the run can neither be replayed nor resumed")
        return said


def _ranges(numbers: Sequence[int]) -> str:
    """Return increasing numbers in words, such as "execution 3" or "executions 3, 5 to 9"."""
    ranges: list[list[int]] = []
    for number in numbers:
        if ranges and number == ranges[-1][1] + 1:
            ranges[-1][1] = number
        else:
            ranges.append([number, number])
    named = ", ".join(str(first) if first == last else f"{first} to {last}" for first, last in ranges)
    return f"execution{'s' if len(numbers) > 1 else ''} {named}"
