"""Minimization of failures: the simplest scenario in which the same failure still happens."""

import json
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, wait
from contextlib import closing
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from behavexplor.ads.interface import ADS
from behavexplor.campaign.config import CampaignConfig
from behavexplor.campaign.record import ERROR, Record
from behavexplor.campaign.store import Execution, Store
from behavexplor.data.durable import make_folder, writing
from behavexplor.data.scenario import LogicalScenario, Parts, Scenario
from behavexplor.data.trace import Trace
from behavexplor.data.validation import checked
from behavexplor.errors import InputError
from behavexplor.execution.executor import AHEAD, LOCK_STEP, ADSError, Executor, in_order
from behavexplor.execution.rollout import LockStep, run_episodes
from behavexplor.execution.simulation import Simulation
from behavexplor.execution.start import logical_of_target
from behavexplor.judge.classes import violation_class
from behavexplor.judge.events import REQUIREMENTS
from behavexplor.judge.fault import contact_fault
from behavexplor.judge.robustness import load_specs
from behavexplor.judge.specs import Spec, judge
from behavexplor.triage.blame import blame
from behavexplor.triage.counterfactual import find_cause
from behavexplor.triage.examination import STREAM, FailureEvaluator, start_evaluator
from behavexplor.triage.findings import MINIMIZED, Finding, Minimized, known_findings, known_minimized
from behavexplor.triage.shrinking import shrink, size_of

LIMIT: Final = 500  # executions of candidates for one failure
TIME_LIMIT: Final = 100.0  # time limit of one failure, in units of the time limit of an execution
PATIENCE: Final = 1.0  # time after which a failure that is being minimized is mentioned again [s]
MINIMIZE: Final = "minimize"  # function of the service
ENDINGS: Final = frozenset({"crash", "hang"})  # kinds of errors by which a driver ends or blocks its process


class Signature(NamedTuple):
    """What an execution tells of its failure without further executions."""

    # class of the violation; "error/" and the kind of the failure if the ADS failed; empty if the execution passed
    class_id: str
    fault: str | None = None  # verdict on a collision; None for another failure


def signature(outcome: Trace | ADSError, specs: Sequence[Spec]) -> Signature:
    """Return the signature of an execution, which ended with a trace or by a failure of the ADS."""
    if isinstance(outcome, ADSError):
        return Signature(f"{ERROR}/{outcome.kind}")
    violated = judge(outcome, specs).violated
    if not violated:
        return Signature("")
    kind = violation_class(outcome, violated)
    return Signature(kind.id if kind else REQUIREMENTS.get(violated[0], violated[0]), contact_fault(outcome))


def recorded_signature(record: Record, trace: Trace, specs: Sequence[Spec]) -> Signature:
    """Return the signature of a stored execution."""
    if record.error is not None:
        return Signature(f"{ERROR}/{record.error['kind']}")
    return signature(trace, specs)


class ManyScenarios:
    """Executes scenarios of one driver, in lock-step unless `episodes` is None because it is not possible."""

    def __init__(self, simulation: Simulation, episodes: LockStep | None) -> None:
        self.simulation = simulation
        self._episodes = episodes

    def run_all(self, scenarios: Sequence[Scenario]) -> list[Trace | ADSError]:
        """Execute scenarios, and return the trace of each, or how the ADS failed."""
        if self._episodes is None:
            return [self.run(scenario) for scenario in scenarios]
        traces: dict[int, Trace] = {}
        try:
            traces.update(run_episodes(self._episodes, scenarios))
        except ADSError:
            self._episodes.give_up()
        return [traces[i] if i in traces else self.run(scenario) for i, scenario in enumerate(scenarios)]

    def run(self, scenario: Scenario) -> Trace | ADSError:
        """Execute one scenario alone; in a highway-env environment, in highway-env itself."""
        try:
            return self.simulation.run(scenario)
        except ADSError as error:
            return error


