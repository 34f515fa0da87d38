"""The format of a run folder: the files that a campaign writes, the tables of its database, and what may be lost.

What confirmation adds is in `behavexplor.campaign.confirmation`, what triage and minimization add in
`behavexplor.triage.findings`; docs/reference/runs.md tells of all files.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

CONFIG: Final = "config.yaml"  # the configuration of the campaign
DATABASE: Final = "campaign.db"  # its executions, with their traces
FAILURES: Final = "failures"  # folder with the records of failed executions, a file each
LOCK: Final = "campaign.lock"  # held by the process that writes
DATABASE_FORMAT: Final = "3"  # version of the database

SCHEMA: Final = """
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL) STRICT;
CREATE TABLE executions (
    id INTEGER PRIMARY KEY,
    record TEXT NOT NULL,  -- JSON: what `behavexplor records` prints
    trace BLOB NOT NULL,  -- read by behavexplor.data.trace.Trace.from_bytes
    elapsed REAL NOT NULL,  -- running time of the campaign when the execution was told [s]
    checksum INTEGER NOT NULL,  -- CRC-32 of id, record and trace
    violated TEXT AS (json_extract(record, '$.violated')),
    degree REAL AS (json_extract(record, '$.degree')),
    novelty REAL AS (json_extract(record, '$.novelty')),
    "end" TEXT AS (json_extract(record, '$.end')),
    record_checksum INTEGER  -- CRC-32 of id, elapsed and record
) STRICT;
"""


def failure_path(run: Path, number: int) -> Path:
    """Return the path of the file of a failed execution in a run folder."""
    return run / FAILURES / f"{number:06d}.json"


@dataclass
class Losses:
    """Data that a run folder has lost."""

    damaged: list[int] = field(default_factory=list)  # numbers of executions that are damaged or missing
    cut_off: bool = False  # whether an unknown number of executions after the last of them is lost, too
    files: list[int] = field(default_factory=list)  # numbers of failed executions whose file is missing or empty

    def sentences(self, folder: Path) -> list[str]:
        """Return a sentence for each kind of loss."""
        said = []
        if self.damaged:
            numbers = _ranges(self.damaged) + (" and everything after" if self.cut_off else "")
            said.append(f"Damaged or missing in {folder / DATABASE}: {numbers}; fuzz --resume executes that again")
        if self.files:
            said.append(f"Lost in {folder / FAILURES}: files of {_ranges(self.files)}; fuzz --resume writes them")
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
