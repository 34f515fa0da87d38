"""Evaluation of an ADS: rates of arrival and violations over uniformly drawn scenarios."""

import json
import math
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any, Final, NamedTuple, Self

import numpy as np

from behavexplor.ads.interface import ADS
from behavexplor.data.scenario import LogicalScenario, Scenario
from behavexplor.data.target import Target
from behavexplor.data.trace import ARRIVED, Trace
from behavexplor.errors import InputError
from behavexplor.execution.evaluator import EXECUTE, Evaluator, recipe_for
from behavexplor.execution.executor import ADSError, Executor
from behavexplor.execution.rollout import LockStep, run_episodes
from behavexplor.execution.start import start_executor
from behavexplor.judge.outcomes import (
    OutcomeBlock,
    OutcomeFile,
    Outcomes,
    outcomes_from,
    outcomes_of,
    outcomes_of_error,
    packed,
    unpacked,
)
from behavexplor.judge.rates import ALPHA, AT_FAULT, FAILED, OUTCOMES, Decision, Goal, check_outcome, clopper_pearson
from behavexplor.judge.specs import ERROR, SPECS

STREAM: Final = 0x65_76_61_6C  # separates the scenarios of evaluations from those of campaigns and trainings
_BETWEEN_LOOKS: Final = 1.005  # ratio of the numbers of scenarios at two looks at a rate
AHEAD: Final = 1024  # scenarios under way that are judged by their traces, enough for many processes in lock-step
SMALL_BLOCK: Final = 32  # scenarios of a block that are judged by their traces
BLOCK: Final = 256  # scenarios that are counted together, in lock-step
LARGE_BLOCK: Final = 1024  # scenarios that are counted together if there are many, which takes less time
MANY: Final = 16_384  # scenarios of an evaluation with large blocks
BLOCKS_AHEAD: Final = 64  # blocks under way that are counted together
Observe = Callable[[int], None]
_CAN_COUNT, _COUNT = "can_count", "count"  # functions of the service


@dataclass(frozen=True)
class Evaluation:
    """Outcomes of a number of scenarios."""

    n: int  # number of scenarios
    # number of scenarios by outcome: "arrived", each spec for its violations, "collision: " with each verdict on a
    # collision, "error" for failures of the driver's program, and "error: " with each kind of them. Outcomes are in the
    # order in which they are reported.
    counts: Mapping[str, int]
    # what was decided on a rate, if the evaluation ended when enough was known. Its number of scenarios then depends on
    # what happened in them, so `interval` does not hold, but that of the decision does.
    decision: Decision | None = None
    failed: int = 0  # number of failures
    at_fault: int = 0  # number of failures by the driver's own fault

    @classmethod
    def of_outcomes(cls, scenarios: Iterable[Outcomes]) -> Self:
        """Count the outcomes of scenarios. An outcome that means nothing in any of them is left out."""
        return cls.of_combinations(Counter(scenarios))

    @classmethod
    def of_combinations(cls, combinations: Mapping[Outcomes, int]) -> Self:
        """Count the outcomes of scenarios, given how many had each combination of them."""
        found: Counter[str] = Counter()
        for one, number in combinations.items():
            found.update(dict.fromkeys(one.found, number))
        asked = {outcome for one in combinations for outcome in one.asked}
        details = sorted(outcome for outcome in found if ": " in outcome)
        errors = [name for name in details if name.startswith(ERROR)]
        faults = [name for name in details if name not in errors]
        names = [ARRIVED, SPECS[0].name, *faults, *(spec.name for spec in SPECS[1:]), ERROR, *errors]
        n = sum(combinations.values())
        counts = {name: found[name] for name in names if name in asked or name in found}
        failed = sum(number for one, number in combinations.items() if not one.passed)
        at_fault = sum(number for one, number in combinations.items() if one.at_fault)
        return cls(n, counts, failed=failed, at_fault=at_fault)

    def count(self, outcome: str) -> int:
        """Return how many scenarios had an outcome of `OUTCOMES` or `counts`; an `InputError` refuses other names."""
        if outcome not in self.counts:
            check_outcome(outcome)
        return {**self.counts, FAILED: self.failed, AT_FAULT: self.at_fault}.get(outcome, 0)

    def rate(self, outcome: str) -> float:
        """Return the share of scenarios with an outcome."""
        return self.count(outcome) / self.n

    def interval(self, outcome: str, alpha: float = ALPHA) -> tuple[float, float]:
        """Return the exact interval of a rate (Clopper and Pearson), which misses it with a probability of alpha."""
        return clopper_pearson(self.count(outcome), self.n, alpha)


