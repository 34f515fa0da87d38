"""Evaluation of an ADS: rates of arrival and violations over uniformly drawn scenarios."""

import json
import math
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, Final, NamedTuple, Self

import numpy as np

from behavexplor.ads.interface import ADS
from behavexplor.data.logical import LogicalScenario
from behavexplor.data.target import Target
from behavexplor.data.trace import ARRIVED, CRASHED, OFF_ROAD, Trace
from behavexplor.errors import InputError
from behavexplor.execution.evaluator import EXECUTE, Evaluator, recipe_for
from behavexplor.execution.executor import ADSError, Executor
from behavexplor.execution.rollout import LockStep, run_episodes
from behavexplor.execution.start import start_executor, start_in_process
from behavexplor.judge.fault import collision_fault, contact_fault, is_at_fault
from behavexplor.judge.rates import AT_FAULT, FAILED, Decision, Goal, clopper_pearson
from behavexplor.judge.specs import SPECS, judge

STREAM: Final = 0x65_76_61_6C  # separates the scenarios of evaluations from those of campaigns and trainings
_BETWEEN_LOOKS: Final = 1.005  # ratio of the numbers of scenarios at two looks at a rate
AHEAD: Final = 1024  # scenarios under way that are judged by their traces, enough for many processes in lock-step
BLOCK, SMALL_BLOCK = 256, 32  # scenarios that are counted together, or judged by their traces
BLOCKS_AHEAD: Final = 64
_SLOTS: Final = 128  # episodes in lock-step while failures are counted
_COUNTS, _COUNT = "counts", "count"  # functions of the service
_FIRST_CODE: Final = ord("A")

_SIGNALS: Final = {ARRIVED: ARRIVED, SPECS[1].name: OFF_ROAD, SPECS[2].name: ARRIVED}  # that an outcome needs


class Outcomes(NamedTuple):
    """What happened in one scenario.

    Attributes:
        found: the outcomes, see `Evaluation`.
        asked: the outcomes, beside the verdicts on a collision, that mean something in the environment.
        at_fault: whether the driver failed by its own fault; see `behavexplor.campaign.record.Record.at_fault`.
    """

    found: tuple[str, ...]
    asked: tuple[str, ...]
    at_fault: bool

    @property
    def passed(self) -> bool:
        """True if the driver did not fail."""
        return set(self.found) <= {ARRIVED}


@dataclass(frozen=True)
class Evaluation:
    """Outcomes of a number of scenarios.

    Attributes:
        n: number of scenarios.
        counts: number of scenarios by outcome: "arrived", each spec for its violations, and "collision: " with each
            verdict on a collision. Outcomes are in the order in which they are reported.
        decision: what was decided on a rate, if the evaluation ended when enough was known. Its number of scenarios
            then depends on what happened in them, so `interval` does not hold, but that of the decision does.
    """

    n: int
    counts: Mapping[str, int]
    decision: Decision | None = None

    @classmethod
    def of(cls, traces: Iterable[Trace]) -> Self:
        """Judge traces and count their outcomes."""
        return cls.of_outcomes(map(outcomes_of, traces))

    @classmethod
    def of_outcomes(cls, scenarios: Iterable[Outcomes]) -> Self:
        """Count the outcomes of scenarios. An outcome that means nothing in any of them is left out."""
        return cls.of_kinds(Counter(scenarios))

    @classmethod
    def of_kinds(cls, kinds: Mapping[Outcomes, int]) -> Self:
        """Count the outcomes of scenarios by how often each combination of outcomes occurred."""
        found: Counter[str] = Counter()
        for one, count in kinds.items():
            found.update(dict.fromkeys(one.found, count))
        asked = {outcome for one in kinds for outcome in one.asked}
        faults = sorted(outcome for outcome in found if ": " in outcome)
        names = [ARRIVED, SPECS[0].name, *faults, *(spec.name for spec in SPECS[1:])]
        n = sum(kinds.values())
        return cls(n, {name: found[name] for name in names if name in asked or name in faults})

    def rate(self, outcome: str) -> float:
        """Return the share of scenarios with an outcome."""
        return self.counts.get(outcome, 0) / self.n

    def interval(self, outcome: str) -> tuple[float, float]:
        """Return the exact 95 % interval of a rate (Clopper and Pearson)."""
        return clopper_pearson(self.counts.get(outcome, 0), self.n)


