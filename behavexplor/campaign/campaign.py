"""The campaign loop: ask a search method for scenarios, execute and judge them, tell the method, store the results.

The search method receives results in the order in which it proposed the candidates. It is asked for candidate i when
it has received exactly the results up to i - batch, or earlier if it says that no result can change the candidate. A
campaign therefore does not depend on how its scenarios are executed.

Resuming a campaign means running it again with the stored traces in place of executions.
"""

import json
import sqlite3
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from behavexplor.behavior.novelty import NOVELTY_THRESHOLD, NoveltyArchive
from behavexplor.campaign.config import Budget, CampaignConfig
from behavexplor.campaign.confirmation import unconfirmed
from behavexplor.campaign.judges import Judges
from behavexplor.campaign.judgment import Judgment, ads_failure, confirmed, judgment
from behavexplor.campaign.progress import Progress, Stage, StageClock
from behavexplor.campaign.record import ERROR, Record, WrittenValues, encode_json
from behavexplor.campaign.store import Execution, Store
from behavexplor.campaign.uniform_rate import MOST, SHARE, UniformRate
from behavexplor.data.scenario import LogicalScenario
from behavexplor.data.validation import checked
from behavexplor.errors import InputError
from behavexplor.execution.evaluator import EXECUTE
from behavexplor.execution.executor import ADSError, Executor
from behavexplor.fuzz.methods import load_method
from behavexplor.fuzz.search import Candidate, SearchExhausted, SearchMethod, UniformCandidate
from behavexplor.judge.discovery import INDEPENDENT
from behavexplor.judge.specs import SPECS, Spec

COMMIT_ROWS = 50  # greatest number of executions in one commit
COMMIT_SECONDS = 0.25  # greatest time between two commits [s]
_UNIFORM: Final = 0x75_6E_69_66  # separates the scenarios that no search has chosen from those of the campaign
_MOST_EARLY: Final = 1024  # candidates in flight, so that one of a long episode does not fill the memory with others
TOGETHER: Final = 16  # candidates that are asked for early at a time, and answers that are sent together


class ExecutionError(Exception):
    """An execution could not be carried out or kept for a reason other than the ADS, and is not its failure."""


@contextmanager
def _disk_errors_translated() -> Iterator[None]:
    """Raise an `ExecutionError` in place of errors of the disk, such as that it is full or the run folder is gone."""
    try:
        yield
    except (sqlite3.Error, OSError) as error:
        raise ExecutionError(f"The campaign can no longer write to disk: {error}") from error


@dataclass
class _Pending:
    """A candidate whose result the method has not been told."""

    candidate: Candidate
    result: Future[bytes] | Execution  # the future trace as bytes, or the stored execution
    scenario: str = ""  # the scenario as JSON; empty if a judge draws it
    judging: Future[Judgment] | None = None  # in another process
    judgment: Judgment | None = None  # made early, while the oldest candidate was executed; None if it was not

    @property
    def is_executed(self) -> bool:
        return isinstance(self.result, Execution) or self.result.done()