class Judge(Evaluator):
    """An evaluator that tells the outcomes of a scenario instead of its trace, which takes longer to pack.

    If the driver decides for many episodes at a time in a compiled environment, it also counts: it drives a block of
    scenarios without recording them, and once more, for their traces, only those that fail. Failures are not
    confirmed one by one: a rate does not depend on the few episodes, if any, that end otherwise in highway-env, and a
    driver that crashes often would take hundreds of times as long.
    """

    def begin(self) -> None:
        """Load the ADS and create its environment; see `Evaluator.begin`."""
        super().begin()
        self.functions = {**self.functions, _CAN_COUNT: self.can_count, _COUNT: self.count}
        self._driven: dict[int, tuple[LockStep, LockStep] | None] = {}  # by the number of slots; see `_episodes`

    def answer(self, trace: Trace) -> bytes:
        """Return the `Outcomes` as a JSON list."""
        return json.dumps(outcomes_of(trace)).encode()

    def _episodes(self, slots: int) -> tuple[LockStep, LockStep] | None:
        """Episodes with short traces and with whole ones; None if this driver or environment cannot count."""
        if not getattr(self.simulation.ads, "vectorized", False):
            return None
        if slots not in self._driven:
            short = self.simulation.lock_step(slots, short=True)
            whole = self.simulation.lock_step(self._lock_step)
            self._driven[slots] = (short, whole) if short is not None and whole is not None else None
        return self._driven[slots]

    def can_count(self, slots: bytes) -> bytes:
        """Return whether `count` can be called for blocks of so many scenarios: one byte if so, none otherwise."""
        return b"1" if self._episodes(int(slots)) else b""

    def count(self, block: bytes) -> bytes:
        """Return the outcomes of a block of scenarios, see `packed`, and numbers of failures that did not recur.

        The block is, as JSON, the state of the generator that draws them, their number, and the number of slots.

        Raises:
            ADSError: if the ADS fails in one of them. It is unknown in which one.
            RuntimeError: if this driver or environment cannot count.
        """
        state, n, slots = json.loads(block)
        generator, logical = _generator(state), self.simulation.logical
        scenarios = [logical.sample(generator) for _ in range(n)]
        driven = self._episodes(slots)
        if driven is None:
            raise RuntimeError("this driver or environment cannot count")
        for episodes in driven:
            if episodes.is_running:  # the driver has failed in an earlier block
                episodes.give_up()
        short, whole = driven
        found: dict[int, Outcomes] = {}
        for number, trace in run_episodes(short, scenarios):
            if trace is not None and (one := _outcomes_of_short(trace)) is not None:
                found[number] = one
        failing = sorted({*range(n)} - found.keys())
        for k, trace in run_episodes(whole, [scenarios[number] for number in failing]):
            found[failing[k]] = outcomes_of(trace)
        differing = [number for number in failing if found[number].passed]
        return json.dumps({**packed([found[number] for number in range(n)]), "differing": differing}).encode()


def start_judge(target: Target, workers: int, driver: ADS | None = None) -> Executor:
    """Start the executor for `estimate_rates`; see `behavexplor.execution.start.start_executor`.

    `driver` is an object of this process that drives in place of the target's driving system, None for none.
    """
    return start_executor(target, workers, recipe=recipe_for(Judge, target), driver=driver)