class SameFailure:
    """The property that a failure still happens; see `behavexplor.triage.shrinking.Property`.

    Its signature stays the `sought` one. Fault and cause stay those of the `known` finding of triage, if there is one.
    The `seed` is that of the random evasions by which fault is determined.
    """

    def __init__(
        self,
        driven: ManyScenarios,
        specs: Sequence[Spec],
        scenario: Scenario,
        sought: Signature,
        known: Finding | None,
        seed: Sequence[int],
    ) -> None:
        self._driven = driven
        self._specs = specs
        self._scenario = scenario
        self._sought = sought
        self._known = known
        self._seed = seed

    def held_by(self, candidates: Sequence[Parts]) -> list[bool]:
        """Return whether each candidate is valid and fails with the same signature."""
        made = [self._made(candidate) for candidate in candidates]
        valid = [i for i, scenario in enumerate(made) if scenario is not None]
        outcomes = self._driven.run_all([scenario for scenario in made if scenario is not None])
        alike = {i: signature(outcome, self._specs) == self._sought for i, outcome in zip(valid, outcomes, strict=True)}
        return [alike.get(i, False) for i in range(len(candidates))]

    def kept_by(self, candidate: Parts) -> bool:
        """Return whether fault and cause are also the same, as far as triage has found them."""
        known, simulation = self._known, self._driven.simulation
        if known is None or known.spec == ERROR:
            return True
        scenario = simulation.logical.with_parts(self._scenario, candidate)
        (trace,) = self._driven.run_all([scenario])
        if isinstance(trace, ADSError):
            return False
        if known.fault is not None:
            verdict = blame(simulation, scenario, trace, np.random.default_rng(self._seed))
            if verdict is None or verdict.kind != known.fault:
                return False
        if known.cause is None:
            return True
        cause = find_cause(simulation, scenario, trace)
        return cause is not None and cause.primary == known.cause

    def _made(self, candidate: Parts) -> Scenario | None:
        try:
            return self._driven.simulation.logical.with_parts(self._scenario, candidate)
        except InputError:
            return None


class Minimizer(FailureEvaluator):
    """An evaluator that also minimizes failures; see `behavexplor.triage.examination.FailureEvaluator`."""

    def __init__(self, specs: Sequence[str] = (), **target: Any) -> None:
        super().__init__(specs, **target)
        self.functions = {**self.functions, MINIMIZE: self.minimize}
        self._episodes: LockStep | None = None

    def begin(self) -> None:
        """Load the ADS and make its environment. The candidates for one failure run in lock-step."""
        super().begin()
        self._episodes = self.simulation.lock_step(LOCK_STEP)

    def minimize(self, request: bytes) -> bytes:
        """Minimize a failure, encoded by `minimization`; return it as a line of JSON, and the trace of its scenario."""
        head, data = request.split(b"\n", 1)
        values = json.loads(head)
        record, seed = Record.from_json(json.dumps(values["record"])), values["seed"]
        known = None if values["finding"] is None else Finding(**values["finding"])
        driven = ManyScenarios(self.simulation, self._episodes)
        found, trace = minimized(driven, load_specs(self.specs), record, Trace.from_bytes(data), known, seed)
        return json.dumps(found.to_dict()).encode() + b"\n" + trace.to_bytes()


def minimization(record: Record, trace: bytes, seed: int, known: Finding | None) -> bytes:
    """Return the request for `Minimizer.minimize` about a stored execution in a campaign of this seed.

    `known` is the finding of triage about it; None without triage.
    """
    values = {"record": record.to_dict(), "seed": seed, "finding": None if known is None else asdict(known)}
    return json.dumps(values).encode() + b"\n" + trace


def minimized(
    driven: ManyScenarios, specs: Sequence[Spec], record: Record, trace: Trace, known: Finding | None, seed: int
) -> tuple[Minimized, Trace]:
    """Minimize a failure, and return it with the trace of its scenario.

    Its class stays the same, and so do its fault and cause as far as `known` tells them: the finding of triage; None
    without triage. `driven` has the driver of the execution. `seed` and `specs` are the campaign's.
    """
    logical, scenario = driven.simulation.logical, record.load_scenario()
    parts, removable = logical.parts(scenario), logical.removable
    sought = recorded_signature(record, trace, specs)
    same = SameFailure(driven, specs, scenario, sought, known, (STREAM, seed, record.id))
    shrunk = shrink(parts, same, removable=removable, limit=LIMIT if same.held_by([parts]) == [True] else 0)
    minimal = logical.with_parts(scenario, shrunk.parts)
    again = driven.run(minimal)
    found = replace(left_as_found(logical, specs, record, trace, known), executions=shrunk.executions)
    if signature(again, specs) != sought:  # it is flaky, or the compiled engine found it alone
        return found, trace
    found = replace(
        found,
        reproduced=True,
        is_minimal=shrunk.is_minimal,
        minimal=size_of(logical.parts(minimal), removable=removable),
        violated=(ERROR,) if isinstance(again, ADSError) else judge(again, specs).violated,
        scenario=minimal.to_dict(),
    )
    return found, logical.first_frame(minimal, ERROR) if isinstance(again, ADSError) else again


def left_as_found(
    logical: LogicalScenario, specs: Sequence[Spec], record: Record, trace: Trace, known: Finding | None
) -> Minimized:
    """Return a failure that cannot be minimized as it was found; see `minimized` for the arguments."""
    sought = recorded_signature(record, trace, specs)
    size = size_of(logical.parts(record.load_scenario()), removable=logical.removable)
    return Minimized(
        id=record.id,
        class_id=sought.class_id,
        fault=known.fault if known else sought.fault,
        cause=known.cause if known else None,
        reproduced=False,
        is_minimal=False,
        found=size,
        minimal=size,
        executions=0,
        violated=record.violated,
        scenario=dict(record.scenario),
    )


