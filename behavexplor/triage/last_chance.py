"""The last chance to avoid a crash: the sequences of a policy's own actions are driven from each of its last decisions.

In the compiled form of highway-env's environments, an episode can go on from a copy of its state. So all sequences can
be driven, and nothing is estimated: if none of them survives, the crash was inevitable at that decision.
"""

from functools import lru_cache
from typing import Any, Final

import numpy as np

from behavexplor.data.array_types import Array, Ints
from behavexplor.data.drawn_scenario import DrawnScenario
from behavexplor.data.trace import Trace
from behavexplor.envs.highway.drawn_vector_env import DrawnVectorEnv
from behavexplor.execution.simulation import Simulation
from behavexplor.triage.findings import LastChance

BEYOND: Final = 3  # decisions after the crash without another one, which count as survival
MOST_BACK: Final = 4  # decisions before the crash
MOST_BRANCHINGS: Final = 300  # states from which all actions are driven

State = tuple[Array, ...]


def last_chance(simulation: Simulation, scenario: Any, trace: Trace) -> LastChance | None:
    """Find the last chance to avoid the crash at the end of an execution.

    Args:
        simulation: simulation with the environment of the execution; its ADS is not used.
        scenario: the executed scenario.
        trace: its trace.

    Returns:
        The last chance; None if there is none among the last `MOST_BACK` decisions or it takes too long to find it, if
        the execution ends otherwise, or if the environment has no compiled form or no meta-actions.
    """
    if trace.end != "collision" or not scenario.meta_actions:
        return None
    branching = _branching(simulation)
    return None if branching is None else branching.last_chance(scenario, trace.actions[:, 0].astype(np.int64))


@lru_cache(maxsize=1)  # making an environment takes longer than a search, and all failures of a run have the same
def _branching(simulation: Simulation) -> "Branching | None":
    names = getattr(simulation.env, "meta_actions", ())
    env: Any = simulation.vector_env(len(names)) if names else None
    return None if env is None else Branching(env, names)


class Branching:
    """Drives all actions from a state at the same time, each in its own sub-environment.

    Args:
        env: environment with a sub-environment for each action.
        names: names of the actions.
    """

    def __init__(self, env: DrawnVectorEnv, names: tuple[str, ...]) -> None:
        self._env, self._engine, self._names = env, env.engine, names
        self._all = np.arange(len(names))
        self._left = 0  # branchings before the search is given up

    def last_chance(self, scenario: DrawnScenario, actions: Ints) -> LastChance | None:
        """Find the last chance in an episode that ended with a crash; see `last_chance`.

        Args:
            scenario: the executed scenario.
            actions: the actions that were taken, shape (D,).
        """
        states = self._states(scenario, actions)
        self._left = MOST_BRANCHINGS
        for back in range(1, min(len(states), MOST_BACK) + 1):
            after = self._branches(states[-back])
            saving = [
                name for name, state in zip(self._names, after, strict=True) if self._survives(state, back - 1 + BEYOND)
            ]
            if self._left <= 0:
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
            crashed = self._engine.step(np.full(len(self._all), action))[-1]["crashed"]
        return states if crashed[0] else []

    def _branches(self, state: State) -> list[State | None]:
        """Return the state after each action; None after a crash."""
        self._left -= 1
        for b in self._all.tolist():
            self._engine.restore(b, state)
        crashed = self._engine.step(self._all)[-1]["crashed"]
        return [None if crashed[b] else self._engine.snapshot(b) for b in self._all.tolist()]

    def _survives(self, state: State | None, decisions: int) -> bool:
        """Return whether some sequence of so many actions avoids a crash."""
        if state is None or self._left <= 0:
            return False
        return decisions == 0 or any(self._survives(branch, decisions - 1) for branch in self._branches(state))
