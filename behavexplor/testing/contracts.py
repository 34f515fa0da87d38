"""Contract tests for driving systems, environments, specs and search methods, in this order."""

import json
import math
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass, is_dataclass, replace
from typing import Any, Final

import gymnasium
import numpy as np

from behavexplor.data.scenario import LogicalScenario, Scenario, parse_scenario
from behavexplor.data.trace import ENDS, Trace
from behavexplor.envs.making import make_env
from behavexplor.errors import InputError
from behavexplor.execution.executor import ADSError
from behavexplor.execution.preflight import preflight_warnings
from behavexplor.execution.simulation import Simulation, logical_scenario
from behavexplor.fuzz.methods import load_method
from behavexplor.fuzz.search import Candidate, SearchExhausted, SearchMethod
from behavexplor.judge.robustness import as_spec, load_spec
from behavexplor.judge.specs import Verdict, judge
from behavexplor.testing.synthetic import synthetic_trace

ADS_SCENARIOS: Final = 4  # that a driving system drives by default
ENV_SCENARIOS: Final = 3  # that an environment executes by default
MOST_STEPS: Final = 100_000  # in which every episode must have ended
TRACES: Final = 20  # on which a spec is called by default
_ACTIONS: Final = 10  # random actions in an executed episode; the last one lasts to its end
IN_FLIGHT: Final = (1, 8)  # tested numbers of candidates in flight
SEEDS: Final = (0, 1)  # of the tested searches
Judge = Callable[[Trace], Verdict]


class ContractError(AssertionError):
    """An implementation breaks a promise of its interface; the message says which one, and how."""


def promise(kept: object, sentence: str) -> None:
    """Raise a `ContractError` unless a promise is kept. `sentence` says what is wrong and what the interface asks."""
    if not kept:
        raise ContractError(sentence)


def check_ads(ads: Any, *, env: str = "intersection-straight", scenarios: int = ADS_SCENARIOS) -> list[str]:
    """Check that a driving system keeps the promises of `behavexplor.ads.interface.ADS`.

    Args:
        ads: the driving system, or its name as for `--ads`.
        env: the environment in which it drives.
        scenarios: number of scenarios that it drives, at least 2.

    Returns:
        Warnings, a sentence each: the system always answers the same, or never moves.

    Raises:
        ContractError: if a promise is broken.
        InputError: if there is no such system or environment, or they do not fit each other.
    """
    simulation = Simulation(env, ads)
    try:
        generator = np.random.default_rng(0)
        chosen = [simulation.logical.sample(generator) for _ in range(max(scenarios, 2))]
        alone = [_driven(simulation, scenario) for scenario in chosen]
        again = [_driven(simulation, scenario) for scenario in reversed(chosen)]
        promise(
            alone == again[::-1],
            "The same scenario gave another trace when it was driven again after other scenarios: decide "
            "deterministically, and keep nothing from one episode to the next",
        )
        if getattr(simulation.ads, "vectorized", False):
            together = dict(simulation.run_all(chosen, len(chosen)))
            promise(
                [together[i].to_bytes() for i in range(len(chosen))] == alone,
                "`vectorized` is true, but an episode in a batch is not the episode alone: decide each row from "
                "its own observation and state",
            )
        return preflight_warnings(simulation)
    finally:
        simulation.close()


def _driven(simulation: Simulation, scenario: Scenario) -> bytes:
    try:
        return simulation.run(scenario).to_bytes()
    except ADSError as error:
        raise ContractError(f"In a valid scenario {error}") from error


def check_env(env: str, *, scenarios: int = ENV_SCENARIOS) -> None:
    """Check that an environment executes concrete scenarios as a campaign asks it to.

    `gymnasium.utils.env_checker.check_env` checks the rest of an environment.

    Args:
        env: a functional scenario, or a gymnasium id.
        scenarios: number of scenarios that are executed.

    Raises:
        ContractError: if a promise is broken.
        InputError: if there is no such environment, or it has no `logical`.
    """
    logical = logical_scenario(env)
    made = make_env(env, {})
    made.action_space.seed(0)
    generator = np.random.default_rng(0)
    try:
        for _ in range(scenarios):
            scenario = _sampled(logical, generator)
            actions = [made.action_space.sample() for _ in range(_ACTIONS)]
            first, again = (executed(made, scenario, actions) for _ in range(2))
            promise(
                first.to_bytes() == again.to_bytes(),
                "The same scenario and actions gave another trace: nothing but the scenario may decide an episode",
            )
            _check_trace(first, scenario)
        _, info = made.reset(seed=0)
        promise("scenario" in info, 'reset without options must sample a scenario and return it as info["scenario"]')
    finally:
        made.close()


