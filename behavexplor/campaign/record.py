"""Record: the figures that a campaign stores for one execution in addition to its trace, as one JSON object."""

import json
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Final, Self

from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

from behavexplor.data.scenario import Scenario, read_scenario
from behavexplor.judge.fault import is_at_fault
from behavexplor.judge.specs import DIFFERS, ERROR

__all__ = ["ERROR", "Record"]


@dataclass(frozen=True, kw_only=True)
class Record:
    """The figures of one execution. Equal campaigns have equal records.

    Fields that an earlier version did not write are None, and are left out when the record is written again.

    Attributes:
        id: number of the execution, counted from 0 in the order in which the search asked for them.
        origin: origin of the scenario in the search, such as "initial" or the kind of a mutation.
        parent: number of the execution whose scenario was mutated; None without a parent.
        end: end of the episode, see `behavexplor.data.trace.ENDS`.
        error: "kind" and "message" of the ADS's own failure, see `behavexplor.execution.ads_error.ADSError`; None if it
            drove.
        duration: simulated time [s].
        violated: names of the violated specs, the most severe first; ("error",) if the ADS itself failed.
        violation_class: class of the violation, see `behavexplor.judge.classes`; None for a passed execution.
        fault: fault for a collision, see `behavexplor.judge.fault`; None without one.
        degree: sum of the violation degrees (the paper's O).
        degrees: violation degree of each spec, by its name.
        novelty: distance to the nearest earlier behavior of the campaign, in [0, 1].
        novel: whether the behavior is new to the campaign.
        search: figures of the search method, JSON values by name.
        scenario: the scenario as `behavexplor.data.scenario.Scenario.to_dict` gives it.
    """

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(strict=True, extra="ignore")

    id: int
    origin: str | None = None
    parent: int | None = None
    end: str
    error: dict[str, str] | None = None
    duration: float | None = None
    violated: tuple[str, ...]
    violation_class: Annotated[str | None, Field(alias="class")] = None
    fault: str | None = None
    degree: float | None = None
    degrees: dict[str, float] = field(default_factory=dict)
    novelty: float | None = None
    novel: bool = False
    search: dict[str, Any] = field(default_factory=dict)
    scenario: dict[str, Any]

    @property
    def failed(self) -> bool:
        """True if the execution violated a spec."""
        return bool(self.violated)

    @property
    def at_fault(self) -> bool:
        """True if the execution failed, and the driving system was at fault as far as the trace can tell."""
        is_ours = self.error is not None and self.error.get("kind") == DIFFERS
        return self.failed and not is_ours and is_at_fault(self.fault)

    def load_scenario(self) -> Scenario:
        """Return the executed scenario.

        Raises:
            InputError: if the record holds no valid scenario.
        """
        return read_scenario(dict(self.scenario))

    def to_dict(self) -> dict[str, Any]:
        """Return the record as JSON values, in a fixed order."""
        values = {
            "id": self.id,
            "origin": self.origin,
            "parent": self.parent,
            "end": self.end,
            "error": None if self.error is None else dict(self.error),
            "duration": self.duration,
            "violated": list(self.violated),
            "class": self.violation_class,
            "fault": self.fault,
            "degree": self.degree,
            "degrees": dict(self.degrees),
            "novelty": self.novelty,
            "novel": self.novel,
            "search": dict(self.search),
            "scenario": dict(self.scenario),
        }
        return {name: value for name, value in values.items() if value is not None or name == "parent"}

    def to_json(self) -> str:
        """Return the record as JSON."""
        return json.dumps(self.to_dict(), allow_nan=False)

    @classmethod
    def from_json(cls, data: bytes | str) -> Self:
        """Return the record that `to_json` wrote, in this or an earlier version.

        Raises:
            ValueError: if it is not a record.
        """
        try:
            return _ADAPTER.validate_json(data)  # type: ignore[return-value]
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            raise ValueError(f"{'.'.join(map(str, first['loc'])) or 'the record'}: {first['msg']}") from None


_ADAPTER: Final = TypeAdapter(Record)