class Campaign:
    """One campaign in its run folder. What the store already holds is not repeated.

    `method` is made by `search_method`. After `stop_after` failures the campaign stops; None for no such number.
    `judges` judge in place of this process, by the built-in specs.
    """

    def __init__(
        self,
        config: CampaignConfig,
        method: SearchMethod,
        logical: LogicalScenario,
        store: Store,
        executor: Executor,
        specs: Sequence[Spec] = SPECS,
        stop_after: int | None = None,
        judges: Judges | None = None,
    ) -> None:
        self._config = config
        self._method = method
        self.logical = logical
        self._budget = Budget.parse(config.budget)
        self._store = store
        self._executor = executor
        self._judges = judges
        self._specs = specs
        self._stop_after = stop_after
        self.clock = StageClock(store.stages)
        self._executing = Stage.EXECUTING if executor.runs_here else Stage.WAITING
        self._failures = 0  # those that the method has been told, stored or not
        self._archive = NoveltyArchive()
        self._stored = store.end  # lower candidates have been executed, but the store may have lost some
        self._pending: deque[_Pending] = deque()
        self._asked = 0
        self._start = time.monotonic() - store.elapsed
        self._committed = time.monotonic()
        self.progress = Progress(violations={spec.name: 0 for spec in specs}, earlier=store.elapsed)
        self.stopping = False  # whether `stop` has been called

    def stop(self) -> None:
        """End the campaign after the current execution."""
        self.stopping = True

    def run(self, observe: Callable[[Progress], None]) -> str | None:
        """Run until the budget is used up, enough failures have been found, or `stop` is called.

        `observe` gets the progress whenever executions have been stored. Return a sentence on why the search ended
        before its budget was used up; None if it did not.

        Raises:
            ExecutionError: if an execution could not be carried out or stored.
            InputError: if the stored executions do not match this configuration.
        """
        ended = None
        try:
            while not self.stopping:
                if self._has_enough():
                    failures = "failure" if self._failures == 1 else "failures"
                    return f"Stopped after {self._failures} {failures}, as asked for"
                ended = self._ask_all()
                if not self._pending:
                    break
                self._tell(self._pending.popleft())
                self._commit(observe, COMMIT_ROWS, COMMIT_SECONDS)
        finally:
            self._commit(observe, 1, 0.0)
        if ended is not None and not self._pending:
            with _disk_errors_translated():
                self._store.note_end(ended)
        return ended

    def drive_uniformly(self) -> None:
        """Find out how often the driver fails in scenarios that no search has chosen, once the campaign has ended.

        The rate is noted in the store, unless the campaign's own scenarios are uniform, it is known of as many already,
        or the user stops the campaign. The scenarios depend on the seed alone.

        Raises:
            ExecutionError: if one could not be executed.
            InputError: if a spec cannot judge a trace.
        """
        count, known = min(MOST, len(self._store) // SHARE), UniformRate.stored(self._store)
        if self._config.method in INDEPENDENT or count <= (known.n if known else 0):
            return
        generator, failed = np.random.default_rng([_UNIFORM, self._config.seed]), 0
        candidates = [Candidate(number, self.logical.sample(generator), "uniform", None) for number in range(count)]
        try:
            for pending in [self._begun(one) for one in candidates]:
                if self.stopping:
                    return
                failed += self._judgment(pending).result.failed
        except (ExecutionError, InputError) as error:  # its number is that of one of these, and no stored one
            raise type(error)(f"In uniformly drawn scenarios beside the search: {error}") from error
        with _disk_errors_translated():
            UniformRate(count, failed).note(self._store)

    @property
    def unconfirmed(self) -> list[int]:
        """Numbers of the failures that `confirm` will confirm; none in environments that are not highway-env's."""
        is_theirs = self.logical.has_original
        return unconfirmed(self._config, self._store.folder, self._store.records()) if is_theirs else []

    def confirm(self, observe: Callable[[int], object] = lambda _: None) -> None:
        """Let highway-env itself execute the first failures of each class, once the campaign has ended.

        They do not depend on the number of workers. If the user stops the campaign, the rest is left to its resumption.
        `observe` gets the number of failures that are done.

        Raises:
            ExecutionError: if one could not be executed or stored.
        """
        numbers = [] if self.stopping else self.unconfirmed
        try:
            for done, _ in enumerate(confirmed(self._executor, self._store, numbers), 1):
                observe(done)
                if self.stopping:
                    return
        except (RuntimeError, OSError) as error:
            raise ExecutionError(f"A failure could not be confirmed: {error}") from error

    @property
    def is_replayed(self) -> bool:
        """True if all that was stored when the campaign was opened has come out again."""
        return self.progress.executions >= self._stored

    def _during(self, stage: Stage, number: int) -> AbstractContextManager[None]:
        """Return a context whose time counts for a stage, or for the start if an execution is stored already."""
        return self.clock.during(stage if number >= self._stored else Stage.STARTING)

    def _has_enough(self) -> bool:
        told = self._asked - len(self._pending)
        return self._stop_after is not None and self._failures >= self._stop_after and told >= self._stored

    @property
    def elapsed(self) -> float:
        """Running time, including the time before an interruption [s]."""
        return time.monotonic() - self._start

    def _ask_all(self) -> str | None:
        """Ask for candidates until the batch is full. Return why the search ended, or None if it has not."""
        for _ in self._places():
            if self.stopping or not self._within_budget():
                break
            try:
                with self._during(Stage.ASKING, self._asked):
                    candidate = self._method.ask()
            except SearchExhausted as end:
                return str(end)
            self._asked += 1
            self._pending.append(self._execute(candidate))
        return None

    def _places(self) -> Iterator[int]:
        """Yield while there is room for a candidate in the batch, or for many that need no result, early."""
        while True:
            in_flight = len(self._pending)
            early = min(getattr(self._method, "foreseen", 0), _MOST_EARLY - in_flight)
            room = self._executor.room if early > 0 else 0
            extra = min(early, room) if room >= min(TOGETHER, in_flight) else 0
            count = max(self._config.batch - in_flight, extra)
            if count <= 0:
                return
            yield from range(count)

    def _within_budget(self) -> bool:
        if self._budget.executions is not None:
            return self._asked < self._budget.executions
        return self._asked < self._stored or self.elapsed < (self._budget.seconds or 0.0)

    def _execute(self, candidate: Candidate) -> _Pending:
        stored = self._store.recall(candidate.number) if candidate.number < self._stored else None
        if stored is None:
            with self.clock.during(self._executing):
                return self._begun(candidate)
        if stored.scenario != candidate.scenario:
            raise InputError(
                f"The run cannot be resumed: execution {candidate.number} would now be a different scenario, so the "
                f"configuration or the program has changed"
            )
        return _Pending(candidate, stored)

    def _begun(self, candidate: Candidate) -> _Pending:
        """Let a worker execute a candidate, and a judge judge it if there are any."""
        judges, drawn, scenario = self._judges, "", ""
        if isinstance(candidate, UniformCandidate) and judges is not None and judges.will_draw():
            drawn = json.dumps([candidate.seed, candidate.number])
        else:
            scenario = encode_json(candidate.scenario.to_dict())
        result = self._submit(candidate.number, drawn or scenario)
        if judges is None or not (drawn or judges.ready()):
            return _Pending(candidate, result, scenario)
        return _Pending(candidate, result, scenario, judges.follow(result, drawn.encode()))

    def _submit(self, number: int, request: str) -> Future[bytes]:
        try:
            return self._executor.submit(EXECUTE, request.encode())
        except RuntimeError as error:  # the executor has been shut down
            raise ExecutionError(f"Execution {number} could not be carried out: {error}") from error

    def _tell(self, oldest: _Pending) -> None:
        """Tell the method a result, and store the record unless it is already stored."""
        self._judge_others_until(oldest)
        judged = oldest.judgment or self._judgment(oldest)
        record = self._record(oldest, judged)
        self._failures += record.failed
        if not isinstance(oldest.result, Execution):
            members = record.members_around(judged.members)
            self._store.add(Execution(record, judged.data, self.elapsed, encoded=members))
        elif not oldest.result.record.to_dict().items() <= record.to_dict().items():  # old records have fewer fields
            raise InputError(
                f"The run cannot be resumed: execution {record.id} is now judged differently, so the configuration or "
                f"the program has changed"
            )
        else:
            self.progress = self.progress.after(oldest.result.record, resumed=True)

    def _judge_others_until(self, oldest: _Pending) -> None:
        """Judge candidates that have been executed early, until the oldest one has been executed as well."""
        if oldest.judging is not None:  # others judge it, and all that have been asked for since
            return
        for other in self._pending:
            if oldest.is_executed:
                return
            if other.is_executed and other.judgment is None and other.judging is None:
                with suppress(InputError, ExecutionError):  # it will be raised when the candidate is the oldest one
                    other.judgment = self._judgment(other)

    def _judgment(self, pending: _Pending) -> Judgment:
        """Return the judgment of a candidate: of its stored execution, of its judge, or made here."""
        candidate, result = pending.candidate, pending.result
        if isinstance(result, Execution):
            return self._judge(candidate, result.trace, result.record.error)
        try:
            with self.clock.during(self._executing):
                data = result.result()
                if pending.judging is not None:
                    return pending.judging.result()
        except ADSError as error:
            return self._failed(candidate, error)
        except Exception as error:
            message = f"{type(error).__name__}: {error}".splitlines()[0]
            raise ExecutionError(f"Execution {candidate.number} could not be carried out: {message}") from error
        try:
            return self._judge(candidate, data, None)
        except ADSError as error:
            return self._failed(candidate, error)

    def _failed(self, candidate: Candidate, error: ADSError) -> Judgment:
        """Return the judgment of an execution in which the ADS failed instead of driving."""
        frame = self.logical.first_frame(candidate.scenario, ERROR).to_bytes()
        return self._judge(candidate, frame, ads_failure(error))

    def _judge(self, candidate: Candidate, data: bytes, failure: dict[str, str] | None) -> Judgment:
        with self._during(Stage.JUDGING, candidate.number):
            try:
                return judgment(data, failure, self._specs)
            except InputError as error:
                place = f"in execution {candidate.number} of {self._store.folder}"
                raise InputError(f"{error}, {place}: correct the spec, then continue with fuzz --resume") from error

    def _record(self, pending: _Pending, judged: Judgment) -> Record:
        candidate = pending.candidate
        with self._during(Stage.MINING, candidate.number):
            novelty = self._archive.observe(judged.trace)
            learned = self._method.tell(candidate, judged.trace, judged.result.verdict)
        return Record(
            id=candidate.number,
            origin=candidate.origin,
            parent=candidate.parent,
            **vars(judged.result),  # the fields of `Result`: end, error, degrees and so on
            novelty=novelty,
            novel=novelty > NOVELTY_THRESHOLD,
            search=dict(learned),
            # encoded before for the worker, or by the judge that drew it; if by neither, now
            scenario=WrittenValues(pending.scenario or judged.scenario or encode_json(candidate.scenario.to_dict())),
        )

    def _commit(self, observe: Callable[[Progress], None], rows: int, seconds: float) -> None:
        """Commit and count the pending executions if there are enough of them or enough time has passed."""
        waited = time.monotonic() - self._committed
        if self._store.pending < rows and waited < seconds:
            return
        with self.clock.during(Stage.STORING), _disk_errors_translated():
            committed = self._store.commit(self.clock.total)
        for execution in committed:
            self.progress = self.progress.after(execution.record, resumed=False)
        self._committed = time.monotonic()
        self.progress = replace(
            self.progress,
            elapsed=self.elapsed,
            executing=self.clock.seconds[self._executing],
            method=dict(self._method.status()),
        )
        observe(self.progress)


def search_method(config: CampaignConfig, logical: LogicalScenario) -> SearchMethod:
    """Return the search method of a campaign.

    Raises:
        InputError: if there is no method of that name, or if its options are invalid.
    """
    kind, options = method_options(config)
    return kind(logical, config.seed, options)


def method_options(config: CampaignConfig) -> tuple[Callable[..., SearchMethod], Any]:
    """Return the class of a campaign's search method, and its options, checked.

    Raises:
        InputError: if there is no method of that name, or if its options are invalid.
    """
    kind = load_method(config.method)
    return kind, checked(kind.Options, config.options, f"options of {config.method}")
