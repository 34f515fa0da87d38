"""Witnesses in traffic that reacts: drivers that avoid a crash, and fail in no other way, in the whole scenario.

In a highway-env environment, the other vehicles react to the ego, so a maneuver cannot be tried against their recorded
motion. Other drivers drive the scenario from its start instead: a careful one, those that always do the same, and some
of random actions.
"""

import json
import math
from dataclasses import replace
from functools import lru_cache
from typing import Any, Final, Literal

import numpy as np

from behavexplor.ads.careful import CarefulDriver
from behavexplor.data.array_types import Ints
from behavexplor.data.conventions import MANEUVERS, STANDING_SPEED
from behavexplor.data.drawn_scenario import DrawnScenario, Setup, config_text
from behavexplor.data.trace import ARRIVED, CRASHED, Trace
from behavexplor.envs.making import make_recorded, make_vector_env
from behavexplor.errors import InputError
from behavexplor.execution.executor import ADSError
from behavexplor.execution.rollout import rollout, rollout_all
from behavexplor.judge.specs import judge
from behavexplor.triage.findings import OtherDriver

CONSTANT: Final = ("SLOWER", "IDLE", "FASTER", "LANE_LEFT", "LANE_RIGHT")  # in the order in which they are named
RANDOM: Final = 11  # drivers of random actions
HELD: Final = 2  # decisions for which such a driver keeps an action
MOST_DECISIONS: Final = 500
STANDING_STILL: Final = "standing still"  # what a witness is called that avoids the crash by no more than that

Actions = Ints
Found = Literal["preventable", "standing_still_avoids_it", "unpreventable"] | None


class ScriptedDriver:
    """A driver of B egos that takes actions from a table.

    The table has the shape (B, D). After the last action, it is taken again and again.
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


def find_driver(scenario: DrawnScenario, rng: np.random.Generator) -> tuple[OtherDriver | None, int, Found]:
    """Find a driver that keeps all requirements of the environment in a scenario.

    Return the first one, rather one that does not stand still in the end, or None; the number of drivers that were
    tried, 0 if they cannot drive there; and what that says of the crash, None if others only failed in another way.
    """
    constant, random = [f"always {name}" for name in CONSTANT], [f"random actions {i}" for i in range(1, RANDOM + 1)]
    names = ["careful", *constant, *random]
    try:
        traces = _driven(scenario, _actions(rng))
    except (InputError, ADSError):  # the latter where the environment has a wrapper of its own around what they see
        return None, 0, None
    good = [pair for pair in zip(names, traces, strict=True) if not judge(pair[1]).failed]
    if good:
        name, trace = min(good, key=lambda pair: _only_stands(pair[1]))
        shown = f"{STANDING_STILL} ({name})" if _only_stands(trace) else name
        return OtherDriver(shown, tuple(trace.actions[:, 0].astype(int).tolist())), len(traces), "preventable"
    safe = [trace for trace in traces if not trace.signals[CRASHED].any()]
    if any(map(_stands, safe)):
        return None, len(traces), "standing_still_avoids_it"
    return None, len(traces), None if safe else "unpreventable"


def _stands(trace: Trace) -> bool:
    """Return whether the ego stands in the end."""
    return math.hypot(*trace.velocity[-1, 0]) < STANDING_SPEED


def _only_stands(trace: Trace) -> bool:
    """Return whether the ego stands in the end, in an environment in which it need not arrive."""
    return ARRIVED not in trace.signals and _stands(trace)


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
    same = replace(scenario, setup=env.logical.setup)
    try:
        return [
            *_compiled(careful, scenario, same, 1),
            *_compiled(ScriptedDriver(actions), scenario, same, len(actions)),
        ]
    except InputError:
        return [rollout(env, driver, same) for driver in (careful, *(ScriptedDriver(row[None]) for row in actions))]


def _compiled(driver: Any, scenario: DrawnScenario, same: DrawnScenario, count: int) -> list[Trace]:
    """Return the traces of so many egos with a driver, each alone in the scenario."""
    ended = dict(rollout_all(_lock_step(scenario.setup, count), driver, [same] * count))
    return [ended[row] for row in range(count)]


@lru_cache(maxsize=1)  # making an environment takes longer than driving in it, and all failures of a run have the same
def _environment(setup: Setup) -> Any:
    """Return an environment in which the careful driver and meta-actions can drive."""
    return make_recorded(replace(setup, config=config_text(CarefulDriver().fitted(json.loads(setup.config)))))


@lru_cache(maxsize=2)
def _lock_step(setup: Setup, count: int) -> Any:
    return make_vector_env(_environment(setup), count, {})
