"""Adapter from the vector environment to Stable-Baselines3, for training. Importing it imports Stable-Baselines3."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvStepReturn

from behavexplor.envs.vector import DrivingVectorEnv
from behavexplor.errors import InputError


class DrivingVecEnv(VecEnv):
    """A `DrivingVectorEnv` as a Stable-Baselines3 `VecEnv`.

    For a sub-environment whose episode has just ended, `infos` contains the `info` of the single environment, which
    includes `end` and `trace`, and the `terminal_observation`. For all other sub-environments, it contains only
    `TimeLimit.truncated`, which is False. `seed` and `set_options` apply to the next `reset`; options have the form
    `{"scenario": scenario}`.

    Args:
        env: an environment made by
            `gymnasium.make_vec(..., vectorization_mode="vector_entry_point", autoreset_mode="SameStep")`.

    Raises:
        InputError: if `env` is not such an environment.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any]) -> None:
        if not isinstance(env, DrivingVectorEnv):
            raise InputError(f"env: expected a vector environment of this package, got {type(env).__name__}")
        if env.metadata["autoreset_mode"] is not AutoresetMode.SAME_STEP:
            raise InputError(
                "Stable-Baselines3 resets in the same step: make the environment with autoreset_mode='SameStep'"
            )
        self.env = env
        self._actions = np.zeros(0)
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)

    def reset(self) -> NDArray[Any]:
        """Begin an episode in every sub-environment and return the observations, shape (num_envs, ...)."""
        scenarios = [options.get("scenario") for options in self._options]
        observations, infos = self.env.reset(seed=self._seeds, options={"scenarios": scenarios})
        self.reset_infos = [{"scenario": scenario} for scenario in infos["scenario"]]
        self._reset_seeds()
        self._reset_options()
        return observations

    def step_async(self, actions: NDArray[Any]) -> None:
        """Store the actions, shape (num_envs, ...), for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Take the stored actions and return the observations, rewards, dones and infos."""
        observations, rewards, terminated, truncated, infos = self.env.step(self._actions)
        dones = terminated | truncated
        listed: list[dict[str, Any]] = [{"TimeLimit.truncated": False} for _ in range(self.num_envs)]
        for b in np.flatnonzero(dones).tolist():
            self.reset_infos[b] = {"scenario": infos["scenario"][b]}
            listed[b] = _of_one(infos["final_info"], b) | {
                "terminal_observation": infos["final_obs"][b],
                "TimeLimit.truncated": bool(truncated[b]),
            }
        return observations, rewards.astype(np.float32), dones, listed

    def close(self) -> None:
        """Close the environment."""
        self.env.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute of each sub-environment: its own `scenario`, or a shared one such as `logical`."""
        chosen = self._get_indices(indices)
        if attr_name == "scenario":
            return [self.env.scenarios[b] for b in chosen]
        return [getattr(self.env, attr_name) for _ in chosen]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:  # noqa: ARG002
        """Raise an InputError: a sub-environment has no attributes of its own."""
        raise InputError(f"{attr_name!r} cannot be set: make the environment with another config")

    def env_method(self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any) -> list[Any]:  # noqa: ARG002
        """Raise an InputError: a sub-environment has no methods of its own."""
        raise InputError(f"{method_name!r} cannot be called: sub-environments have no methods of their own")

    def env_is_wrapped(self, wrapper_class: Any, indices: VecEnvIndices = None) -> list[bool]:  # noqa: ARG002
        """Return False for every sub-environment."""
        return [False for _ in self._get_indices(indices)]

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """Return None for every sub-environment: the vector environment does not render."""
        return [None] * self.num_envs


def _of_one(infos: dict[str, Any], b: int) -> dict[str, Any]:
    """Return the info of one sub-environment from infos in gymnasium's vector format."""
    return {
        key: _of_one(values, b) if isinstance(values, dict) else values[b]
        for key, values in infos.items()
        if not key.startswith("_") and infos[f"_{key}"][b]
    }
