"""Progress of a campaign in figures: its executions and failures, and the time that it has spent in each stage."""

import math
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from enum import StrEnum, auto
from types import MappingProxyType
from typing import Any, Final, Self

from behavexplor.campaign.record import Record
from behavexplor.judge.classes import words_of


class Stage(StrEnum):
    """What a campaign does at a moment. Stages do not overlap."""

    STARTING = auto()
    ASKING = auto()
    EXECUTING = auto()
    WAITING = auto()
    JUDGING = auto()
    MINING = auto()
    STORING = auto()


STAGES: Final[Mapping[Stage, str]] = MappingProxyType(
    {
        Stage.STARTING: "loading the driver, its environment, the workers and what is stored",
        Stage.ASKING: "choosing scenarios",
        Stage.EXECUTING: "driving in this process",
        Stage.WAITING: "waiting for worker processes, which drive",
        Stage.JUDGING: "reading and judging traces",
        Stage.MINING: "comparing behaviors and learning from results",
        Stage.STORING: "writing to disk",
    }
)
LISTED: Final = 3  # greatest number of failures of each spec that are listed
_MOST_SECONDS: Final = 1e12  # a longer time in a file is damage


@dataclass(frozen=True)
class ClassSummary:
    """One class of failures.

    Attributes:
        id: the class, see `behavexplor.judge.classes`.
        count: number of its failures.
        first: number of the first of them.
        at_fault: number of its failures for which the driving system was at fault, as far as their traces can tell.
    """

    id: str
    count: int
    first: int
    at_fault: int

    @property
    def words(self) -> str:
        """The class as a sentence."""
        return words_of(self.id)

    def after(self, record: Record) -> Self:
        """Return the class with one more failure."""
        return replace(self, count=self.count + 1, at_fault=self.at_fault + record.at_fault)


@dataclass(frozen=True)
class Progress:
    """Progress of a campaign. Every execution that is counted here is on disk."""

    executions: int = 0
    failed: int = 0
    # how many failures, by the most severe spec that they violate. R1 comes before R2 and R3, because a collision also
    # keeps the ego from its destination. "error" counts failures of the ADS itself.
    violations: Mapping[str, int] = field(default_factory=dict)
    # numbers of the first executions that count for each of these specs, at most `LISTED`
    examples: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    classes: Mapping[str, ClassSummary] = field(default_factory=dict)  # by id; each class is a unique violation
    novel: int = 0  # number of executions with a behavior that was new to the campaign
    elapsed: float = 0.0  # running time, including the time before an interruption [s]
    earlier: float = 0.0  # running time before the interruption [s]
    executing: float = 0.0  # time since then that was spent waiting for executions [s]
    resumed: int = 0  # number of executions that were taken from an earlier run
    method: Mapping[str, float] = field(default_factory=dict)  # figures of the search method by name
    # number of the latest execution that was "novel", had a new "class", or counts for a spec, by these names
    last: Mapping[str, int] = field(default_factory=dict)

    @property
    def at_fault(self) -> int:
        """Number of failures for which the driving system was at fault, as far as their traces can tell."""
        return sum(one.at_fault for one in self.classes.values())

    @property
    def largest_first(self) -> tuple[ClassSummary, ...]:
        """The classes of failures, the most frequent first."""
        return tuple(sorted(self.classes.values(), key=lambda one: (-one.count, one.first)))

    def after(self, record: Record, *, resumed: bool) -> Self:
        """Return the progress after one more execution, which may be `resumed`: taken from an earlier run."""
        marks = []  # of `last`
        violations, examples, classes = dict(self.violations), dict(self.examples), dict(self.classes)
        if record.novel:
            marks.append("novel")
        if record.violated:
            worst = record.violated[0]
            marks.append(worst)
            violations[worst] = violations.get(worst, 0) + 1
            examples[worst] = (*examples.get(worst, ()), record.id)[:LISTED]
        kind = record.violation_class
        if kind is not None:
            if kind not in classes:
                marks.append("class")
                classes[kind] = ClassSummary(kind, count=0, first=record.id, at_fault=0)
            classes[kind] = classes[kind].after(record)
        return replace(
            self,
            executions=self.executions + 1,
            failed=self.failed + record.failed,
            violations=violations,
            examples=examples,
            classes=classes,
            novel=self.novel + record.novel,
            resumed=self.resumed + resumed,
            last={**self.last, **dict.fromkeys(marks, record.id)},
        )


class StageClock:
    """A clock that adds up the time in each stage [s]. `earlier` has the times before the campaign was resumed."""

    def __init__(self, earlier: Mapping[str, float] = MappingProxyType({})) -> None:
        self._earlier = earlier
        self.seconds: dict[str, float] = dict.fromkeys(Stage, 0.0)  # time in each stage since this clock was made [s]

    @contextmanager
    def during(self, stage: Stage) -> Iterator[None]:
        """Return a context whose time counts for a stage."""
        begun = time.monotonic()
        try:
            yield
        finally:
            self.seconds[stage] += time.monotonic() - begun

    @property
    def total(self) -> dict[str, float]:
        """Time in each stage, including the time before the campaign was resumed [s]."""
        return {stage: self._earlier.get(stage, 0.0) + seconds for stage, seconds in self.seconds.items()}


def known_stages(values: Any) -> dict[str, float]:
    """Return the time in each stage from JSON values of a file, in the order of `STAGES`; leave out all else."""
    given = values if isinstance(values, dict) else {}
    return {stage: float(given[stage]) for stage in STAGES if _is_time(given.get(stage))}


def executing_and_analysing(stages: Mapping[str, float]) -> tuple[float, float]:
    """Return the time of executing, and that of choosing, judging, learning and storing [s]; nan if it is not known."""
    if not stages:
        return math.nan, math.nan
    executing = stages.get(Stage.EXECUTING, 0.0) + stages.get(Stage.WAITING, 0.0)
    return executing, sum(stages.values()) - executing - stages.get(Stage.STARTING, 0.0)


def _is_time(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value < _MOST_SECONDS
