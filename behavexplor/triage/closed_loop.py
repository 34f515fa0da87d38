"""Witnesses in traffic that reacts: drivers that avoid a crash, and fail in no other way, in the whole scenario.

In a highway-env environment, the other vehicles react to the ego, so a maneuver cannot be tried against their recorded
motion. Other drivers drive the scenario from its start instead: a careful one, those that always do the same, and some
that act by chance.
"""

import json
import math
from dataclasses import replace
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behavexplor.ads.careful import CarefulDriver
from behavexplor.data.conventions import MANEUVERS, STANDING_SPEED
from behavexplor.data.drawn_scenario import DrawnScenario, Setup, config_text
from behavexplor.data.trace import ARRIVED, Trace
from behavexplor.envs.making import make_recorded, make_vector_env
from behavexplor.errors import InputError
from behavexplor.execution.executor import ADSError
from behavexplor.execution.rollout import rollout, rollout_all
from behavexplor.judge.specs import judge
from behavexplor.triage.findings import OtherDriver

CONSTANT: Final = ("SLOWER", "IDLE", "FASTER", "LANE_LEFT", "LANE_RIGHT")  # in the order in which they are named
BY_CHANCE: Final = 11  # drivers that act by chance
HELD: Final = 2  # decisions for which such a driver keeps an action
MOST_DECISIONS: Final = 500
STANDING_STILL: Final = "standing still"  # what a witness is called that avoids the crash by no more than that

Actions = NDArray[np.int64]


class ScriptedDriver:
    """A driver of B egos that takes actions from a table.

    Args:
        actions: actions by ego and decision, shape (B, D). After the last one, it is taken again and again.
    """

    vectorized: bool = True

    def __init__(self, actions: Actions) -> None:
        self._actions = actions

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,  # noqa: ARG002 - all episodes start together
        deterministic: bool = True,  # noqa: ARG002 - it always is
    ) -> tuple[Actions, Any]:
        """Return the next action of each ego, shape (B,); see `behavexplor.ads.interface.ADS`."""
        decision = 0 if state is None else state
        rows = self._actions[: len(observation)]
        return rows[:, min(decision, rows.shape[1] - 1)], decision + 1


class MixedDriver:
    """The careful driver in the first row of a batch, and scripted drivers in all others.

    Args:
        actions: see `ScriptedDriver`, for all rows but the first.
    """

    vectorized: bool = True

    def __init__(self, actions: Actions) -> None:
        self._careful, self._scripted = CarefulDriver(), ScriptedDriver(actions)

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,  # noqa: ARG002 - all episodes start together
        deterministic: bool = True,  # noqa: ARG002 - it always is
    ) -> tuple[Actions, Any]:
        """Return the next action of each ego, shape (B,); see `behavexplor.ads.interface.ADS`."""
        scripted, state = self._scripted.predict(observation[1:], state)
        return np.append(self._careful.predict(observation[:1])[0], scripted), state


def find_driver(scenario: DrawnScenario, rng: np.random.Generator) -> tuple[OtherDriver | None, int]:
    """Find a driver that keeps all requirements of the environment in a scenario.

    Returns:
        The first driver that keeps them, and rather one that does not stand still in the end; None if there is none;
        and the number of drivers that were tried, which is 0 if these drivers cannot drive in the environment.
    """
    constant, by_chance = [f"always {name}" for name in CONSTANT], [f"by chance {i}" for i in range(1, BY_CHANCE + 1)]
    names = ["careful", *constant, *by_chance]
    try:
        traces = _driven(scenario, _actions(rng))
    except (InputError, ADSError):  # the latter where the environment has a wrapper of its own around what they see
        return None, 0
    good = [pair for pair in zip(names, traces, strict=True) if not judge(pair[1]).failed]
    name, trace = min(good, key=lambda pair: _stands(pair[1]), default=("", None))
    if trace is None:
        return None, len(traces)
    shown = f"{STANDING_STILL} ({name})" if _stands(trace) else name
    return OtherDriver(shown, tuple(trace.actions[:, 0].astype(int).tolist())), len(traces)


def _stands(trace: Trace) -> bool:
    """Return whether the ego stands in the end, in an environment in which it need not arrive."""
    return ARRIVED not in trace.signals and math.hypot(*trace.velocity[-1, 0]) < STANDING_SPEED


def drive_again(scenario: DrawnScenario, driver: OtherDriver) -> Trace:
    """Return the trace of a driver in a scenario, from highway-env itself."""
    env = _environment(scenario.setup)
    return rollout(env, ScriptedDriver(np.array([driver.actions])), replace(scenario, setup=env.logical.setup))


def _actions(rng: np.random.Generator) -> Actions:
    """Return the actions of all drivers but the careful one, shape (drivers, decisions)."""
    constant = np.array([[MANEUVERS.index(name)] * MOST_DECISIONS for name in CONSTANT])
    drawn = rng.integers(len(MANEUVERS), size=(BY_CHANCE, MOST_DECISIONS // HELD))
    return np.concatenate([constant, np.repeat(drawn, HELD, axis=1)])


def _driven(scenario: DrawnScenario, actions: Actions) -> list[Trace]:
    """Return the trace of the careful driver, and one for each row of actions.

    Raises:
        InputError: if the environment cannot be configured so.
    """
    env, envs = _environment(scenario.setup), _lock_step(scenario.setup, 1 + len(actions))
    same = replace(scenario, setup=env.logical.setup)
    if envs is None:
        drivers = CarefulDriver(), *(ScriptedDriver(row[None]) for row in actions)
        return [rollout(env, driver, same) for driver in drivers]
    ended = dict(rollout_all(envs, MixedDriver(actions), [same] * envs.num_envs))
    return [ended[row] for row in range(envs.num_envs)]


@lru_cache(maxsize=1)  # making an environment takes longer than driving in it, and all failures of a run have the same
def _environment(setup: Setup) -> Any:
    """Return an environment in which the careful driver and meta-actions can drive.

    Raises:
        InputError: if the environment cannot be configured so.
    """
    return make_recorded(replace(setup, config=config_text(CarefulDriver().fitted(json.loads(setup.config)))))


@lru_cache(maxsize=1)
def _lock_step(setup: Setup, count: int) -> Any:
    """Return so many of these environments in lock-step; None if the compiled engine does not support them."""
    try:
        return make_vector_env(_environment(setup), count, {})
    except InputError:
        return None