def _sampled(logical: LogicalScenario, generator: np.random.Generator) -> Scenario:
    scenario = logical.sample(generator)
    try:
        logical.check(scenario)
    except InputError as error:
        raise ContractError(f"`logical` sampled a scenario that it refuses: {error}") from error
    promise(parse_scenario(scenario.to_json()) == scenario, "A scenario must be the same after to_json and from_json")
    return scenario


def executed(env: gymnasium.Env[Any, Any], scenario: Scenario, actions: list[Any]) -> Trace:
    """Run a scenario to its end, with the last action again and again after the others, and return the trace.

    Raises:
        ContractError: if the environment breaks a promise.
    """
    _, info = env.reset(options={"scenario": scenario})
    promise(info.get("scenario") == scenario, 'reset must return the scenario that runs as info["scenario"]')
    for step in range(MOST_STEPS):
        _, _, terminated, truncated, info = env.step(actions[min(step, len(actions) - 1)])
        if terminated or truncated:
            break
    else:
        raise ContractError(f"The episode has not ended after {MOST_STEPS} steps")
    promise(isinstance(info.get("trace"), Trace), 'The last step must return the trace as info["trace"]')
    trace: Trace = info["trace"]
    return trace


def _check_trace(trace: Trace, scenario: Scenario) -> None:
    promise(
        scenario.has_original or len(trace.size) == 1 + len(scenario.npcs),  # only scripted vehicles are in `npcs`
        f"The trace has {len(trace.size) - 1} vehicles beside the ego, which is not the scenario's number of NPCs",
    )
    promise(trace.end in ENDS, f"The trace ended with {trace.end!r}, which is none of {', '.join(ENDS)}")
    promise(Trace.from_bytes(trace.to_bytes()).to_bytes() == trace.to_bytes(), "The trace must survive to_bytes")


def check_spec(spec: Any, *, env: str = "intersection-straight", traces: int = TRACES) -> None:
    """Check that a spec (`behavexplor.judge.robustness`) gives a number for every trace, and the same each time.

    Args:
        spec: a callable on a trace, or its name as for `--spec`.
        env: the environment whose scenarios give the traces. In an environment of highway-env, the traces are those of
            episodes with random actions, so they take some time.
        traces: number of traces, at least 1. In addition, the spec is called on a trace without NPCs, and on one of a
            single frame, as an ADS leaves it that fails in its first decision.

    Raises:
        ContractError: if a promise is broken.
        InputError: if there is no such spec or environment.
    """
    made = load_spec(spec) if isinstance(spec, str) else as_spec(spec)
    for trace in _traces(env, max(traces, 1)):
        _check_robustness(made, trace, "a trace")
    _check_robustness(made, _without_npcs(trace), "a trace without NPCs")
    _check_robustness(made, trace.until(1, "error"), "a trace of a single frame")


def _traces(env: str, count: int) -> Iterator[Trace]:
    logical = logical_scenario(env)
    generator = np.random.default_rng(0)
    if not logical.has_original:  # its vehicles are scripted
        yield from (synthetic_trace(logical.sample(generator), logical) for _ in range(count))
        return
    with closing(make_env(env, {})) as made:
        made.action_space.seed(0)
        for _ in range(count):
            actions = [made.action_space.sample() for _ in range(_ACTIONS)]
            yield executed(made, logical.sample(generator), actions)


def _without_npcs(trace: Trace) -> Trace:
    """Return a trace as if the ego had driven alone."""
    motion = {name: getattr(trace, name)[:, :1] for name in ("position", "heading", "velocity")}
    signals = {name: values if values.ndim == 1 else values[:, :1] for name, values in trace.signals.items()}
    return replace(trace, **motion, size=trace.size[:1], present=trace.present[:, :1], partner=-1, signals=signals)


def _check_robustness(spec: Any, trace: Trace, what: str) -> None:
    try:
        first, again = (judge(trace, [spec]) for _ in range(2))
    except InputError as error:
        raise ContractError(f"On {what}: {error}") from error
    promise(
        dict(first.degrees) == dict(again.degrees) and first.violated == again.violated,
        f"{spec.name} gave another robustness when it was called on {what} again",
    )


@dataclass(frozen=True)
class _Told:
    """One step of a campaign: a candidate, its trace and verdict, and the values that `tell` returned."""

    candidate: Candidate
    trace: Trace
    verdict: Verdict
    learned: Mapping[str, Any]


