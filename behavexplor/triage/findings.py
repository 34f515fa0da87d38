"""Findings of triage about the failures of a run, as plain data: `triage.json` and `witnesses/` in the run folder."""

import json
import shlex
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final, Self, TypeVar

import numpy as np

from behavexplor.campaign.record import ERROR, Record
from behavexplor.data.array_types import Floats
from behavexplor.data.conventions import MANEUVERS
from behavexplor.data.durable import write_durably
from behavexplor.data.trace import Trace
from behavexplor.data.untrusted import read_file
from behavexplor.data.validation import checked
from behavexplor.errors import InputError
from behavexplor.judge.classes import violation_class
from behavexplor.judge.events import REQUIREMENTS

T = TypeVar("T")

FORMAT: Final = 1  # of the files of triage and of minimization
TRIAGE, WITNESSES = "triage.json", "witnesses"


@dataclass(frozen=True, kw_only=True)
class Finding:
    """The finding about one failure.

    Attributes:
        id: number of the execution.
        spec: first violated spec: "R1", "R2", "R3" or the name of a user's spec; "error" if the ADS failed instead of
            returning an action.
        class_id: identifier of the `behavexplor.judge.classes.ViolationClass`; "error/" and the kind of the
            failure if the ADS failed.
        words: the class as a sentence.
        same_verdict: whether the failure violated the same specs when it was executed again.
        same_trace: whether the second execution had the same trace.
        fault: kind of a `behavexplor.triage.blame.Blame`; before triage the verdict on the trace alone. None unless the
            failure is a collision.
        in_junction: whether the ego was in a junction at the collision.
        avoidance: name of the witness, stored in the file that `witness_path` returns; None without a witness.
        tried: number of evasions that were executed in search of a witness.
        signature: likely cause, see `behavexplor.triage.signatures`; None unless the rule planner drove.
        cause: primary cause, see `behavexplor.triage.counterfactual.Cause`; None unless the rule planner drove.
        necessary: weaknesses without which the failure does not happen.
        sufficient: weaknesses of the violated spec that cause the failure even if all other weaknesses of that spec are
            switched off.
    """

    id: int
    spec: str
    class_id: str
    words: str
    same_verdict: bool
    same_trace: bool
    fault: str | None = None
    in_junction: bool | None = None
    avoidance: str | None = None
    tried: int = 0
    signature: str | None = None
    cause: str | None = None
    necessary: tuple[str, ...] = ()
    sufficient: tuple[str, ...] = ()


@dataclass(frozen=True)
class Sighting:
    """Executions in which something was observed.

    Attributes:
        count: number of executions.
        first: number of the first of these executions; None if there are none.
    """

    count: int = 0
    first: int | None = None

    @classmethod
    def of(cls, executions: Sequence[int]) -> Self:
        """Summarize executions, given by their numbers in order."""
        return cls(len(executions), executions[0] if executions else None)


@dataclass(frozen=True)
class WeaknessRecord:
    """Coverage of one weakness of the rule planner by a campaign.

    Attributes:
        reached: executions in which the gate of the weakness was open.
        triggered: executions in which the weakness changed the output of its module.
        detected: failures with this weakness as the primary cause.
    """

    reached: Sighting
    triggered: Sighting
    detected: Sighting


