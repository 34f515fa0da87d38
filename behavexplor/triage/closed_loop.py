"""What would have avoided a crash in traffic that reacts: another driver, or other actions at the last decisions.

In a highway-env environment, the other vehicles react to the ego, so a maneuver cannot be tried against their recorded
motion. Other drivers drive the scenario from its start instead: a careful one, those that always do the same, and some
of random actions. A witness is one that avoids the crash, and fails in no other way, in the whole scenario.

In the compiled form of such an environment, an episode can also go on from a copy of its state. So all sequences of the
policy's own actions are driven from each of its last decisions, and nothing is estimated: if none of them survives, the
crash was inevitable at that decision.
"""

import json
from dataclasses import replace
from functools import lru_cache
from typing import Any, Final, Literal, NamedTuple

import numpy as np

from behavexplor.ads.careful import CarefulDriver
from behavexplor.data.array_types import Array, Ints
from behavexplor.data.conventions import MANEUVERS
from behavexplor.data.drawn_scenario import DrawnScenario, Setup, config_text
from behavexplor.data.trace import ARRIVED, CRASHED, Trace
from behavexplor.envs.highway.drawn_vector_env import DrawnVectorEnv
from behavexplor.envs.making import make_recorded, make_vector_env
from behavexplor.errors import InputError
from behavexplor.execution.executor import ADSError
from behavexplor.execution.rollout import rollout, rollout_all
from behavexplor.execution.simulation import Simulation
from behavexplor.judge.fault import is_standing
from behavexplor.judge.specs import judge
from behavexplor.triage.findings import LastChance, OtherDriver

CONSTANT: Final = ("SLOWER", "IDLE", "FASTER", "LANE_LEFT", "LANE_RIGHT")  # in the order in which they are named
RANDOM: Final = 11  # drivers of random actions
HELD: Final = 2  # decisions for which such a driver keeps an action
MOST_DECISIONS: Final = 500
STANDING_STILL: Final = "standing still"  # what a witness is called that avoids the crash by no more than that
BEYOND: Final = 3  # decisions after that of the crash for which a sequence of actions must survive
MOST_BACK: Final = 4  # last decisions before the crash that are examined
MOST_BRANCHINGS: Final = 300  # states from which all actions are driven before the search is given up

Actions = Ints
State = tuple[Array, ...]  # copy of the state of an episode
TrialVerdict = Literal["preventable", "standing_still_avoids_it", "unpreventable"]


class OtherDrivers(NamedTuple):
    """What other drivers tell of a crash."""

    # the first one that keeps all requirements, if possible one that does not just stand in the end; None if none does
    driver: OtherDriver | None
    tried: int  # number of drivers; 0 if they cannot drive in the environment
    # None if none was tried, or if those without a crash failed in another way and none of them stands in the end
    answer: TrialVerdict | None


class ScriptedDriver:
    """A driver of B egos that takes actions from a table.

    The table has actions by ego and decision, shape (B, D, ...). After the last one, it is taken again and again.
    """

    vectorized: bool = True

    def __init__(self, actions: Array) -> None:
        self._actions = actions

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,  # noqa: ARG002 - all episodes start together
        deterministic: bool = True,  # noqa: ARG002 - it always is
    ) -> tuple[Array, Any]:
        """Return the next action of each ego, shape (B, ...); see `behavexplor.ads.interface.ADS`."""
        decision = 0 if state is None else state
        rows = self._actions[: len(observation)]
        return rows[:, min(decision, rows.shape[1] - 1)], decision + 1


