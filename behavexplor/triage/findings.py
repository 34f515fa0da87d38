"""What is known of a run's failures, as plain data in its folder.

`triage.json` and `witnesses/` have the findings of triage, and `minimized/` has the minimized failures.
"""

import json
import shlex
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Self, TypeVar

import numpy as np

from behavexplor.campaign.record import ERROR, Record
from behavexplor.data.array_types import Floats
from behavexplor.data.conventions import MANEUVERS
from behavexplor.data.durable import write_durably
from behavexplor.data.scenario import Scenario, Size, read_scenario
from behavexplor.data.trace import Trace
from behavexplor.data.untrusted import read_file
from behavexplor.data.validation import checked
from behavexplor.errors import InputError
from behavexplor.judge.classes import violation_class
from behavexplor.judge.events import REQUIREMENTS

T = TypeVar("T")

FINDINGS_FORMAT: Final = 1  # of the files of triage and of minimization
TRIAGE, WITNESSES, MINIMIZED = "triage.json", "witnesses", "minimized"  # names in a run folder
_FAULTS: Final = MappingProxyType(
    {
        "ego_cut_in": "the ego's (it cut in)",
        "npc_rear_end": "another vehicle's (it hit the ego from behind)",
        "struck_stationary": "another vehicle's (the ego stood)",
        "npc_wreck": "not clear (the other vehicle had crashed before)",
        "preventable": "the ego's (preventable)",
        "standing_still_avoids_it": "not clear (only standing still avoids it)",
        "unpreventable": "not the ego's (no way to avoid it was found)",
        "other": "not clear",
    }
)


@dataclass(frozen=True)
class LastChance:
    """The last decision at which the ego could still have avoided a crash, within the policy's own actions.

    It is exact: every sequence of actions that begins later was driven, and crashes.
    """

    back: int  # decisions from it to the crash; 1 is the decision in which the ego crashed
    did: str  # action that the policy chose
    saving: tuple[str, ...]  # actions after which some sequence of actions does not crash soon

    @property
    def words(self) -> str:
        """What was chosen, and what would have avoided the crash."""
        return f"{self.did} instead of {' or '.join(self.saving)}"


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
        last_chance: last chance to avoid a crash; None if none was found, see `behavexplor.triage.closed_loop`.
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
    last_chance: LastChance | None = None
    signature: str | None = None
    cause: str | None = None
    necessary: tuple[str, ...] = ()
    sufficient: tuple[str, ...] = ()


@dataclass(frozen=True)
class Sighting:
    """Executions in which something was observed."""

    count: int = 0  # number of executions
    first: int | None = None  # number of the first of these executions; None if there are none

    @classmethod
    def of(cls, executions: Sequence[int]) -> Self:
        """Summarize executions, given by their numbers in order."""
        return cls(len(executions), executions[0] if executions else None)


@dataclass(frozen=True)
class WeaknessRecord:
    """Coverage of one weakness of the rule planner by a campaign."""

    reached: Sighting  # executions in which the gate of the weakness was open
    triggered: Sighting  # executions in which the weakness changed the output of its module
    detected: Sighting  # failures with this weakness as the primary cause


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
        write_durably(folder / TRIAGE, json.dumps({"format": FINDINGS_FORMAT, **asdict(self)}, indent=1) + "\n")

    @property
    def classes(self) -> dict[str, list[Finding]]:
        """Findings by class, the largest class first; classes of equal size in the order in which they were found."""
        groups: dict[str, list[Finding]] = {}
        for finding in self.findings:
            groups.setdefault(finding.class_id, []).append(finding)
        return dict(sorted(groups.items(), key=lambda group: (-len(group[1]), group[1][0].id)))


def read_made(kind: type[T], path: Path, command: str) -> T:
    """Read a dataclass that a command has written into a run folder as JSON; `command` is for messages.

    Raises:
        InputError: if the file cannot be read, is damaged, or has another format version.
    """
    mend = f"delete it and run {command} again"
    try:
        values = json.loads(read_file(path))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path} cannot be read: {error}; {mend}") from None
    found = values.pop("format", None) if isinstance(values, dict) else None
    if found != FINDINGS_FORMAT:
        raise InputError(f"{path} has format {found}, but this version reads format {FINDINGS_FORMAT}: {mend}")
    return checked(kind, values, str(path))


def known_findings(folder: Path) -> dict[int, Finding]:
    """Return the findings of a run by the numbers of their executions; none before triage."""
    if not (folder / TRIAGE).is_file():
        return {}
    return {finding.id: finding for finding in Triage.read(folder).findings}


@dataclass(frozen=True, eq=False)
class Witness:
    """Commands that avoid a recorded collision."""

    name: str  # kind of evasion: "careful and competent", "ideal braking", "anticipation" or "sampled"
    begin: float  # time up to which the ego drives as recorded [s]
    frequency: int  # frequency of the commands, which is that of the simulation [Hz]
    commands: Floats  # accelerations [m/s2] and steering angles [rad], shape (T, 2)


@dataclass(frozen=True)
class OtherDriver:
    """A driver that avoids a recorded crash in traffic that reacts, by its actions from the start of the scenario."""

    name: str  # kind of driver, such as "careful"
    actions: tuple[int, ...]  # its meta-actions, one for each decision, by their index in highway-env


def fault_words(fault: str) -> str:
    """Return a verdict of `behavexplor.triage.blame` in words: whose fault a collision was, and why."""
    return _FAULTS.get(fault, fault.replace("_", " "))


def tally(names: Iterable[str | None]) -> str:
    """Return names as text, the most frequent first. Counts are included if there are several different names."""
    counts = Counter(name for name in names if name is not None).most_common()
    return ", ".join(f"{count} x {name}" if len(counts) > 1 else name for name, count in counts)


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
        is_minimal: whether no further step simplifies the scenario; False if `minimization.LIMIT` was reached before.
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
        write_durably(minimized_trace_path(folder, self.id), trace)
        write_durably(
            minimized_path(folder, self.id), json.dumps({"format": FINDINGS_FORMAT, **self.to_dict()}, indent=1) + "\n"
        )


def minimized_path(folder: Path, number: int) -> Path:
    """Return the file of a minimized failure in a run folder."""
    return folder / MINIMIZED / f"{number:06d}.json"


def minimized_trace_path(folder: Path, number: int) -> Path:
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
    which they may have lost. There are no findings before triage.
    """
    return {
        number: one
        for number, one in read_minimized(folder).items()
        if minimized_trace_path(folder, number).is_file()
        and (number not in findings or (one.fault, one.cause) == (findings[number].fault, findings[number].cause))
    }