def chosen_failures(store: Store, numbers: Sequence[int] = (), *, every: bool = False) -> list[int]:
    """Return the failures to minimize, in order: those of the given numbers; without them, the first of each class.

    With `every`, all failures are chosen instead.

    Raises:
        InputError: if an execution has no failure.
    """
    failures = {record.id: record.violation_class or "" for record in store.records() if record.failed}
    for number in numbers:
        if number not in failures:
            folder = store.folder
            raise InputError(f"Execution {number} of {folder} has no failure: `behavexplor records` lists them")
    if every or numbers:
        return sorted(set(numbers) or failures)
    first = {kind: number for number, kind in sorted(failures.items(), reverse=True)}
    return sorted(first.values())


class RunMinimization:
    """Minimization of failures of one run. The results are kept in its folder.

    A failure in which the driver ends or blocks its process, or does so in a simpler scenario, is left as it was found.

    `numbers` and `every` choose failures, see `chosen_failures`. With `afresh`, those that were minimized before are
    minimized again. `workers` is the number of worker processes; 0 for this process. `driver` is an ADS of this process
    that drives in place of the one that the configuration names; None for none. The attribute `waiting` has the numbers
    still to be minimized.

    Raises:
        InputError: if the folder is not a run folder, or is damaged, or an execution has no failure.
    """

    def __init__(
        self,
        run: Path,
        config: CampaignConfig,
        workers: int,
        numbers: Sequence[int] = (),
        *,
        every: bool = False,
        afresh: bool = False,
        driver: ADS | None = None,
    ) -> None:
        self._run = run
        self._config = config
        self._workers = workers
        self._driver = driver
        with closing(Store.read(run)) as store:
            self._chosen = chosen_failures(store, numbers, every=every)
        self._findings = known_findings(run)
        known = {} if afresh else known_minimized(run, self._findings)
        self._found = {number: known[number] for number in self._chosen if number in known}
        self.waiting = [number for number in self._chosen if number not in self._found]

    def minimize(self, observe: Callable[[int], None]) -> list[Minimized]:
        """Minimize the waiting failures in parallel, and return all chosen ones in order.

        Args:
            observe: function that gets the number of failures that were minimized, whenever one is, and every second.

        Raises:
            InputError: if the driver cannot be loaded, or the run folder cannot be written.
            RuntimeError: if a failure could not be minimized.
        """
        with closing(Store.read(self._run)) as store, writing(f"The run folder {self._run}"):
            for minimal in self._results(store):
                if minimal is not None:
                    self._found[minimal.id] = minimal
                observe(sum(number in self._found for number in self.waiting))
        return [self._found[number] for number in self._chosen]

    def _results(self, store: Store) -> Iterator[Minimized | None]:
        """Minimize the waiting failures, write the results into the run folder, and yield them in order.

        While one takes long, None is yielded every `PATIENCE` seconds.
        """
        if not self.waiting:
            return
        workers = min(self._workers, len(self.waiting))
        with start_evaluator(Minimizer, self._config, TIME_LIMIT, workers, self._driver) as executor:
            make_folder(store.folder, MINIMIZED)
            ended = {number for number in self.waiting if _ends_process(store.execution(number).record)}
            tried = (number for number in self.waiting if number not in ended)
            calls = (_call(store.execution(number), self._config.seed, self._findings.get(number)) for number in tried)
            futures = in_order(executor, calls, AHEAD * workers)
            for number in self.waiting:
                future = None if number in ended else next(futures)
                while future is not None and not wait([future], PATIENCE).done:
                    yield None
                answer = None if future is None else _answer(future)
                minimal, trace = answer or self._as_found(executor, store.execution(number))
                minimal.write(store.folder, trace)
                yield minimal

    def _as_found(self, executor: Executor, execution: Execution) -> tuple[Minimized, bytes]:
        logical, specs = logical_of_target(executor, self._config.env), load_specs(self._config.specs)
        known = self._findings.get(execution.id)
        trace = execution.load_trace()
        return left_as_found(logical, specs, execution.record, trace, known), execution.trace  # as bytes


def _ends_process(record: Record) -> bool:
    """Return whether the driver ended or blocked its process, so that this process could not try anything else."""
    return record.error is not None and record.error["kind"] in ENDINGS


def _call(execution: Execution, seed: int, known: Finding | None) -> tuple[str, bytes]:
    return MINIMIZE, minimization(execution.record, execution.trace, seed, known)


def _answer(future: "Future[bytes]") -> tuple[Minimized, bytes] | None:
    """Return a minimized failure and its trace; None if the driver ended or blocked its process in a candidate."""
    try:
        head, trace = future.result().split(b"\n", 1)
    except ADSError:
        return None
    return checked(Minimized, json.loads(head), "the minimized failure"), trace
