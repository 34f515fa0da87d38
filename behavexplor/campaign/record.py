"""Record: the figures that a campaign stores for one execution in addition to its trace, as one JSON object.

A member of that object is a text `"name": value`. Members that are encoded already are written as they are, because
encoding takes a good part of a campaign's own time.
"""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Annotated, Any, ClassVar, Final, Self

from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

from behavexplor.data.scenario import Scenario, read_scenario
from behavexplor.judge.fault import is_at_fault
from behavexplor.judge.specs import ERROR, Verdict

__all__ = ["ERROR", "Record"]

_KEYS: Final = {"violation_class": "class"}  # names in JSON by field, where the two differ
_FIELDS: Final = {key: name for name, key in _KEYS.items()}  # and the fields by their names in JSON
encode_json: Final = json.JSONEncoder(allow_nan=False).encode  # `json.dumps` would make an encoder for each call


class WrittenValues(Mapping[str, Any]):
    """Values by name in a JSON text. It is decoded when one of them is asked for; most texts are only written again."""

    def __init__(self, text: str) -> None:
        self.text = text

    @cached_property
    def _decoded(self) -> dict[str, Any]:
        values: dict[str, Any] = json.loads(self.text)
        return values

    def __getitem__(self, name: str) -> Any:
        return self._decoded[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._decoded)

    def __len__(self) -> int:
        return len(self._decoded)


@dataclass(frozen=True, kw_only=True)
class Ancestry:
    """Where an execution's scenario comes from in the search.

    Attributes:
        id: number of the execution, counted from 0 in the order in which the search asked for them.
        origin: origin of the scenario, such as "initial" or the kind of a mutation.
        parent: number of the execution whose scenario was mutated; None without a parent.
    """

    id: int
    origin: str | None = None
    parent: int | None = None


@dataclass(frozen=True, kw_only=True)
class Result:
    """How an execution ended, and whether and how it failed.

    Attributes:
        end: end of the episode, see `behavexplor.data.trace.ENDS`.
        error: "kind" and "message" of the ADS's own failure, see `behavexplor.execution.executor.ADSError`; None if it
            drove.
        duration: simulated time [s].
        violated: names of the violated specs, in the order of the specs; ("error",) if the ADS itself failed.
        violation_class: class of the violation, see `behavexplor.judge.classes`; None for a passed execution.
        fault: fault for a collision, see `behavexplor.judge.fault`; None without one.
        degree: sum of the violation degrees (the paper's O).
        degrees: violation degree of each spec, by its name.
    """

    end: str
    error: dict[str, str] | None = None
    duration: float | None = None
    violated: tuple[str, ...]
    violation_class: Annotated[str | None, Field(alias="class")] = None
    fault: str | None = None
    degree: float | None = None
    degrees: dict[str, float] = field(default_factory=dict)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Return the result of these JSON values, the members of a record that `result_members` gives."""
        named = {_FIELDS.get(key, key): value for key, value in values.items()}
        named["violated"] = tuple(values["violated"])
        return cls(**named)

    @property
    def verdict(self) -> Verdict:
        """The judgment of all specs, the ADS's own failure among them."""
        return Verdict(self.degrees, self.violated)

    @property
    def failed(self) -> bool:
        """True if the execution violated a spec."""
        return bool(self.violated)

    @property
    def at_fault(self) -> bool:
        """True if the execution failed, and the driving system was at fault as far as the trace can tell."""
        return self.failed and is_at_fault(self.fault)

    @property
    def result_members(self) -> list[str]:
        """The members of a record that tell the result."""
        return members_of(_json_values(self, _RESULT))


@dataclass(frozen=True, kw_only=True)
class Record(Result, Ancestry):
    """The figures of one execution: where it comes from, its result, and what the search saw in it.

    Equal campaigns have equal records. Fields that are None are left out when the record is written, but for the
    parent. The members of the JSON are in the order of `Ancestry`, `Result` and this class.

    Attributes:
        novelty: distance to the nearest earlier behavior of the campaign, in [0, 1].
        novel: whether the behavior is new to the campaign.
        search: figures of the search method, JSON values by name.
        scenario: the scenario as `behavexplor.data.scenario.Scenario.to_dict` gives it.
    """

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(strict=True, extra="ignore")

    novelty: float | None = None
    novel: bool = False
    search: dict[str, Any] = field(default_factory=dict)
    scenario: Mapping[str, Any]

    def load_scenario(self) -> Scenario:
        """Return the executed scenario.

        Raises:
            InputError: if the record holds no valid scenario.
        """
        return read_scenario(dict(self.scenario))

    def to_dict(self) -> dict[str, Any]:
        """Return the record as JSON values, in a fixed order."""
        return _json_values(self, _RECORD) | {"violated": list(self.violated), "scenario": dict(self.scenario)}

    @property
    def members(self) -> list[str]:
        """The members of the record."""
        return members_of(self.to_dict())

    def to_json(self) -> str:
        """Return the record as JSON."""
        return json_object(self.members)

    def members_around(self, result: Sequence[str]) -> list[str]:
        """Return `members`, with these as those of the result. A scenario of `WrittenValues` is taken as written."""
        scenario = self.scenario.text if isinstance(self.scenario, WrittenValues) else encode_json(self.scenario)
        before, after = _json_values(self, _ANCESTRY), _json_values(self, _SEARCH)
        return [*members_of(before), *result, *members_of(after), f'"scenario": {scenario}']

    @classmethod
    def from_json(cls, data: bytes | str) -> Self:
        """Return the record that `to_json` wrote.

        Raises:
            ValueError: if it is not a record.
        """
        try:
            return _ADAPTER.validate_json(data)  # type: ignore[return-value]
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            raise ValueError(f"{'.'.join(map(str, first['loc'])) or 'the record'}: {first['msg']}") from None


_ADAPTER: Final = TypeAdapter(Record)
_ANCESTRY, _RESULT, _RECORD = (tuple(one.name for one in fields(kind)) for kind in (Ancestry, Result, Record))
_SEARCH: Final = tuple(name for name in _RECORD if name not in (*_ANCESTRY, *_RESULT, "scenario"))


def _json_values(record: object, names: Iterable[str]) -> dict[str, Any]:
    """Return fields of a record by their names in JSON. Those that are None are left out, but for the parent."""
    values = {_KEYS.get(name, name): getattr(record, name) for name in names}
    return {key: value for key, value in values.items() if value is not None or key == "parent"}


def members_of(values: Mapping[str, Any]) -> list[str]:
    """Return the members of a JSON object, each as a text."""
    return [f'"{name}": {encode_json(value)}' for name, value in values.items()]


def json_object(members: Iterable[str], *, indented: bool = False) -> str:
    """Return the JSON object of these members; if `indented`, with a line for each."""
    if indented:
        return "{\n " + ",\n ".join(members) + "\n}"
    return "{" + ", ".join(members) + "}"
