"""The campaigns of a comparison of two drivers, and the search for scenarios in which only one of them fails.

In a comparison, both drive the same scenarios, each in a run folder of its own. Any search method searches for
differences: its requirements are "the first driver does not fail alone" and "the second driver does not fail alone".
"""

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, NamedTuple

from behavexplor.campaign.campaign import search_method
from behavexplor.campaign.config import Budget, CampaignConfig
from behavexplor.campaign.opening import opened
from behavexplor.campaign.record import ERROR
from behavexplor.campaign.store import Store
from behavexplor.data.durable import make_folder, write_durably, writing
from behavexplor.data.scenario import LogicalScenario, Scenario
from behavexplor.data.target import Target
from behavexplor.data.trace import Trace
from behavexplor.errors import InputError
from behavexplor.execution.evaluator import EXECUTE
from behavexplor.execution.executor import ADSError, Executor
from behavexplor.execution.simulation import fixed_logical_scenario
from behavexplor.execution.start import logical_of_target, start_executor
from behavexplor.fuzz.methods import load_method
from behavexplor.fuzz.search import Candidate, SearchExhausted, SearchMethod
from behavexplor.judge.fault import collision_fault, is_at_fault
from behavexplor.judge.outcomes import outcomes_of
from behavexplor.judge.robustness import load_specs
from behavexplor.judge.specs import Spec, Verdict, judge
from behavexplor.repair.pairs import Pairs, paired

ONLY_FIRST, ONLY_SECOND = "only-first-fails", "only-second-fails"  # requirements of a search for differences
BOTH_FAIL: Final = 1.0  # degree of a scenario in which both drivers fail [m], as if one of them nearly failed
FIRST, SECOND, PAGE = "first", "second", "comparison.html"  # run folders and page of a comparison
SETTINGS: Mapping[str, Any] = {"method": "uniform", "batch": 32}  # of both campaigns
DIFFERENCES = "differences.jsonl"
_FIRST_LOOK: Final = 250  # scenarios before the first look, see `looks`
Observe = Callable[[int], None]


class LoadedDriver(NamedTuple):
    """One of the two drivers of a search for differences."""

    executor: Executor
    logical: LogicalScenario


@dataclass(frozen=True)
class Difference:
    """A scenario in which one driver fails and the other does not."""

    number: int  # number of the candidate
    fails: str  # `ONLY_FIRST` or `ONLY_SECOND`
    scenario: Scenario  # the scenario, as one of the first driver


def search_differences(
    method: SearchMethod,
    first: LoadedDriver,
    second: LoadedDriver,
    specs: Sequence[Spec],
    *,
    budget: int,
    batch: int,
    observe: Observe,
) -> list[Difference]:
    """Search for scenarios in which one driver fails and the other does not.

    The method learns from the traces of the first driver, in whose environment it searches. The differences come in the
    order in which it proposed them, and do not depend on the executors. `budget` scenarios are executed with both
    drivers, `batch` are in flight, and `observe` gets the number of those that are done.

    Raises:
        RuntimeError: if a scenario could not be executed.
    """
    found: list[Difference] = []
    pending: deque[tuple[Candidate, Future[bytes], Future[bytes]]] = deque()
    asked = done = 0
    while True:
        try:
            while len(pending) < batch and asked < budget:
                candidate = method.ask()
                pending.append((candidate, _submitted(first, candidate), _submitted(second, candidate)))
                asked += 1
        except SearchExhausted:
            budget = asked
        if not pending:
            return found
        candidate, *futures = pending.popleft()
        one, other = (_result(first, candidate.scenario, future) for future in futures)
        verdict = difference(verdict_at_fault(*one, specs), verdict_at_fault(*other, specs))
        found += [Difference(candidate.number, name, candidate.scenario) for name in verdict.violated]
        method.tell(candidate, one[0], verdict)
        done += 1
        observe(done)


def difference(first: Verdict, second: Verdict) -> Verdict:
    """Return the verdict on a scenario from those on both drivers, with `ONLY_FIRST` and `ONLY_SECOND` as specs."""
    alone = {ONLY_FIRST: (first, second), ONLY_SECOND: (second, first)}
    degrees = {name: _degree(fails, holds) for name, (fails, holds) in alone.items()}
    return Verdict(degrees, tuple(name for name, (fails, holds) in alone.items() if fails.failed and not holds.failed))


def _degree(fails: Verdict, holds: Verdict) -> float:
    """Return how far a scenario is from one in which only one driver fails [m], by the nearest spec of that driver."""
    nearest = 0.0 if fails.failed else min(fails.degrees.values())
    return nearest + (BOTH_FAIL if holds.failed else 0.0)


def _submitted(driver: LoadedDriver, candidate: Candidate) -> "Future[bytes]":
    return driver.executor.submit(EXECUTE, driver.logical.adopted(candidate.scenario).to_json().encode())


