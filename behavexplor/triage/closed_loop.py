"""Witnesses in traffic that reacts: drivers that avoid a crash when they drive the whole scenario.

In a highway-env environment, the other vehicles react to the ego, so a maneuver cannot be tried against their recorded
motion. Other drivers drive the scenario from its start instead: a careful one, those that always do the same, and some
that act by chance.
"""

import json
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behavexplor.ads.careful import CarefulDriver
from behavexplor.data.conventions import MANEUVERS
from behavexplor.data.drawn_scenario import DrawnScenario, config_text
from behavexplor.data.trace import CRASHED, Trace
from behavexplor.envs.making import make_recorded, make_vector_env
from behavexplor.errors import InputError
from behavexplor.execution.executor import ADSError
from behavexplor.execution.rollout import rollout, rollout_all
from behavexplor.triage.findings import OtherDriver

CONSTANT: Final = ("SLOWER", "IDLE", "FASTER", "LANE_LEFT", "LANE_RIGHT")  # in the order in which they are named
BY_CHANCE: Final = 11  # drivers that act by chance
HELD: Final = 2  # decisions for which such a driver keeps an action
MOST_DECISIONS: Final = 500

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


def find_driver(scenario: DrawnScenario, rng: np.random.Generator) -> tuple[OtherDriver | None, int]:
    """Find a driver that does not crash in a scenario.

    Returns:
        The first driver that does not crash, None if all of them do; and the number of drivers that were tried, which
        is 0 if these drivers cannot drive in the environment.
    """
    constant, by_chance = [f"always {name}" for name in CONSTANT], [f"by chance {i}" for i in range(1, BY_CHANCE + 1)]
    names = ["careful", *constant, *by_chance]
    try:
        traces = _driven(scenario, _actions(rng))
    except (InputError, ADSError):  # the latter where the environment has a wrapper of its own around what they see
        return None, 0
    avoiding = (pair for pair in zip(names, traces, strict=True) if not pair[1].signals[CRASHED].any())
    name, trace = next(avoiding, ("", None))
    return None if trace is None else OtherDriver(name, tuple(trace.actions[:, 0].astype(int).tolist())), len(traces)


def drive_again(scenario: DrawnScenario, driver: OtherDriver) -> Trace:
    """Return the trace of a driver in a scenario, from highway-env itself."""
    env, same = _with_meta_actions(scenario)
    return rollout(env, ScriptedDriver(np.array([driver.actions])), same)


def _actions(rng: np.random.Generator) -> Actions:
    """Return the actions of all drivers but the careful one, shape (drivers, decisions)."""
    constant = np.array([[MANEUVERS.index(name)] * MOST_DECISIONS for name in CONSTANT])
    drawn = rng.integers(len(MANEUVERS), size=(BY_CHANCE, MOST_DECISIONS // HELD))
    return np.concatenate([constant, np.repeat(drawn, HELD, axis=1)])


def _with_meta_actions(scenario: DrawnScenario) -> tuple[Any, DrawnScenario]:
    """Return a scenario's environment, in which the careful driver and meta-actions can drive, and the scenario there.

    Raises:
        InputError: if the environment cannot be configured so.
    """
    config = CarefulDriver().fitted(json.loads(scenario.setup.config))
    env: Any = make_recorded(replace(scenario.setup, config=config_text(config)))
    return env, replace(scenario, setup=env.logical.setup)


def _driven(scenario: DrawnScenario, actions: Actions) -> list[Trace]:
    """Return the trace of the careful driver, and one for each row of actions.

    Raises:
        InputError: if the environment cannot be configured so.
    """
    careful = CarefulDriver()
    env, same = _with_meta_actions(scenario)
    try:
        return [*_compiled(env, careful, same, 1), *_compiled(env, ScriptedDriver(actions), same, len(actions))]
    except InputError:
        return [rollout(env, driver, same) for driver in (careful, *(ScriptedDriver(row[None]) for row in actions))]


def _compiled(env: Any, driver: Any, scenario: DrawnScenario, count: int) -> list[Trace]:
    """Return the traces of so many egos with a driver, each alone in the scenario.

    Raises:
        InputError: if the compiled engine does not support the environment.
    """
    envs: Any = make_vector_env(env, count, {})
    ended = dict(rollout_all(envs, driver, [scenario] * count))
    return [ended[row] for row in range(count)]
