"""Witnesses in traffic that reacts: drivers that avoid a crash when they drive the whole scenario.

In a stock environment, the other vehicles react to the ego, so a maneuver cannot be tried against their recorded
motion. Other drivers drive the scenario from its start instead: those that always do the same, and some that act by
chance.
"""

import json
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behavexplor.ads.constant import MANEUVERS, with_meta_actions
from behavexplor.data.drawn_logical import DrawnLogicalScenario
from behavexplor.data.drawn_scenario import DrawnScenario
from behavexplor.data.trace import CRASHED, Trace
from behavexplor.envs.making import make_env, make_vector_env
from behavexplor.errors import InputError
from behavexplor.execution.rollout import rollout, rollout_all

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


def find_driver(
    logical: DrawnLogicalScenario, scenario: DrawnScenario, rng: np.random.Generator
) -> tuple[str | None, int]:
    """Find a driver that does not crash in a scenario.

    Args:
        logical: the scenarios of the environment.
        scenario: the scenario.
        rng: generator for the drivers that act by chance.

    Returns:
        Name of the first driver that does not crash, None if all of them do; and the number of drivers that were tried,
        which is 0 if the environment cannot be driven by meta-actions.
    """
    config = with_meta_actions(json.loads(logical.setup.config))
    names = [f"always {name}" for name in CONSTANT] + [f"by chance {i}" for i in range(1, BY_CHANCE + 1)]
    try:
        traces = _driven(logical, config, scenario, _actions(rng))
    except InputError:
        return None, 0
    avoiding = (name for name, trace in zip(names, traces, strict=True) if not trace.signals[CRASHED].any())
    return next(avoiding, None), len(traces)


def _actions(rng: np.random.Generator) -> Actions:
    """Return the actions of all drivers, shape (drivers, decisions)."""
    constant = np.array([[MANEUVERS.index(name)] * MOST_DECISIONS for name in CONSTANT])
    drawn = rng.integers(len(MANEUVERS), size=(BY_CHANCE, MOST_DECISIONS // HELD))
    return np.concatenate([constant, np.repeat(drawn, HELD, axis=1)])


def _driven(
    logical: DrawnLogicalScenario, config: dict[str, Any], scenario: DrawnScenario, actions: Actions
) -> list[Trace]:
    """Return the trace of each driver.

    Raises:
        InputError: if the environment cannot be configured so.
    """
    env: Any = make_env(logical.name, config, logical.setup.traffic)
    same = replace(scenario, setup=env.logical.setup)
    try:
        envs = make_vector_env(env, len(actions), {})
    except InputError:
        return [rollout(env, ScriptedDriver(row[None]), same) for row in actions]
    if envs is None:
        return []
    ended = dict(rollout_all(envs, ScriptedDriver(actions), [same] * len(actions)))
    return [ended[row] for row in range(len(actions))]