class Judge(Evaluator):
    """An evaluator that tells the outcomes of a scenario instead of its trace, which takes longer to pack.

    If the driver decides for many episodes at a time in a compiled environment, it also counts: it drives a block of
    scenarios without recording them, and drives only those that fail once more, for their traces. Failures are not
    confirmed one by one: a rate does not depend on the few episodes, if any, that end otherwise in highway-env, and a
    driver that crashes often would take hundreds of times as long.
    """

    confirms = False

    def begin(self) -> None:
        """Load the ADS and create its environment; see `Evaluator.begin`."""
        super().begin()
        self.functions = {**self.functions, _COUNTS: self.counts, _COUNT: self.count}

    def answer(self, trace: Trace) -> bytes:
        """Return the `Outcomes` as a JSON list."""
        return json.dumps(outcomes_of(trace)).encode()

    @cached_property
    def _driven(self) -> tuple[LockStep, LockStep] | None:
        """Episodes with short traces and with whole ones; None if this driver or environment cannot count."""
        if not getattr(self.simulation.ads, "vectorized", False):
            return None
        short, whole = self.simulation.lock_step(_SLOTS, short=True), self.simulation.lock_step(self._lock_step)
        return (short, whole) if short is not None and whole is not None else None

    def counts(self, _: bytes) -> bytes:
        """Return whether `count` can be called: one byte if so, none otherwise."""
        return b"1" if self._driven else b""

    def count(self, block: bytes) -> bytes:
        """Return the outcomes of a block of scenarios, see `packed`.

        Args:
            block: state of the generator that draws them, and their number, as JSON.

        Raises:
            ADSError: if the ADS fails in one of them. It is unknown in which one.
            RuntimeError: if a failure did not recur.
        """
        state, n = json.loads(block)
        generator, logical = _generator(state), self.simulation.logical
        scenarios = [logical.sample(generator) for _ in range(n)]
        if self._driven is None:
            raise RuntimeError("this driver or environment cannot count")
        for episodes in self._driven:
            if episodes.is_running:  # the driver has failed in an earlier block
                episodes.give_up()
        short, whole = self._driven
        found: dict[int, Outcomes] = {}
        for number, trace in run_episodes(short, scenarios):
            if trace is not None and (one := _outcomes_of_short(trace)).passed:
                found[number] = one
        failing = sorted({*range(n)} - found.keys())
        for k, trace in run_episodes(whole, [scenarios[number] for number in failing]):
            found[failing[k]] = outcomes_of(trace)
        differing = [number for number in failing if found[number].passed]
        return json.dumps({**packed([found[number] for number in range(n)]), "differing": differing}).encode()


def start_judge(target: Target, workers: int, driver: ADS | None = None) -> Executor:
    """Start the executor for `estimate_rates`; see `behavexplor.execution.start.start_executor`.

    Args:
        target: the driving system and its environment.
        workers: number of worker processes.
        driver: object of this process that drives in place of the driving system of that name; None for none.
    """
    recipe = recipe_for(Judge, target)
    return (
        start_executor(target, workers, recipe=recipe) if driver is None else start_in_process(target, driver, recipe)
    )


def estimate_rates(
    judge: Executor, logical: LogicalScenario, n: int, seed: int, observe: Callable[[int], None] | None = None
) -> Evaluation:
    """Evaluate an ADS in uniformly drawn scenarios. The result does not depend on the number of workers.

    Args:
        judge: executor of the ADS, see `start_judge`.
        logical: logical scenario of its environment.
        n: number of scenarios.
        seed: seed of the random scenarios.
        observe: callback that gets the number of finished scenarios.

    Raises:
        ADSError: if the ADS fails in a scenario.
        RuntimeError: if a scenario could not be executed.
    """
    return Evaluation.of_outcomes(uniform_outcomes(judge, logical, n, seed, observe))


def decide_rate(
    judge: Executor,
    logical: LogicalScenario,
    goal: Goal,
    most: int,
    seed: int,
    observe: Callable[[int], None] | None = None,
) -> Evaluation:
    """Evaluate an ADS in uniformly drawn scenarios until a goal is reached. Workers do not change the result.

    Args:
        judge: see `estimate_rates`.
        logical: see `estimate_rates`.
        goal: what is to be known.
        most: greatest number of scenarios.
        seed: see `estimate_rates`.
        observe: see `estimate_rates`.

    Raises:
        ADSError: if the ADS fails in a scenario.
        RuntimeError: if a scenario could not be executed.
    """
    kinds: Counter[Outcomes] = Counter()
    n, count, look = 0, 0, 1
    for n, one in enumerate(uniform_outcomes(judge, logical, most, seed, observe), 1):
        kinds[one] += 1
        count += _has(one, goal.outcome)
        if n < look:
            continue
        look = math.ceil(n * _BETWEEN_LOOKS)
        if Decision.of(goal, n, count).verdict:
            break
    return replace(Evaluation.of_kinds(kinds), decision=Decision.of(goal, n, count))


def _has(one: Outcomes, outcome: str) -> bool:
    """Return whether an outcome of a goal happened in a scenario."""
    if outcome == AT_FAULT:
        return one.at_fault
    return not one.passed if outcome == FAILED else outcome in one.found


def uniform_outcomes(
    judge: Executor, logical: LogicalScenario, n: int, seed: int, observe: Callable[[int], None] | None = None
) -> Iterator[Outcomes]:
    """Yield the outcomes of uniformly drawn scenarios in their order; see `estimate_rates`."""
    for block in uniform_blocks(judge, logical, n, np.random.default_rng([STREAM, seed]), observe):
        yield from block


