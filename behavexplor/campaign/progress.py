"""Progress of a campaign, as figures."""

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Progress:
    """How far a campaign has come; every execution counted here is on disk.

    Attributes:
        executions: how many are stored.
        failed: how many of them violate a spec.
        violations: failures by the first spec that they violate, R1 before R2 before R3: a collision keeps
            the ego from its destination, too; and "error", what else an ADS did than driving.
        classes: failures by their class, see `behavexplor.judge.classes`; one for each unique violation.
        novel: how many showed a behavior that was new to the campaign.
        elapsed: running time, also before an interruption [s].
        earlier: part of it before the interruption [s].
        executing: part of the rest spent waiting for executions [s].
        resumed: executions that had been stored by an earlier run.
        method: figures of the search method by name.
        last: the latest execution that was "novel", of a new "class", or counts for a spec, by that name.
    """

    executions: int = 0
    failed: int = 0
    violations: Mapping[str, int] = field(default_factory=dict)
    classes: Mapping[str, int] = field(default_factory=dict)
    novel: int = 0
    elapsed: float = 0.0
    earlier: float = 0.0
    executing: float = 0.0
    resumed: int = 0
    method: Mapping[str, float] = field(default_factory=dict)
    last: Mapping[str, int] = field(default_factory=dict)