def check_search_method(
    method: str | type[SearchMethod], options: Any = None, *, env: str = "intersection-straight", executions: int = 60
) -> None:
    """Check that a search method keeps the promises of `behavexplor.fuzz.search.SearchMethod`.

    The method runs on synthetic traces, so no simulator is needed.

    Args:
        method: the class, or its name as for `--method`.
        options: an instance of the method's `Options`; None for the default options.
        env: the environment whose scenarios are searched.
        executions: number of executions in each test campaign.

    Raises:
        ContractError: if a promise is broken.
        InputError: if there is no such method or environment.
    """
    kind = load_method(method) if isinstance(method, str) else method
    _check_class(kind)
    logical = logical_scenario(env)
    chosen = kind.Options() if options is None else options

    def build(seed: int) -> SearchMethod:
        return kind(logical, seed, chosen)

    for in_flight in IN_FLIGHT:
        first, again = (_campaign(build(SEEDS[0]), logical, executions, in_flight) for _ in range(2))
        promise(
            [_asked(told) for told in first] == [_asked(told) for told in again],
            f"Two searches with the seed {SEEDS[0]} and {in_flight} candidates in flight asked for different "
            f"scenarios: draw random numbers from behavexplor.fuzz.search.draws(seed, number) only",
        )
        promise(
            [dict(told.learned) for told in first] == [dict(told.learned) for told in again],
            "Two searches with the same seed returned different values from tell",
        )
    _check_resuming(build, logical, executions)
    other = _campaign(build(SEEDS[1]), logical, executions, 1)
    promise(
        {told.candidate.scenario for told in first} != {told.candidate.scenario for told in other},
        f"The seeds {SEEDS[0]} and {SEEDS[1]} gave the same scenarios: use the seed",
    )
    for judged in (_all_fail, _none_fails):
        with suppress(SearchExhausted):  # a search may have nothing left to ask for
            _campaign(build(SEEDS[0]), logical, executions, IN_FLIGHT[-1], judged)


def _check_class(kind: Any) -> None:
    promise(isinstance(kind, type), f"{kind!r} is not a class: a campaign makes it as method(logical, seed, options)")
    for name in ("Options", "ask", "tell", "status"):
        promise(hasattr(kind, name), f"{kind.__name__} has no {name}")
    promise(is_dataclass(kind.Options), f"{kind.__name__}.Options is not a dataclass")
    promise((kind.__doc__ or "").strip(), f"{kind.__name__} has no docstring: its first line is its description")


def _campaign(
    search: SearchMethod, logical: LogicalScenario, executions: int, in_flight: int, judged: Judge = judge
) -> list[_Told]:
    """Run a search on synthetic traces, as a campaign does."""
    waiting: deque[Candidate] = deque()
    told: list[_Told] = []
    while len(told) < executions:
        while len(waiting) < min(in_flight, executions - len(told)):
            waiting.append(search.ask())
        candidate = waiting.popleft()
        _check_candidate(candidate, len(told), logical)
        trace = synthetic_trace(candidate.scenario, logical)
        verdict = judged(trace)
        told.append(_Told(candidate, trace, verdict, search.tell(candidate, trace, verdict)))
        _check_learned(told[-1], search)
    return told


def _check_candidate(candidate: Candidate, number: int, logical: LogicalScenario) -> None:
    promise(candidate.number == number, f"Candidate {number} has the number {candidate.number}: count from 0")
    promise(candidate.origin, f"Candidate {number} has no origin: say how it was made")
    promise(
        candidate.parent is None or 0 <= candidate.parent < number,
        f"Candidate {number} has the parent {candidate.parent}, which was not asked for before it",
    )
    try:
        logical.check(candidate.scenario)
    except InputError as error:
        raise ContractError(f"The scenario of candidate {number} cannot be run: {error}") from error


def _check_learned(told: _Told, search: SearchMethod) -> None:
    try:
        json.dumps(dict(told.learned), allow_nan=False)
    except (TypeError, ValueError) as error:
        raise ContractError(f"tell returned what is not JSON, {told.learned!r:.80}: {error}") from error
    status = search.status()
    promise(
        all(isinstance(value, (int, float)) and math.isfinite(value) for value in status.values()),
        f"status returned {dict(status)!r:.80}: give finite numbers by name",
    )


def _check_resuming(build: Callable[[int], SearchMethod], logical: LogicalScenario, executions: int) -> None:
    """Check that a fresh search continues like the first one after the same results: a campaign is resumed so."""
    search = build(SEEDS[0])
    told = _campaign(search, logical, executions // 2, IN_FLIGHT[0])
    fresh = build(SEEDS[0])
    for step in told:
        candidate = fresh.ask()
        promise(candidate == step.candidate, f"A resumed search asked for another candidate {step.candidate.number}")
        fresh.tell(candidate, step.trace, step.verdict)
    with suppress(SearchExhausted):
        promise(
            fresh.ask() == search.ask(), "A resumed search asks for other scenarios: change state in ask and tell only"
        )


def _asked(told: _Told) -> tuple[Any, ...]:
    return told.candidate.number, told.candidate.origin, told.candidate.parent, told.candidate.scenario


def _all_fail(trace: Trace) -> Verdict:
    verdict = judge(trace)
    return Verdict(verdict.degrees, (next(iter(verdict.degrees)),))


def _none_fails(trace: Trace) -> Verdict:
    return Verdict(judge(trace).degrees, ())
