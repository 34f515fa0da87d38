"""Minimized failures of runs as plain data: `minimized/` in the run folder."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from behavexplor.data.durable import write_durably
from behavexplor.data.logical import Size
from behavexplor.data.scenario import Scenario, read_scenario
from behavexplor.triage.findings import FORMAT, Finding, read_made

MINIMIZED: Final = "minimized"


@dataclass(frozen=True, kw_only=True)
class Minimized:
    """A minimized failure.

    Attributes:
        id: number of the execution in which the failure was found.
        class_id: class of the failure.
        fault: fault for a collision, by triage where the run has been triaged, otherwise by the trace alone.
        cause: weakness of the rule planner that caused the failure; None without triage.
        reproduced: whether the failure happened again. Only then it was minimized. It is not repeated if the driver
            ended or blocked its process.
        is_minimal: whether the scenario cannot be simplified by one more step; False if `LIMIT` was reached before.
        found: size of the found scenario.
        minimal: size of the minimized scenario.
        executions: number of candidates that were executed.
        violated: names of the specs that the minimized scenario violates, the most severe first.
        scenario: the minimized scenario.
    """

    id: int
    class_id: str
    fault: str | None
    cause: str | None
    reproduced: bool
    is_minimal: bool
    found: Size
    minimal: Size
    executions: int
    violated: tuple[str, ...]
    scenario: dict[str, Any]

    def load_scenario(self) -> Scenario:
        """Return the minimized scenario."""
        return read_scenario(dict(self.scenario))

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as JSON values."""
        return {**asdict(self), "found": list(self.found), "minimal": list(self.minimal)}

    def write(self, folder: Path, trace: bytes) -> None:
        """Write the minimized failure and the trace of its scenario into a run folder."""
        write_durably(trace_path(folder, self.id), trace)
        write_durably(
            minimized_path(folder, self.id), json.dumps({"format": FORMAT, **self.to_dict()}, indent=1) + "\n"
        )


def minimized_path(folder: Path, number: int) -> Path:
    """Return the file of a minimized failure in a run folder."""
    return folder / MINIMIZED / f"{number:06d}.json"


def trace_path(folder: Path, number: int) -> Path:
    """Return the file with the trace of a minimized failure in a run folder."""
    return minimized_path(folder, number).with_suffix(".trace")


def read_minimized(folder: Path) -> dict[int, Minimized]:
    """Return the minimized failures of a run by the numbers of their executions."""
    found = (
        read_made(Minimized, path, "`behavexplor minimize`") for path in sorted((folder / MINIMIZED).glob("*.json"))
    )
    return {one.id: one for one in found}


def known_minimized(folder: Path, findings: Mapping[int, Finding]) -> dict[int, Minimized]:
    """Return the minimized failures of a run that need not be minimized again, by the numbers of their executions.

    Left out are those whose trace is missing, and those that were minimized before triage found another fault or cause,
    which they may have lost.

    Args:
        folder: run folder.
        findings: findings of triage by the numbers of the executions; none before triage.
    """
    return {
        number: one
        for number, one in read_minimized(folder).items()
        if trace_path(folder, number).is_file()
        and (number not in findings or (one.fault, one.cause) == (findings[number].fault, findings[number].cause))
    }