def estimate_rates(
    judge: Executor,
    logical: LogicalScenario,
    n: int,
    seed: int,
    observe: Observe | None = None,
    *,
    goal: Goal | None = None,
    file: OutcomeFile | None = None,
) -> Evaluation:
    """Evaluate an ADS in uniformly drawn scenarios. The result does not depend on the number of workers.

    The executor is that of `start_judge`; the n scenarios are drawn by the seed. With a goal, the evaluation ends as
    soon as its question is answered, at the latest after n scenarios. A scenario in which the driver's program fails
    then counts against the driver: as one with the goal's outcome, or, if that is "arrived", as one without. `observe`
    gets the number of finished scenarios. With a file, the evaluation goes on from it and is written to it.

    Raises:
        InputError: if the file is damaged, or the environment has no such outcome.
        RuntimeError: if a scenario could not be executed, or failed only once.
    """
    outcomes = uniform_outcomes(judge, logical, n, seed, observe, file)
    if goal is None:
        return Evaluation.of_outcomes(outcomes)
    combinations: Counter[Outcomes] = Counter()
    done, count, errors, look = 0, 0, 0, 1
    for done, one in enumerate(outcomes, 1):
        combinations[one] += 1
        is_error = ERROR in one.found and not _has(one, goal.outcome) and goal.outcome != ARRIVED
        errors += is_error
        count += is_error or _has(one, goal.outcome)
        if done == SMALL_BLOCK:  # early, because an evaluation may take hours
            _check_asked(goal.outcome, combinations)
        if done < look:
            continue
        look = math.ceil(done * _BETWEEN_LOOKS)
        if Decision.of(goal, done, count).verdict:
            break
    _check_asked(goal.outcome, combinations)
    return replace(Evaluation.of_combinations(combinations), decision=Decision.of(goal, done, count, errors))


def _check_asked(outcome: str, scenarios: Iterable[Outcomes]) -> None:
    """Refuse an outcome that means nothing in the environment. No scenario tells it if the program failed in all."""
    asked = {name for one in scenarios for name in one.asked}
    known = {*asked, ERROR, AT_FAULT, FAILED}
    if asked and outcome.partition(": ")[0] not in known:
        has = ", ".join(name for name in OUTCOMES if name in known)
        raise InputError(f"The outcome {outcome!r} means nothing in this environment: name one of {has}")


def _has(one: Outcomes, outcome: str) -> bool:
    """Return whether an outcome of a goal happened in a scenario."""
    if outcome == AT_FAULT:
        return one.at_fault
    return not one.passed if outcome == FAILED else outcome in one.found


def uniform_outcomes(
    judge: Executor,
    logical: LogicalScenario,
    n: int,
    seed: int,
    observe: Observe | None = None,
    file: OutcomeFile | None = None,
) -> Iterator[Outcomes]:
    """Yield the outcomes of uniformly drawn scenarios in their order; see `estimate_rates`.

    Those in the file are not driven again, and the others are added to it in whole blocks.
    """
    observe = observe or (lambda _: None)
    generator = np.random.default_rng([STREAM, seed])
    done = 0
    for block in file.blocks() if file else ():
        yield from block.outcomes[: n - done]
        done, generator = done + len(block.outcomes), _generator(block.state)
        observe(min(done, n))
    for block in uniform_blocks(judge, logical, range(done, n), generator, observe):
        if file is not None:
            file.append(block)
        yield from block.outcomes


def failing(file: OutcomeFile, logical: LogicalScenario, seed: int, n: int) -> Iterator[tuple[int, Scenario]]:
    """Yield number and scenario of each failure among the first n scenarios of an evaluation; see `estimate_rates`."""
    generator, first = np.random.default_rng([STREAM, seed]), 0
    for outcomes, state in file.blocks():
        failed = [place for place, one in enumerate(outcomes) if not one.passed and first + place < n]
        scenarios = [logical.sample(generator) for _ in outcomes] if failed else []
        yield from ((first + place, scenarios[place]) for place in failed)
        generator, first = _generator(state), first + len(outcomes)


