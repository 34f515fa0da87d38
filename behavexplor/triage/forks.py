"""Forked replays of the rule planner: as recorded up to some decision, then with other weaknesses."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from behavexplor.ads.rule import Parameters, RulePlanner
from behavexplor.data.array_types import Floats
from behavexplor.data.scenario import Scenario
from behavexplor.data.trace import Trace
from behavexplor.execution.rollout import rollout, rollout_all
from behavexplor.execution.simulation import Simulation


@dataclass(frozen=True)
class Fork:
    """An alternative continuation of a recorded execution.

    Attributes:
        parameters: parameters of the planner after the fork.
        decision: index of the first decision with these parameters; 0 for the whole execution.
    """

    parameters: Parameters
    decision: int = 0


class ForkedPlanner:
    """An ADS that drives the egos of a batch as recorded, each up to its own fork.

    Up to its fork, an ego gets the recorded commands. Meanwhile, the recorded planner runs as well, so that the planner
    that takes over has the right memory. Row i of the batch is fork i.

    Args:
        planner: the planner of the recorded execution.
        actions: the recorded commands, shape (D, 2).
        forks: one fork for each ego.
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
        deterministic: bool = True,  # noqa: ARG002 - the planner is always deterministic
    ) -> tuple[Floats, tuple[int, Floats]]:
        """Return the commands of all egos, as in `behavexplor.ads.interface.ADS`. The state counts the decisions."""
        step, memory = (0, None) if state is None else state
        together = self._decision > step
        actions = np.empty((len(observation), 2))
        after: list[Floats] = [np.empty(0)] * len(observation)
        if together.any():
            first = int(together.argmax())  # egos before their forks have the same position and the same memory
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
    """Continue a recorded execution along several forks.

    Args:
        simulation: simulation with the rule planner of the recorded execution.
        scenario: the executed scenario.
        trace: its trace.
        forks: forks to drive.
        seconds: duration of the replays [s]; None for whole executions. A replay may be longer.

    Returns:
        The trace of each fork.

    Raises:
        TypeError: if the ADS is not the rule planner.
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
    """Return parameters with the named ones, which are severities of weaknesses, set to 0."""
    return replace(parameters, **dict.fromkeys(names, 0.0))