def _result(first: LoadedDriver, scenario: Scenario, future: "Future[bytes]") -> tuple[Trace, bool]:
    """Return the trace of an execution, and whether the ADS failed instead of driving."""
    try:
        return Trace.from_bytes(future.result()), False
    except ADSError:
        return first.logical.first_frame(scenario, ERROR), True


def verdict_at_fault(trace: Trace, is_error: bool, specs: Sequence[Spec]) -> Verdict:
    """Return the verdict on a driver. Only failures at fault count, see `Record.at_fault`."""
    verdict = judge(trace, specs)
    if is_error:
        return replace(verdict, violated=(ERROR,))
    return verdict if is_at_fault(collision_fault(trace, verdict.violated)) else replace(verdict, violated=())


def check_numbers(scenarios: int, margin: float | None) -> None:
    """Check the number of scenarios of a comparison, and its margin.

    Raises:
        InputError: if one of them cannot be used.
    """
    if scenarios < 1:
        raise InputError(f"A comparison needs at least 1 scenario, not {scenarios}")
    check_margin(margin)


def check_margin(margin: float | None) -> None:
    """Raise an `InputError` if the margin of a comparison cannot be used. None stands for no margin."""
    if margin is not None and not 0.0 < margin < 1.0:
        raise InputError(f"The margin {margin} must lie between 0 and 1, such as 0.01 for one point")


def check_new(folder: Path) -> None:
    """Raise an `InputError` if a comparison cannot begin in a folder, because it is not empty."""
    if folder.is_dir() and any(folder.iterdir()):
        raise InputError(f"{folder} is not empty, and a comparison cannot be continued: choose another folder")


def looks(n: int, margin: float | None) -> Iterator[int]:
    """Yield the numbers of scenarios after which a comparison looks whether it is decided; only n without a margin."""
    count = n if margin is None else _FIRST_LOOK
    while count < n:
        yield count
        count *= 2
    yield n


def driven(config: CampaignConfig, folder: Path, workers: int, observe: Observe, *, resume: bool = False) -> list[str]:
    """Run one of the two campaigns, or go on with it, and return warnings about the driver.

    With 0 `workers`, this process drives. `observe` gets the number of executions so far.

    Raises:
        InputError: if the driver, the environment or the folder cannot be used.
        ExecutionError: if an execution could not be carried out.
    """
    with writing(f"The folder {folder.parent}"):
        place = make_folder(folder.parent, folder.name)
    with opened(config, place, workers, resume=resume) as ready:
        ready.campaign.run(lambda progress: observe(progress.executions))
        ready.campaign.confirm()
        return ready.warnings


def second_config(first: CampaignConfig, ads: str, folder: Path) -> CampaignConfig:
    """Return the configuration of the second driver, in the scene of the first one's run, which is in `folder`."""
    with closing(Store.read(folder)) as store:
        scenario = store.execution(0).scenario
    config = replace(first, ads=ads)
    return replace(config, env_config=scenario.scene_config) if scenario.scene_config else config


def compared(folder: Path) -> list[Pairs]:
    """Return the paired statistics of a folder's two runs."""
    with closing(Store.read(folder / FIRST)) as first, closing(Store.read(folder / SECOND)) as second:
        driven = next((record.id for record in first.records() if record.error is None), 0)
        asked = outcomes_of(first.execution(driven).load_trace()).asked
        return paired(first.records(), second.records(), asked)


def check_search(config: CampaignConfig) -> None:
    """Check the search for differences as far as that is possible before a driver is loaded.

    Raises:
        InputError: if the search method cannot be used, or the budget is a time.
    """
    if Budget.parse(config.budget).executions is None:
        raise InputError(f"The budget {config.budget!r} of the search must be a number of executions, such as 750")
    logical = fixed_logical_scenario(config.env)
    if logical is None:  # it depends on what the driver declares
        load_method(config.method)
    else:
        search_method(config, logical)


def differences(
    first: CampaignConfig, second: CampaignConfig, folder: Path, workers: int, observe: Observe
) -> list[Difference]:
    """Search for differences by the method of `first`, and write their scenarios to the file `DIFFERENCES` in `folder`.

    Each driver has that many `workers`; with 0, this process drives. `observe` gets the number of executed scenarios.

    Raises:
        InputError: if a driver or the search method cannot be used.
        RuntimeError: if a scenario could not be executed.
    """
    budget = Budget.parse(first.budget).executions or 0
    with _loaded(first.target, workers) as ours, _loaded(second.target, workers) as theirs:
        method, specs = search_method(first, ours.logical), load_specs(first.specs)
        found = search_differences(method, ours, theirs, specs, budget=budget, batch=first.batch, observe=observe)
    lines = "".join(f"{one.scenario.to_json()}\n" for one in found)
    write_durably(make_folder(folder.parent, folder.name) / DIFFERENCES, lines)
    return found


@contextmanager
def _loaded(target: Target, workers: int) -> Iterator[LoadedDriver]:
    with start_executor(target, workers) as executor:
        yield LoadedDriver(executor, logical_of_target(executor, target.env))