def find_driver(
    scenario: DrawnScenario, crash: Trace, chance: LastChance | None, rng: np.random.Generator
) -> OtherDrivers:
    """Find a driver that keeps all requirements of the environment in a scenario; `rng` draws the random actions.

    If the others all fail, those are tried that drive as the ego did in the `crash` up to its last `chance`.
    """
    names = ["careful"]
    names += [f"always {name}" for name in CONSTANT]
    names += [f"random actions {i}" for i in range(1, RANDOM + 1)]
    try:
        traces = _driven(scenario, _actions(rng))
    # the environment cannot be configured for them, or has a wrapper of its own around what they see
    except (InputError, ADSError):
        return OtherDrivers(None, 0, None)
    driven = list(zip(names, traces, strict=True))
    good = [pair for pair in driven if not judge(pair[1]).failed]
    if not good and chance is not None:
        saved = _saved(scenario, crash, chance)
        good = [pair for pair in saved if not judge(pair[1]).failed]
        driven += saved
    if good:
        name, trace = next((pair for pair in good if not _only_stands(pair[1])), good[0])
        shown = f"{STANDING_STILL} ({name})" if _only_stands(trace) else name
        driver = OtherDriver(shown, tuple(trace.actions[:, 0].astype(int).tolist()))
        return OtherDrivers(driver, len(driven), "preventable")
    safe = [trace for _, trace in driven if not trace.signals[CRASHED].any()]
    if not safe:
        return OtherDrivers(None, len(driven), "unpreventable")
    return OtherDrivers(None, len(driven), "standing_still_avoids_it" if any(map(is_standing, safe)) else None)


def _saved(scenario: DrawnScenario, crash: Trace, chance: LastChance) -> list[tuple[str, Trace]]:
    """Drive as recorded up to the last chance, then take a saving action, and then always the same one.

    A drive that differs from the recorded one before that is left out.
    """
    indices = [MANEUVERS.index(name) for name in scenario.meta_actions]
    recorded = [indices[int(action)] for action in crash.actions[: -chance.back, 0]]
    pairs = [(saving, name) for saving in chance.saving for name in CONSTANT]
    actions = [[*recorded, MANEUVERS.index(saving), MANEUVERS.index(name)] for saving, name in pairs]
    names = [f"the last chance ({saving}, then always {name})" for saving, name in pairs]
    same = replace(scenario, setup=_environment(scenario.setup).logical.setup)
    traces = _compiled(scenario.setup, ScriptedDriver(np.array(actions)), same, len(actions))
    until = crash.action_frame[-chance.back] + 1
    return [
        (name, trace)
        for name, trace in zip(names, traces, strict=True)
        if np.array_equal(trace.position[:until, 0], crash.position[:until, 0])
    ]


def _only_stands(trace: Trace) -> bool:
    """Return whether the ego stands in the end, in an environment in which it need not arrive."""
    return ARRIVED not in trace.signals and is_standing(trace)


def drive_again(scenario: DrawnScenario, driver: OtherDriver) -> Trace:
    """Return the trace of a driver in a scenario, from highway-env itself."""
    env = _environment(scenario.setup)
    return rollout(env, ScriptedDriver(np.array([driver.actions])), replace(scenario, setup=env.logical.setup))


