"""What triage found out about the failures of a run, as plain data: `triage.json` and `witnesses/` in a run folder."""

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from behavexplor.campaign.record import ERROR, Record
from behavexplor.campaign.store import write_durably
from behavexplor.data.trace import Trace
from behavexplor.data.validation import checked
from behavexplor.errors import InputError
from behavexplor.judge.classes import violation_class
from behavexplor.judge.events import REQUIREMENTS

Floats = NDArray[np.float64]

FORMAT: Final = 1
TRIAGE, WITNESSES = "triage.json", "witnesses"


@dataclass(frozen=True, kw_only=True)
class Finding:
    """What is known of one failure.

    Attributes:
        id: of the execution.
        spec: "R1", "R2" or "R3", the first one violated; "error" for an ADS that did something else than driving.
        class_id: see `behavexplor.judge.classes.ViolationClass`; for errors "error/" and their kind.
        words: the class in a line.
        same_verdict: whether it violated the same specs when it was run again.
        same_trace: whether the same happened then.
        fault: whose it was, see `behavexplor.triage.blame.Blame`; None unless it was a collision.
        in_junction: whether the ego was in a junction then.
        avoidance: kind of the witness, None without one; the file is `Triage.witness_path`.
        tried: how many ways to avoid it were driven.
        signature: see `behavexplor.triage.signatures`; None unless the rule planner drove.
        cause: the primary one, see `behavexplor.triage.counterfactual.Cause`; None likewise.
        necessary: and the weaknesses without which it does not happen,
        sufficient: and those with which it does without others.
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
    """In how many executions something was seen.

    Attributes:
        count: of executions.
        first: the first of them, None if there is none.
    """

    count: int = 0
    first: int | None = None

    @classmethod
    def of(cls, executions: Sequence[int]) -> Self:
        """Of some executions, in order."""
        return cls(len(executions), executions[0] if executions else None)


@dataclass(frozen=True)
class WeaknessRecord:
    """How far a campaign got with one weakness of the rule planner.

    Attributes:
        reached: executions in which its gate was open.
        triggered: in which it changed what its module gave.
        detected: failures of which it is the primary cause.
    """

    reached: Sighting
    triggered: Sighting
    detected: Sighting


@dataclass(frozen=True)
class Triage:
    """What is known of the failures of a run.

    Attributes:
        env: the environment.
        ads: the system under test.
        executions: how many the run had.
        findings: one for each failure, in the order of the executions.
        weaknesses: of the rule planner, by name; empty for other systems.
    """

    env: str
    ads: str
    executions: int
    findings: tuple[Finding, ...] = ()
    weaknesses: dict[str, WeaknessRecord] = field(default_factory=dict)

    @classmethod
    def read(cls, folder: Path) -> Self:
        """What is known of the failures of a run.

        Args:
            folder: of the run.

        Raises:
            InputError: if nothing is, or the file is damaged or of another version.
        """
        path = folder / TRIAGE
        if not path.is_file():
            raise InputError(f"{folder} has no {TRIAGE}: make it with `behavexplor triage {folder}`")
        try:
            values = json.loads(path.read_bytes())
        except (OSError, ValueError, RecursionError) as error:
            raise InputError(f"{path} cannot be read, delete it and make it again: {error}") from None
        found = values.pop("format", None) if isinstance(values, dict) else None
        if found != FORMAT:
            raise InputError(f"{path} has format {found}; this version reads format {FORMAT}: delete it, make it again")
        return checked(cls, values, f"triage in {path}")

    def write(self, folder: Path) -> None:
        """Write the file as a whole."""
        write_durably(folder / TRIAGE, json.dumps({"format": FORMAT, **asdict(self)}, indent=1) + "\n")

    @property
    def classes(self) -> dict[str, list[Finding]]:
        """The findings by class, the largest first, then the one found first."""
        groups: dict[str, list[Finding]] = {}
        for finding in self.findings:
            groups.setdefault(finding.class_id, []).append(finding)
        return dict(sorted(groups.items(), key=lambda group: (-len(group[1]), group[1][0].id)))


@dataclass(frozen=True, eq=False)
class Witness:
    """How a collision could have been avoided.

    Attributes:
        name: kind of the evasion: "careful and competent", "ideal braking", "anticipation" or "sampled".
        begin: up to then it drives as recorded [s].
        frequency: of the commands, one for each step of the simulation [Hz].
        commands: acceleration [m/s2] and steering [rad], shape (T, 2).
    """

    name: str
    begin: float
    frequency: int
    commands: Floats


def counted(names: Iterable[str | None]) -> str:
    """Names in words, the most frequent first, with their counts where there are several."""
    counts = Counter(name for name in names if name is not None).most_common()
    if len(counts) == 1:
        return counts[0][0].replace("_", " ")
    return ", ".join(f"{name} {count}" for name, count in counts).replace("_", " ")


def witness_path(folder: Path, number: int) -> Path:
    """The file of the witness against the failure of an execution."""
    return folder / WITNESSES / f"{number:06d}.json"


def witness_values(witness: Witness) -> dict[str, Any]:
    """A witness as JSON values."""
    return {**asdict(witness), "commands": np.asarray(witness.commands).tolist()}


def read_witness(path: Path) -> Witness:
    """A witness from its file.

    Raises:
        InputError: if it is missing or damaged.
    """
    try:
        return witness_from(json.loads(path.read_bytes()))
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise InputError(f"{path} is no witness: {error}") from None


def witness_from(values: Mapping[str, Any]) -> Witness:
    """The inverse of `witness_values`.

    Raises:
        ValueError: if nobody could drive it.
    """
    commands = np.array(values["commands"], dtype=np.float64).reshape(-1, 2)
    frequency = int(values["frequency"])
    if not len(commands) or not np.isfinite(commands).all() or frequency < 1:
        raise ValueError("it has no commands that can be driven")
    return Witness(str(values["name"]), float(values["begin"]), frequency, commands)


def trace_finding(record: Record, trace: Trace) -> Finding:
    """Return what the record and the trace of a failure tell, before the failure has been executed again."""
    kind = violation_class(trace, record.violated)
    spec = kind.spec if kind else REQUIREMENTS.get(record.violated[0], record.violated[0])
    class_id, words = (kind.id, kind.words) if kind else (spec, "Violates " + ", ".join(record.violated))
    return Finding(id=record.id, spec=spec, class_id=class_id, words=words, same_verdict=False, same_trace=False)


def error_finding(record: Record, *, happened_again: bool) -> Finding:
    """Return the finding for an execution in which the ADS failed."""
    failure = record.error or {}
    return Finding(
        id=record.id,
        spec=ERROR,
        class_id=f"{ERROR}/{failure.get('kind', '')}",
        words=f"The ADS failed: {failure.get('message', '')}",
        same_verdict=happened_again,
        same_trace=happened_again,
    )
