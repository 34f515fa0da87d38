"""Progress of a campaign in figures."""

from collections.abc import Mapping
from dataclasses import dataclass, field


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