def _actions(rng: np.random.Generator) -> Actions:
    """Return the actions of all drivers but the careful one, shape (drivers, decisions)."""
    constant = np.array([[MANEUVERS.index(name)] * MOST_DECISIONS for name in CONSTANT])
    drawn = rng.integers(len(MANEUVERS), size=(RANDOM, MOST_DECISIONS // HELD))
    return np.concatenate([constant, np.repeat(drawn, HELD, axis=1)])


def _driven(scenario: DrawnScenario, actions: Actions) -> list[Trace]:
    """Return the trace of the careful driver, and one for each row of actions."""
    env, careful = _environment(scenario.setup), CarefulDriver()
    same = replace(scenario, setup=env.logical.setup)  # the scenario in that environment
    try:
        return [
            *_compiled(scenario.setup, careful, same, 1),
            *_compiled(scenario.setup, ScriptedDriver(actions), same, len(actions)),
        ]
    except InputError:  # the environment has no compiled form
        return [rollout(env, driver, same) for driver in (careful, *(ScriptedDriver(row[None]) for row in actions))]


def _compiled(setup: Setup, driver: Any, scenario: DrawnScenario, count: int) -> list[Trace]:
    """Return the traces of so many egos with a driver, each alone in a scenario of `_environment(setup)`."""
    ended = dict(rollout_all(_lock_step(setup, count), driver, [scenario] * count))
    return [ended[row] for row in range(count)]


@lru_cache(maxsize=1)  # making an environment takes longer than driving in it, and all failures of a run have the same
def _environment(setup: Setup) -> Any:
    """Return an environment in which the careful driver and meta-actions can drive."""
    return make_recorded(replace(setup, config=config_text(CarefulDriver().fitted(json.loads(setup.config)))))


@lru_cache(maxsize=3)  # one for the careful driver alone, one for all others together, and the latest of `_saved`
def _lock_step(setup: Setup, count: int) -> Any:
    """Return a vector environment of `_environment(setup)` with so many sub-environments."""
    return make_vector_env(_environment(setup), count, {})


def last_chance(simulation: Simulation, scenario: Any, trace: Trace) -> LastChance | None:
    """Find the last chance to avoid the crash at the end of an execution; the ADS of the simulation is not used.

    It is None if there is none among the last `MOST_BACK` decisions or it takes too long to find it, if the execution
    ends otherwise, or if the environment has no compiled form or no meta-actions.
    """
    if trace.end != "collision" or not scenario.meta_actions:
        return None
    branching = _branching(simulation)
    return None if branching is None else branching.search(scenario, trace.actions[:, 0].astype(np.int64))


@lru_cache(maxsize=1)  # making an environment takes longer than a search, and all failures of a run have the same
def _branching(simulation: Simulation) -> "Branching | None":
    names = getattr(simulation.env, "meta_actions", ())
    env: Any = simulation.vector_env(len(names)) if names else None
    return None if env is None else Branching(env, names)


class Branching:
    """Drives all actions, by their names, from a state at the same time, each in its own sub-environment."""

    def __init__(self, env: DrawnVectorEnv, names: tuple[str, ...]) -> None:
        self._env, self._engine, self._names = env, env.engine, names
        self._all = np.arange(len(names))
        self._left = 0  # branchings before the search is given up

    def search(self, scenario: DrawnScenario, actions: Ints) -> LastChance | None:
        """Search for the last chance in an episode of these actions, shape (D,), that ended with a crash."""
        states = self._states(scenario, actions)
        self._left = MOST_BRANCHINGS
        for back in range(1, min(len(states), MOST_BACK) + 1):
            after = self._branches(states[-back])
            saving = [
                name for name, state in zip(self._names, after, strict=True) if self._survives(state, back - 1 + BEYOND)
            ]
            if self._left <= 0:  # not all branches were driven
                return None
            if saving:
                return LastChance(back, self._names[actions[-back]], tuple(saving))
        return None

    def _states(self, scenario: DrawnScenario, actions: Ints) -> list[State]:
        """Return the state before each decision of an episode; none if it ends without a crash."""
        self._env.reset(options={"scenarios": [scenario] * len(self._all)})
        states, crashed = [], np.zeros(1, dtype=bool)
        for action in actions.tolist():
            states.append(self._engine.snapshot(0))
            *_, infos = self._engine.step(np.full(len(self._all), action))  # all sub-environments do the same
            crashed = infos["crashed"]
        return states if crashed[0] else []

    def _branches(self, state: State) -> list[State | None]:
        """Return the state after each action; None after a crash."""
        self._left -= 1
        for b in self._all.tolist():
            self._engine.restore(b, state)
        *_, infos = self._engine.step(self._all)
        return [None if infos["crashed"][b] else self._engine.snapshot(b) for b in self._all.tolist()]

    def _survives(self, state: State | None, decisions: int) -> bool:
        """Return whether some sequence of so many actions avoids a crash; False, too, once the search is given up."""
        if state is None or self._left <= 0:
            return False
        return decisions == 0 or any(self._survives(branch, decisions - 1) for branch in self._branches(state))
