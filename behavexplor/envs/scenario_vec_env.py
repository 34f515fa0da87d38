"""Training in chosen scenarios, as a Stable-Baselines3 `VecEnv`. This module imports Stable-Baselines3."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvStepReturn

from behavexplor.data.logical import LogicalScenario
from behavexplor.data.observations import mapped
from behavexplor.data.scenario import Scenario
from behavexplor.envs.sb3_vec_env import LockStepVecEnv


class ScenarioVecEnv(LockStepVecEnv):
    """A vector environment whose episodes run in the scenarios that a sampler draws.

    For a sub-environment whose episode has just ended, `infos` contains its `trace`, the `end` of the trace, and the
    `terminal_observation`. `seed` seeds the one sampler of all sub-environments, at once.

    Args:
        env: vector environment with autoreset disabled and an attribute `logical`. The environment takes
            `reset(options={"scenarios": ..., "reset_mask": ...})`, and has `infos["trace"]` at the end of an episode.

    Attributes:
        logical: the logical scenario of the environment.
        sampler: function that draws the scenario of a new episode; at first that of the logical scenario.
        scenarios: the scenario of each sub-environment.
    """

    def __init__(self, env: Any) -> None:
        super().__init__(env)
        self.logical: LogicalScenario = env.logical
        self.sampler: Callable[[np.random.Generator], Scenario] = self.logical.sample
        self.scenarios: list[Any] = [None] * env.num_envs
        self._rng = np.random.default_rng(0)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed the sampler."""
        self._rng = np.random.default_rng(seed)
        return [seed] * self.num_envs

    def reset(self) -> Any:
        """Begin an episode in every sub-environment and return the observations, arrays of shape (num_envs, ...)."""
        return self._begin(np.ones(self.num_envs, dtype=bool))

    def step_wait(self) -> VecEnvStepReturn:
        """Take the stored actions and return the observations, rewards, dones and infos."""
        observations, rewards, terminated, truncated, infos = self.env.step(self._actions)
        dones = terminated | truncated
        listed = self._listed(infos)
        for b in np.flatnonzero(dones).tolist():
            trace = infos["trace"][b]
            listed[b] = {
                "trace": trace,
                "end": trace.end,
                "terminal_observation": _of_one(observations, b),
                "TimeLimit.truncated": bool(truncated[b] and not terminated[b]),
            }
        if dones.any():
            observations = self._begin(dones)
        return observations, np.asarray(rewards, dtype=np.float32), dones, listed

    def _begin(self, mask: NDArray[np.bool_]) -> Any:
        """Begin episodes where the mask is True, and return the observations of all sub-environments."""
        new = [self.sampler(self._rng) if chosen else None for chosen in mask.tolist()]
        self.scenarios = [other if one is None else one for one, other in zip(new, self.scenarios, strict=True)]
        observations, _ = self.env.reset(options={"scenarios": new, "reset_mask": mask})
        return observations

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute of each sub-environment: its own `scenario`, or a shared one such as `logical`."""
        if attr_name == "scenario":
            return [self.scenarios[b] for b in self._get_indices(indices)]
        return super().get_attr(attr_name, indices)


def _of_one(observations: Any, b: int) -> Any:
    """Return a copy of the observation of one sub-environment."""
    return mapped(lambda array: array[b].copy(), observations)