def uniform_blocks(
    judge: Executor, logical: LogicalScenario, numbers: range, generator: np.random.Generator, observe: Observe
) -> Iterator[OutcomeBlock]:
    """Yield the outcomes of uniformly drawn scenarios in blocks, in their order; see `estimate_rates`.

    Workers judge several blocks at a time. A block is yielded when all before it have been. `numbers` are those of the
    scenarios.

    Raises:
        RuntimeError: if a scenario could not be executed, or failed only once.
    """
    size = LARGE_BLOCK if numbers.stop >= MANY else BLOCK
    ahead = 0 if judge.runs_here else BLOCKS_AHEAD
    is_counted = bool(judge.submit(_CAN_COUNT, str(size).encode()).result())
    if not is_counted:
        size, ahead = SMALL_BLOCK, AHEAD // SMALL_BLOCK
    begin = _begin_to_count if is_counted else _begin_to_judge
    begun: deque[_Block] = deque()
    for first in range(0, len(numbers), size):
        begun.append(begin(judge, logical, generator, numbers[first : first + size], size))
        if len(begun) > ahead:
            yield _finished(begun.popleft(), observe)
    while begun:
        yield _finished(begun.popleft(), observe)


class _Block(NamedTuple):
    """A block of scenarios that are being driven."""

    numbers: range
    counted: "Future[bytes] | None"  # the outcomes of all scenarios; None if each is judged by its trace
    judged: "Callable[[], list[Future[bytes]]]"  # judges each by its trace, if they are not counted or that failed
    state: Any  # of the generator, after the last scenario


def _begin_to_count(
    judge: Executor, logical: LogicalScenario, generator: np.random.Generator, numbers: range, slots: int
) -> _Block:
    state = generator.bit_generator.state
    counted = judge.submit(_COUNT, json.dumps([state, len(numbers), slots]).encode())
    for _ in numbers:
        logical.pass_over(generator)
    judged = partial(_each, judge, logical, _generator(state), len(numbers))
    return _Block(numbers, counted, judged, generator.bit_generator.state)


def _begin_to_judge(
    judge: Executor, logical: LogicalScenario, generator: np.random.Generator, numbers: range, _: int
) -> _Block:
    answers = _each(judge, logical, generator, len(numbers))
    return _Block(numbers, None, lambda: answers, generator.bit_generator.state)


def _finished(block: _Block, observe: Observe) -> OutcomeBlock:
    """Wait for the outcomes of a block. If counting fails, each scenario is judged by its trace."""
    outcomes = _counted(block.counted, block.numbers) if block.counted else None
    if outcomes is None:
        outcomes = []
        for number, answer in zip(block.numbers, block.judged(), strict=True):
            outcomes.append(_judged(answer))
            observe(number + 1)
    observe(block.numbers.stop)
    return OutcomeBlock(outcomes, block.state)


def _each(judge: Executor, logical: LogicalScenario, generator: np.random.Generator, n: int) -> list["Future[bytes]"]:
    """Judge the next n scenarios one by one, by their traces."""
    scenarios = (logical.sample(generator) for _ in range(n))
    return [judge.submit(EXECUTE, scenario.to_json().encode()) for scenario in scenarios]


def _judged(answer: "Future[bytes]") -> Outcomes:
    """Return the outcomes of a scenario."""
    try:
        return outcomes_from(*json.loads(answer.result()))
    except ADSError as error:
        return outcomes_of_error(error.kind)


def _counted(answer: "Future[bytes]", numbers: range) -> list[Outcomes] | None:
    """Return the outcomes of a counted block; None if that failed, and it is unknown which scenario is to blame."""
    try:
        counted = json.loads(answer.result())
    except (ADSError, InputError, RuntimeError):
        return None
    if differing := counted["differing"]:
        raise RuntimeError(
            f"scenario {numbers[differing[0]]} failed, and did not fail when it was driven again: the driver does not "
            "do the same twice or in a batch (leave out its `vectorized`), or this is an error of behavexplor"
        )
    return unpacked(counted)


def _generator(state: Any) -> np.random.Generator:
    """Return the generator of a state."""
    generator = np.random.default_rng(0)
    generator.bit_generator.state = state
    return generator


@lru_cache(maxsize=1)
def _outcomes_of_short(trace: Trace) -> Outcomes | None:
    """Return the outcomes of a trace that stands for many episodes; None if it shows a failure."""
    one = outcomes_of(trace)
    return one if one.passed else None