@dataclass(frozen=True)
class Triage:
    """The findings about all failures of a run.

    Attributes:
        env: environment.
        ads: driving system under test.
        executions: number of executions of the run.
        findings: one finding for each failure, in the order of the executions.
        weaknesses: coverage of the rule planner's weaknesses by name; empty for other driving systems.
    """

    env: str
    ads: str
    executions: int
    findings: tuple[Finding, ...] = ()
    weaknesses: dict[str, WeaknessRecord] = field(default_factory=dict)

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Read the findings from a run folder.

        Raises:
            InputError: if the folder has no findings, or their file is damaged or has another format version.
        """
        path = folder / TRIAGE
        if not path.is_file():
            command = f"`behavexplor triage {shlex.quote(str(folder))}`"
            raise InputError(f"{folder} has no {TRIAGE}: create it with {command}")
        return read_made(cls, path, "`behavexplor triage`")

    def write(self, folder: Path) -> None:
        """Write the findings into a run folder. The file is replaced as a whole."""
        write_durably(folder / TRIAGE, json.dumps({"format": FORMAT, **asdict(self)}, indent=1) + "\n")

    @property
    def classes(self) -> dict[str, list[Finding]]:
        """Findings by class, the largest class first; classes of equal size in the order in which they were found."""
        groups: dict[str, list[Finding]] = {}
        for finding in self.findings:
            groups.setdefault(finding.class_id, []).append(finding)
        return dict(sorted(groups.items(), key=lambda group: (-len(group[1]), group[1][0].id)))


def read_made(kind: type[T], path: Path, command: str) -> T:
    """Return what a command has written into a run folder, as JSON with the fields of a dataclass and a `FORMAT`.

    Raises:
        InputError: if the file cannot be read, is damaged, or has another format version.
    """
    mend = f"delete it and run {command} again"
    try:
        values = json.loads(read_file(path))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path} cannot be read: {error}; {mend}") from None
    found = values.pop("format", None) if isinstance(values, dict) else None
    if found != FORMAT:
        raise InputError(f"{path} has format {found}, but this version reads format {FORMAT}: {mend}")
    return checked(kind, values, str(path))


def known_findings(folder: Path) -> dict[int, Finding]:
    """Return the findings of a run by the numbers of their executions; none before triage."""
    if not (folder / TRIAGE).is_file():
        return {}
    return {finding.id: finding for finding in Triage.read(folder).findings}


@dataclass(frozen=True, eq=False)
class Witness:
    """Commands that avoid a recorded collision.

    Attributes:
        name: kind of evasion: "careful and competent", "ideal braking", "anticipation" or "sampled".
        begin: time up to which the ego drives as recorded [s].
        frequency: frequency of the commands, which is that of the simulation [Hz].
        commands: accelerations [m/s2] and steering angles [rad], shape (T, 2).
    """

    name: str
    begin: float
    frequency: int
    commands: Floats


@dataclass(frozen=True)
class OtherDriver:
    """A driver that avoids a recorded crash in traffic that reacts, by its actions from the start of the scenario.

    Attributes:
        name: kind of driver, such as "careful".
        actions: its meta-actions, one for each decision, by their index in highway-env.
    """

    name: str
    actions: tuple[int, ...]


def counted(names: Iterable[str | None]) -> str:
    """Return names as text, the most frequent first. Counts are included if there are several different names."""
    counts = Counter(name for name in names if name is not None).most_common()
    if len(counts) == 1:
        return counts[0][0].replace("_", " ")
    return ", ".join(f"{name} {count}" for name, count in counts).replace("_", " ")


def witness_path(folder: Path, number: int) -> Path:
    """Return the file of the witness for an execution."""
    return folder / WITNESSES / f"{number:06d}.json"


def witness_values(witness: Witness | OtherDriver) -> dict[str, Any]:
    """Return a witness as JSON values."""
    if isinstance(witness, OtherDriver):
        return asdict(witness)
    return {**asdict(witness), "commands": np.asarray(witness.commands).tolist()}


def read_witness(path: Path) -> Witness | OtherDriver:
    """Read a witness from its file.

    Raises:
        InputError: if the file is missing or damaged.
    """
    try:
        return witness_from(json.loads(read_file(path)))
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise InputError(f"{path} is not a witness: {error}") from None


def witness_from(values: Mapping[str, Any]) -> Witness | OtherDriver:
    """Build a witness from JSON values. This is the inverse of `witness_values`.

    Raises:
        ValueError: if there are no commands, a command is not finite, or the frequency is below 1 Hz; or if there are
            no actions, or an action is not one of highway-env's.
    """
    if "actions" in values:
        actions = tuple(int(action) for action in values["actions"])
        if not actions or not set(actions) <= set(range(len(MANEUVERS))):
            raise ValueError("it has no actions that can be driven")
        return OtherDriver(str(values["name"]), actions)
    commands = np.array(values["commands"], dtype=np.float64).reshape(-1, 2)
    frequency = int(values["frequency"])
    if not len(commands) or not np.isfinite(commands).all() or frequency < 1:
        raise ValueError("it has no commands that can be driven")
    return Witness(str(values["name"]), float(values["begin"]), frequency, commands)


def trace_finding(record: Record, trace: Trace) -> Finding:
    """Return the part of a failure's finding that follows from its record and trace, before it is executed again."""
    kind = violation_class(trace, record.violated)
    spec = kind.spec if kind else REQUIREMENTS.get(record.violated[0], record.violated[0])
    class_id, words = (kind.id, kind.words) if kind else (spec, "Violated " + ", ".join(record.violated))
    return Finding(
        id=record.id,
        spec=spec,
        class_id=class_id,
        words=words,
        same_verdict=False,
        same_trace=False,
        fault=record.fault,
    )


def error_finding(record: Record, *, happened_again: bool) -> Finding:
    """Return the finding for an execution in which the ADS failed."""
    failure = record.error or {}
    kind, message = failure.get("kind", ""), failure.get("message", "")
    return Finding(
        id=record.id,
        spec=ERROR,
        class_id=f"{ERROR}/{kind}",
        words=f"The driving system failed: {message}",
        same_verdict=happened_again,
        same_trace=happened_again,
    )