def uniform_blocks(
    judge: Executor,
    logical: LogicalScenario,
    n: int,
    generator: np.random.Generator,
    observe: Callable[[int], None] | None = None,
) -> Iterator[list[Outcomes]]:
    """Yield the outcomes of uniformly drawn scenarios in blocks, in their order; see `estimate_rates`.

    Workers judge several blocks at a time. A block is yielded when all before it have been.

    Raises:
        ADSError: if the ADS fails in a scenario.
        RuntimeError: if a scenario could not be executed, or failed only once.
    """
    is_counted = bool(judge.submit(_COUNTS, b"").result())
    size, ahead = (SMALL_BLOCK, AHEAD // SMALL_BLOCK)
    if is_counted:
        size, ahead = BLOCK, 0 if judge.runs_here else BLOCKS_AHEAD
    started: deque[_Block] = deque()
    for first in range(0, n, size):
        started.append(_Block(judge, logical, generator, range(first, min(first + size, n)), is_counted=is_counted))
        if len(started) > ahead:
            yield started.popleft().outcomes(observe)
    while started:
        yield started.popleft().outcomes(observe)


class _Block:
    """Scenarios that follow one another, and are being judged.

    Args:
        judge: see `estimate_rates`.
        logical: see `estimate_rates`.
        generator: generator that draws the scenarios, which afterwards draws those behind them.
        numbers: their numbers.
        is_counted: whether they are counted; see `Judge`. They are judged one by one if that fails, since it then
            turns out which scenario is to blame.
    """

    def __init__(
        self,
        judge: Executor,
        logical: LogicalScenario,
        generator: np.random.Generator,
        numbers: range,
        *,
        is_counted: bool,
    ) -> None:
        self._judge, self._logical, self._numbers = judge, logical, numbers
        self._state = generator.bit_generator.state
        self._counted: Future[bytes] | None = None
        self._judged: list[Future[bytes]] = []
        if not is_counted:
            self._judge_each(generator)
            return
        self._counted = judge.submit(_COUNT, json.dumps([self._state, len(numbers)]).encode())
        for _ in numbers:
            logical.pass_over(generator)

    def _judge_each(self, generator: np.random.Generator) -> None:
        scenarios = (self._logical.sample(generator) for _ in self._numbers)
        self._judged = [self._judge.submit(EXECUTE, scenario.to_json().encode()) for scenario in scenarios]

    def outcomes(self, observe: Callable[[int], None] | None) -> list[Outcomes]:
        """Wait for the outcomes, and return them."""
        observe = observe or (lambda _: None)
        try:
            counted = json.loads(self._counted.result()) if self._counted else None
        except (ADSError, InputError, RuntimeError):
            counted = None
            self._judge_each(_generator(self._state))
        if counted is None:
            found = []
            for number, future in zip(self._numbers, self._judged, strict=True):
                found.append(_outcomes(*json.loads(future.result())))
                observe(number + 1)
            return found
        for number in counted["differing"]:
            raise RuntimeError(
                f"scenario {self._numbers[number]} failed, and did not fail when it was driven again: the driver does "
                f"not do the same twice, or this is an error of behavexplor"
            )
        observe(self._numbers.stop)
        return unpacked(counted)


def packed(outcomes: Sequence[Outcomes]) -> dict[str, Any]:
    """Return the outcomes of scenarios as JSON values: their kinds, and a letter for each scenario."""
    places = {kind: place for place, kind in enumerate(dict.fromkeys(outcomes))}
    return {"kinds": [*places], "codes": "".join(chr(_FIRST_CODE + places[one]) for one in outcomes)}


def unpacked(values: Mapping[str, Any]) -> list[Outcomes]:
    """Return the outcomes that `packed` made values of."""
    kinds = [_outcomes(*kind) for kind in values["kinds"]]
    return [kinds[ord(code) - _FIRST_CODE] for code in values["codes"]]


def _outcomes(found: Iterable[str], asked: Iterable[str], at_fault: bool) -> Outcomes:
    return Outcomes(tuple(found), tuple(asked), at_fault)


def _generator(state: Any) -> np.random.Generator:
    """Return the generator of a state."""
    generator = np.random.default_rng(0)
    generator.bit_generator.state = state
    return generator


def outcomes_of(trace: Trace) -> Outcomes:
    """Judge a trace."""
    verdict = judge(trace, SPECS)
    arrived = trace.signals[ARRIVED].any() if ARRIVED in trace.signals else trace.end == ARRIVED
    arrived = arrived and trace.end != "collision"  # in a roundabout, an ego may get beyond the entry and crash there
    fault = contact_fault(trace)
    faults = [f"{SPECS[0].name}: {fault}"] if fault else []
    found = (*([ARRIVED] if arrived else []), *verdict.violated, *faults)
    names = (ARRIVED, *(spec.name for spec in SPECS))
    asked = tuple(name for name in names if not trace.signals or _SIGNALS.get(name, CRASHED) in trace.signals)
    at_fault = bool(verdict.violated) and is_at_fault(collision_fault(trace, verdict.violated))
    return Outcomes(found, asked, at_fault)


_outcomes_of_short = lru_cache(maxsize=1)(outcomes_of)  # of the trace that stands for all episodes without failure
