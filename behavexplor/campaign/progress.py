"""Progress of a campaign in figures."""

import math
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, Final, Self

from behavexplor.campaign.record import Record

STARTING, ASKING, EXECUTING, WAITING, JUDGING, MINING, STORING = (
    "starting",
    "asking",
    "executing",
    "waiting",
    "judging",
    "mining",
    "storing",
)
STAGES: Final[Mapping[str, str]] = MappingProxyType(
    {
        STARTING: "loading the driver, its environment, the workers and what is stored",
        ASKING: "choosing scenarios",
        EXECUTING: "driving in this process",
        WAITING: "waiting for worker processes, which drive",
        JUDGING: "reading and judging traces",
        MINING: "comparing behaviors and learning from results",
        STORING: "writing to disk",
    }
)
_MOST_SECONDS: Final = 1e12


@dataclass(frozen=True)
class Progress:
    """Progress of a campaign. Every execution that is counted here is on disk.

    Attributes:
        executions: number of stored executions.
        failed: number of failed executions.
        violations: numbers of failures by the most severe spec that they violate. R1 comes before R2 and R3, because a
            collision also keeps the ego from its destination. "error" counts failures of the ADS itself.
        classes: numbers of failures by their class, see `behavexplor.judge.classes`. Each class is a unique violation.
        at_fault: numbers of the failures for which the driving system was at fault as far as the trace can tell, by
            their class.
        novel: number of executions with a behavior that was new to the campaign.
        elapsed: running time, including the time before an interruption [s].
        earlier: running time before the interruption [s].
        executing: time since then that was spent waiting for executions [s].
        resumed: number of executions that were taken from an earlier run.
        method: figures of the search method by name.
        last: number of the latest execution that was "novel", had a new "class", or counts for a spec, by these names.
    """

    executions: int = 0
    failed: int = 0
    violations: Mapping[str, int] = field(default_factory=dict)
    classes: Mapping[str, int] = field(default_factory=dict)
    at_fault: Mapping[str, int] = field(default_factory=dict)
    novel: int = 0
    elapsed: float = 0.0
    earlier: float = 0.0
    executing: float = 0.0
    resumed: int = 0
    method: Mapping[str, float] = field(default_factory=dict)
    last: Mapping[str, int] = field(default_factory=dict)

    def after(self, record: Record, *, resumed: bool) -> Self:
        """Return the progress after one more execution.

        Args:
            record: record of the execution.
            resumed: whether it was taken from an earlier run.
        """
        first, kind = record.violated[:1], record.violation_class
        marks = [*(["novel"] if record.novel else []), *first]
        marks += ["class"] if kind is not None and kind not in self.classes else []
        return replace(
            self,
            executions=self.executions + 1,
            failed=self.failed + record.failed,
            violations={**self.violations, **{name: self.violations.get(name, 0) + 1 for name in first}},
            classes=_counted(self.classes, kind),
            at_fault=_counted(self.at_fault, kind if record.at_fault else None),
            novel=self.novel + record.novel,
            resumed=self.resumed + resumed,
            last={**self.last, **dict.fromkeys(marks, record.id)},
        )


def _counted(counts: Mapping[str, int], name: str | None) -> Mapping[str, int]:
    return counts if name is None else {**counts, name: counts.get(name, 0) + 1}


class StageClock:
    """A clock that adds up the time in each stage. Stages do not overlap.

    Args:
        earlier: time in each stage before the campaign was resumed [s].

    Attributes:
        seconds: time in each stage since this clock was made [s].
    """

    def __init__(self, earlier: Mapping[str, float] = MappingProxyType({})) -> None:
        self._earlier = earlier
        self.seconds = dict.fromkeys(STAGES, 0.0)

    @contextmanager
    def during(self, stage: str) -> Iterator[None]:
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
    """Return the stages and times in JSON values from a file, in order, without anything else that they hold."""
    given = values if isinstance(values, dict) else {}
    return {stage: float(given[stage]) for stage in STAGES if _is_time(given.get(stage))}


def executing_and_analysing(stages: Mapping[str, float]) -> tuple[float, float]:
    """Return the time spent on executions, and on everything else but the start [s]; nan if it is not known."""
    if not stages:
        return math.nan, math.nan
    executing = sum(stages.get(stage, 0.0) for stage in (EXECUTING, WAITING))
    return executing, sum(stages.get(stage, 0.0) for stage in (ASKING, JUDGING, MINING, STORING))


def _is_time(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value < _MOST_SECONDS
