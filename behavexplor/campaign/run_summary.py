"""The figures of a run at one moment, read from its folder: for the terminal, for a JSON file and for notebooks.

Also the records of each class, and lines of Python that drive an execution again.
"""

from collections.abc import Iterable, Mapping
from contextlib import closing
from dataclasses import asdict, dataclass
from math import inf
from pathlib import Path
from typing import Any

from behavexplor.campaign.config import Budget, stored_config
from behavexplor.campaign.confirmation import not_confirmed, read_confirmations
from behavexplor.campaign.identity import Identity, begun_with
from behavexplor.campaign.progress import ClassSummary, Progress
from behavexplor.campaign.record import Record
from behavexplor.campaign.store import Store
from behavexplor.campaign.uniform_rate import UniformRate, own_rate


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
        complete: whether the budget is used up, or the search has ended before.
        failed: number of failed executions.
        at_fault: number of the failures for which the driving system was at fault, as far as their traces can tell.
        violations: numbers of failures by the most severe spec that they violate.
        classes: the classes of failures, the most frequent first.
        digests: SHA-256 of the files of the driver, by name, when the campaign began.
        libraries: versions of the libraries then, by name.
        uniform: the driver's own failure rate, which only uniformly drawn scenarios tell; None if it is not known.
        confirmed: number of failures that highway-env itself has confirmed, see `behavexplor.campaign.confirmation`.
        not_confirmed: a sentence on each that it has not.
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
    digests: Mapping[str, str]
    libraries: Mapping[str, str]
    uniform: UniformRate | None
    confirmed: int
    not_confirmed: tuple[str, ...]

    @property
    def words(self) -> str:
        """What has failed, in words."""
        others = words_of_others_faults(self.failed - self.at_fault)
        return f"{self.failed} failed ({self.failure_rate:.1%}) in {class_count(len(self.classes))}{others}"

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
        values = {**asdict(self), "failure_rate": self.failure_rate, "at_fault_rate": self.at_fault_rate}
        values["uniform"] = None if self.uniform is None else self.uniform.to_dict()
        # id and words before the other fields
        values["classes"] = [{"id": one.id, "words": one.words, **asdict(one)} for one in self.classes]
        return values


def summarize(run: Path) -> RunSummary:
    """Return the figures of a run, which may be running now.

    Raises:
        InputError: if the folder is not a run folder, or is damaged.
    """
    config = stored_config(run).unverified
    budget = Budget.parse(config.budget)
    with closing(Store.read(run)) as store:
        found = Progress(elapsed=store.elapsed)
        for record in store.records():
            found = found.after(record, resumed=True)
        begun = begun_with(store) or Identity()
        ended = store.ended is not None
        beside = UniformRate.stored(store)
    tried = read_confirmations(run)
    unconfirmed = tuple(not_confirmed(tried))
    return RunSummary(
        env=config.env,
        ads=config.ads,
        method=config.method,
        seed=config.seed,
        budget=config.budget,
        executions=found.executions,
        elapsed=found.elapsed,
        complete=ended or found.executions >= (budget.executions or inf) or found.elapsed >= (budget.seconds or inf),
        failed=found.failed,
        at_fault=found.at_fault,
        violations=found.violations,
        classes=found.largest_first,
        digests=begun.digests,
        libraries=begun.libraries,
        uniform=own_rate(config.method, found.executions, found.failed, budget, found.elapsed, beside),
        confirmed=len(tried) - len(unconfirmed),
        not_confirmed=unconfirmed,
    )


def by_class(records: Iterable[Record]) -> dict[str, list[Record]]:
    """Return the failures of each class, the most frequent class first."""
    groups: dict[str, list[Record]] = {}
    for record in records:
        if record.violation_class is not None:
            groups.setdefault(record.violation_class, []).append(record)
    return dict(sorted(groups.items(), key=lambda group: (-len(group[1]), group[1][0].id)))


def class_count(number: int) -> str:
    """Return a number of classes in words."""
    return "1 class" if number == 1 else f"{number} classes"


def words_of_others_faults(count: int) -> str:
    """Return how many failures were another vehicle's fault, in words. `triage` tells whose fault the others were."""
    return f"; {count} of the failures by another vehicle's fault" if count else ""


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
