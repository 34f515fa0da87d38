"""Forked replays of the rule planner: the recorded drive up to a moment, then one with other weaknesses."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from behavexplor.ads.rule import Parameters, RulePlanner
from behavexplor.data.scenario import Scenario
from behavexplor.data.trace import Trace
from behavexplor.execution.rollout import rollout, rollout_all
from behavexplor.execution.simulation import Simulation

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Fork:
    """Another way to go on with a recorded drive.

    Attributes:
        parameters: of the planner from there on.
        decision: the first one that it takes; 0 for the whole drive.
    """

    parameters: Parameters
    decision: int = 0


class ForkedPlanner:
    """Egos of one recorded drive, each of which goes its own way from some decision on; an ADS.

    Up to there every ego is given the recorded commands, while the recorded planner goes along, so that the one that
    takes over remembers what it would remember. Row i of a batch is fork i.

    Args:
        planner: that drove.
        actions: the recorded commands, shape (D, 2).
        forks: one for each ego.
    """

    def __init__(self, planner: RulePlanner, actions: Floats, forks: Sequence[Fork]) -> None:
        self._planner = planner
        self._actions = actions
        self._others = [RulePlanner(planner.roadmap, fork.parameters) for fork in forks]
        self._decision = np.array([fork.decision for fork in forks])
        self.observation: Mapping[str, Any] = planner.observation
        self.action: Mapping[str, Any] = planner.action
        self.policy_frequency = planner.policy_frequency

    def predict(
        self,
        observation: Floats,
        state: tuple[int, Floats | None] | None = None,
        episode_start: NDArray[np.bool_] | None = None,  # noqa: ARG002 - all egos begin together
        deterministic: bool = True,  # noqa: ARG002 - they always are
    ) -> tuple[Floats, tuple[int, Floats]]:
        """Decide for all egos; see `behavexplor.ads.interface.ADS`. The state counts the decisions."""
        step, memory = (0, None) if state is None else state
        together = self._decision > step
        actions = np.empty((len(observation), 2))
        after: list[Floats] = [np.empty(0)] * len(observation)
        if together.any():
            first = int(together.argmax())  # they are all at the same place, and remember the same
            _, common = self._planner.predict(observation[[first]], None if memory is None else memory[[first]])
            actions[together] = self._actions[step]
        for row, other in enumerate(self._others):
            if together[row]:
                after[row] = common[0]
                continue
            own, memories = other.predict(observation[[row]], None if memory is None else memory[[row]])
            actions[row], after[row] = own[0], memories[0]
        return actions, (step + 1, np.stack(after))


def run_forks(
    simulation: Simulation, scenario: Scenario, trace: Trace, forks: Sequence[Fork], seconds: float | None = None
) -> list[Trace]:
    """What becomes of a recorded drive on other ways.

    Args:
        simulation: with the rule planner that drove.
        scenario: that was driven.
        trace: of it.
        forks: where the ways part, and how they go on.
        seconds: after which nothing matters any more [s]; None for whole drives. A replay may still be longer.

    Returns:
        A trace for each fork.
    """
    planner = simulation.ads
    if not isinstance(planner, RulePlanner):
        raise TypeError(f"only drives of the rule planner can be forked, not of {planner!r:.80}")
    if not forks:
        return []
    limits = {} if seconds is None else {"duration": seconds}
    envs = simulation.vector_env(len(forks), **limits)
    if envs is None:
        return [rollout(simulation.env, ForkedPlanner(planner, trace.actions, [fork]), scenario) for fork in forks]
    ads = ForkedPlanner(planner, trace.actions, forks)
    ended = dict(rollout_all(envs, ads, [scenario] * len(forks)))
    envs.close()
    return [ended[row] for row in range(len(forks))]


def without(parameters: Parameters, names: Sequence[str]) -> Parameters:
    """The parameters with some of them, the severities of weaknesses, switched off."""
    return replace(parameters, **dict.fromkeys(names, 0.0))
