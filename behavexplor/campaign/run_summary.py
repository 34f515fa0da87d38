"""The figures of a run at one moment, read from its folder: for the terminal, for a JSON file and for notebooks."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from behavexplor.campaign.config import Budget, CampaignConfig, stored_config
from behavexplor.campaign.identity import Identity, begun_with
from behavexplor.campaign.record import Record
from behavexplor.campaign.store import Store
from behavexplor.judge.classes import words_of


@dataclass(frozen=True)
class ClassSummary:
    """One class of failures.

    Attributes:
        id: the class, see `behavexplor.judge.classes`.
        words: the class as a sentence.
        count: number of its failures.
        first: number of the first of them.
        at_fault: number of its failures for which the driving system was at fault, as far as their traces can tell.
    """

    id: str
    words: str
    count: int
    first: int
    at_fault: int


@dataclass(frozen=True)
class RunSummary:
    """The figures of a run.

    Attributes:
        env: environment.
        ads: driving system under test.
        method: search method.
        seed: seed of the campaign.
        budget: number of executions, or running time.
        executions: number of stored executions.
        elapsed: running time up to the last of them [s].
        complete: whether the budget is used up.
        failed: number of failed executions.
        at_fault: number of the failures for which the driving system was at fault, as far as their traces can tell.
        violations: numbers of failures by the most severe spec that they violate.
        classes: the classes of failures, the most frequent first.
        digests: SHA-256 of the files of the driver, by name, when the campaign began.
        libraries: versions of the libraries then, by name.
    """

    env: str
    ads: str
    method: str
    seed: int
    budget: str
    executions: int
    elapsed: float
    complete: bool
    failed: int
    at_fault: int
    violations: Mapping[str, int]
    classes: tuple[ClassSummary, ...]
    digests: Mapping[str, str] = field(default_factory=dict)
    libraries: Mapping[str, str] = field(default_factory=dict)

    @property
    def failure_rate(self) -> float:
        """Share of the executions that failed; 0 without executions."""
        return self.failed / max(self.executions, 1)

    @property
    def at_fault_rate(self) -> float:
        """Share of the executions that failed by the driving system's fault; 0 without executions."""
        return self.at_fault / max(self.executions, 1)

    @property
    def rate(self) -> float:
        """Number of executions per second of running time; 0 without executions."""
        return self.executions / self.elapsed if self.elapsed else 0.0

    def to_dict(self) -> dict[str, Any]:
        """Return the figures as JSON values."""
        return {**asdict(self), "failure_rate": self.failure_rate, "at_fault_rate": self.at_fault_rate}


def summarize(run: Path) -> RunSummary:
    """Return the figures of a run, which may be running now.

    Raises:
        InputError: if the folder is not a run folder, or is damaged.
    """
    config = stored_config(run).says
    store = Store.read(run)
    try:
        begun = begun_with(store) or Identity()
        found = summary_of(config, list(store.records()), store.elapsed)
        return replace(found, digests=begun.digests, libraries=begun.libraries)
    finally:
        store.close()


def summary_of(config: CampaignConfig, records: Sequence[Record], elapsed: float) -> RunSummary:
    """Return the figures of a campaign.

    Args:
        config: its configuration.
        records: its records so far.
        elapsed: its running time [s].
    """
    failures = [record for record in records if record.failed]
    budget = Budget.parse(config.budget)
    is_complete = elapsed >= (budget.seconds or 0.0) if budget.executions is None else len(records) >= budget.executions
    return RunSummary(
        env=config.env,
        ads=config.ads,
        method=config.method,
        seed=config.seed,
        budget=config.budget,
        executions=len(records),
        elapsed=elapsed,
        complete=is_complete,
        failed=len(failures),
        at_fault=sum(record.at_fault for record in failures),
        violations=dict(Counter(record.violated[0] for record in failures)),
        classes=_classes(failures),
    )


def _classes(failures: Iterable[Record]) -> tuple[ClassSummary, ...]:
    return tuple(
        ClassSummary(kind, words_of(kind), len(group), group[0].id, sum(record.at_fault for record in group))
        for kind, group in by_class(failures).items()
    )


def by_class(records: Iterable[Record]) -> dict[str, list[Record]]:
    """Return the failures of each class, the most frequent class first."""
    groups: dict[str, list[Record]] = {}
    for record in records:
        if record.violation_class is not None:
            groups.setdefault(record.violation_class, []).append(record)
    return dict(sorted(groups.items(), key=lambda group: (-len(group[1]), group[1][0].id)))


def snippet(run: Path | str, number: int | str) -> str:
    """Return lines of Python that drive an execution again in an environment and print what it violates."""
    return (
        "import behavexplor\n"
        f"run = behavexplor.open_run({str(run)!r})\n"
        f"env = run.env({number})\n"
        "observation, info = env.reset()\n"
        'while "trace" not in info:\n'
        "    action = env.driver(observation)\n"
        "    observation, reward, terminated, truncated, info = env.step(action)\n"
        'print(run.violated(info["trace"]))'
    )
