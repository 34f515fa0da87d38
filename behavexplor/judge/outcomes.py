"""What happened in the scenarios of an evaluation, and the file to which that is written block by block."""

import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from behavexplor.data.durable import append_durably, check_file, writing
from behavexplor.data.trace import ARRIVED, CRASHED, OFF_ROAD, Trace
from behavexplor.errors import InputError
from behavexplor.judge.fault import collision_fault, contact_fault, is_at_fault
from behavexplor.judge.specs import ERROR, SPECS, Collision, Destination, Lines, judge

# the signal that an outcome needs in a highway-env environment; `CRASHED` for any other outcome
_SIGNALS: Final = {ARRIVED: ARRIVED, Lines().name: OFF_ROAD, Destination().name: ARRIVED}
_FIRST_CODE: Final = ord("A")


class Outcomes(NamedTuple):
    """What happened in one scenario."""

    found: tuple[str, ...]  # the outcomes, see `behavexplor.evaluation.Evaluation`
    asked: tuple[str, ...]  # the outcomes, beside the verdicts on a collision, that mean something in the environment
    at_fault: bool  # whether the driver failed by its own fault; see `behavexplor.campaign.record.Record.at_fault`

    @property
    def passed(self) -> bool:
        """True if the driver did not fail."""
        return set(self.found) <= {ARRIVED}


def outcomes_of(trace: Trace) -> Outcomes:
    """Judge a trace."""
    verdict = judge(trace, SPECS)
    arrived = trace.signals[ARRIVED].any() if ARRIVED in trace.signals else trace.end == ARRIVED
    arrived = arrived and trace.end != "collision"  # in a roundabout, an ego may get beyond the entry and crash there
    fault = contact_fault(trace)
    faults = [f"{Collision().name}: {fault}"] if fault else []
    found = (*([ARRIVED] if arrived else []), *verdict.violated, *faults)
    names = (ARRIVED, *(spec.name for spec in SPECS))
    asked = tuple(name for name in names if not trace.signals or _SIGNALS.get(name, CRASHED) in trace.signals)
    at_fault = bool(verdict.violated) and is_at_fault(collision_fault(trace, verdict.violated))
    return Outcomes(found, asked, at_fault)


def outcomes_of_error(kind: str) -> Outcomes:
    """Return the outcomes of a scenario in which the driver fails instead of driving, see `ADSError.kind`."""
    return Outcomes((ERROR, f"{ERROR}: {kind}"), (), at_fault=True)


def packed(outcomes: Sequence[Outcomes]) -> dict[str, Any]:
    """Return the outcomes of scenarios as JSON values: their kinds, and a letter for each scenario."""
    places = {kind: place for place, kind in enumerate(dict.fromkeys(outcomes))}
    return {"kinds": [*places], "codes": "".join(chr(_FIRST_CODE + places[one]) for one in outcomes)}


def unpacked(values: Mapping[str, Any]) -> list[Outcomes]:
    """Return the outcomes from the values that `packed` returned."""
    kinds = [outcomes_from(*kind) for kind in values["kinds"]]
    return [kinds[ord(code) - _FIRST_CODE] for code in values["codes"]]


def outcomes_from(found: Iterable[str], asked: Iterable[str], at_fault: bool) -> Outcomes:
    """Return outcomes from the JSON values of `Outcomes`."""
    return Outcomes(tuple(found), tuple(asked), at_fault)


class OutcomeBlock(NamedTuple):
    """The outcomes of scenarios that follow one another."""

    outcomes: list[Outcomes]
    state: Any  # state of the generator that draws the scenarios behind them, as JSON values


class OutcomeFile:
    """The file of an evaluation's outcomes, from which it goes on after an interruption at any moment.

    It is created if it does not exist. The first line says what is evaluated, as JSON values, and each other one is a
    block. A line that was cut short is removed.

    Raises:
        InputError: if the file cannot be used, or belongs to another evaluation.
    """

    def __init__(self, path: Path, subject: Mapping[str, Any]) -> None:
        self.path = path
        first = json.dumps(subject, sort_keys=True).encode() + b"\n"
        try:
            check_file(path)
            content = path.read_bytes() if path.exists() else b""
            whole = content.rfind(b"\n") + 1
            if whole < len(content):
                os.truncate(path, whole)
            if not whole:
                append_durably(path, first)
        except OSError as error:
            raise InputError(f"{path} cannot be used: {error.strerror}") from None
        if whole and not content.startswith(first):
            raise InputError(
                f"{path} belongs to another evaluation: its driver, environment, seed, or a library was another one"
            )

    def blocks(self) -> Iterator[OutcomeBlock]:
        """Yield the blocks in the file.

        Raises:
            InputError: if it is damaged.
        """
        with self.path.open(encoding="utf-8") as file:
            next(file)
            for number, line in enumerate(file, 2):
                try:
                    values = json.loads(line)
                    yield OutcomeBlock(unpacked(values), values["state"])
                except (ValueError, LookupError, TypeError):
                    raise InputError(f"{self.path}, line {number}, is damaged: delete it and those behind it") from None

    def append(self, block: OutcomeBlock) -> None:
        """Write a block to disk.

        Raises:
            InputError: if it cannot be written, or was deleted since: a new one would be without the earlier blocks.
        """
        if not self.path.is_file():
            raise InputError(f"{self.path} was deleted or moved while the evaluation ran")
        line = json.dumps({**packed(block.outcomes), "state": block.state})
        with writing(self.path):
            append_durably(self.path, line.encode() + b"\n")
