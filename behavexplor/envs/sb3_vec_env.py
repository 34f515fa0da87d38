"""Adapters from vector environments to Stable-Baselines3, for training. Importing them imports Stable-Baselines3."""

import copy
import time
from collections.abc import Callable, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.wrappers import OrderEnforcing, PassiveEnvChecker, TimeLimit
from highway_env.envs.common.abstract import AbstractEnv
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvStepReturn

from behavexplor.data.array_types import Array, Bools, Bytes
from behavexplor.data.observations import mapped
from behavexplor.data.scenario import LogicalScenario, Scenario
from behavexplor.envs.highway.highway_vector_env import vector_env
from behavexplor.envs.source_gate import replaced_in
from behavexplor.envs.vector_env import DrivingVectorEnv
from behavexplor.errors import InputError

_KNOWN_WRAPPERS = (Monitor, OrderEnforcing, PassiveEnvChecker, TimeLimit)


class LockStepVecEnv(VecEnv):
    """A vector environment that resets in the same step, as a Stable-Baselines3 `VecEnv`.

    `seed` applies to the next `reset`.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any]) -> None:
        self.env = env
        self._actions = np.zeros(0)
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)

    def reset(self) -> Array:
        """Begin an episode in every sub-environment and return the observations, shape (num_envs, ...)."""
        observations, infos = self._reset()
        self.reset_infos = _rows(infos)
        self._reset_seeds()
        self._reset_options()
        return observations

    def _reset(self) -> tuple[Array, dict[str, Any]]:
        return self.env.reset(seed=self._seeds)  # type: ignore[arg-type] # vector environments take one for each

    def step_async(self, actions: Array) -> None:
        """Store the actions, shape (num_envs, ...), for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Take the stored actions and return the observations, rewards, dones and infos."""
        observations, rewards, terminated, truncated, infos = self.env.step(self._actions)
        dones = terminated | truncated
        listed = self._infos_while_running(infos)
        for b in np.flatnonzero(dones).tolist():
            self.reset_infos[b] = _of_one(infos, b, leave_out=("final_info", "final_obs"))
            listed[b] = _of_one(infos["final_info"], b) | {
                "terminal_observation": infos["final_obs"][b],
                "TimeLimit.truncated": bool(truncated[b] and not terminated[b]),
            }
        return observations, rewards.astype(np.float32), dones, listed

    def _infos_while_running(self, infos: dict[str, Any]) -> list[dict[str, Any]]:  # noqa: ARG002 - for subclasses
        """Return the infos of all sub-environments, as if no episode had ended."""
        return [{"TimeLimit.truncated": False} for _ in range(self.num_envs)]

    def close(self) -> None:
        """Close the environment."""
        self.env.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute that all sub-environments share."""
        return [getattr(self.env, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:  # noqa: ARG002
        """Raise an InputError: a sub-environment has no attributes of its own."""
        raise InputError(f"{attr_name!r} cannot be set: make the environment with another config")

    def env_method(self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any) -> list[Any]:  # noqa: ARG002
        """Raise an InputError: a sub-environment has no methods of its own."""
        raise InputError(f"{method_name!r} cannot be called: sub-environments have no methods of their own")

    def env_is_wrapped(self, wrapper_class: Any, indices: VecEnvIndices = None) -> list[bool]:  # noqa: ARG002
        """Return False for every sub-environment."""
        return [False for _ in self._get_indices(indices)]

    def get_images(self) -> Sequence[Bytes | None]:
        """Return None for every sub-environment: the vector environment does not render."""
        return [None] * self.num_envs


class DrivingVecEnv(LockStepVecEnv):
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

    env: DrivingVectorEnv

    def __init__(self, env: VectorEnv[Any, Any, Any]) -> None:
        if not isinstance(env, DrivingVectorEnv):
            raise InputError(f"env: expected a vector environment of this package, got {type(env).__name__}")
        if env.metadata["autoreset_mode"] is not AutoresetMode.SAME_STEP:
            raise InputError(
                "Stable-Baselines3 resets in the same step: make the environment with autoreset_mode='SameStep'"
            )
        super().__init__(env)

    def _reset(self) -> tuple[Array, dict[str, Any]]:
        scenarios = [options.get("scenario") for options in self._options]
        return self.env.reset(seed=self._seeds, options={"scenarios": scenarios})

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute of each sub-environment: its own `scenario`, or a shared one such as `logical`."""
        if attr_name == "scenario":
            return [self.env.scenarios[b] for b in self._get_indices(indices)]
        return super().get_attr(attr_name, indices)


class HighwayVecEnv(LockStepVecEnv):
    """highway-env's own environments, compiled, as a Stable-Baselines3 `VecEnv`.

    It takes the place of `DummyVecEnv`, with the same arguments and the same results:

        make_vec_env("highway-fast-v0", n_envs=64, vec_env_cls=HighwayVecEnv)

    The first function is called to find out which environment, in which configuration, all of them make. A `TimeLimit`
    and a `Monitor` around it apply to every sub-environment. If the monitor writes a file, it contains the episodes of
    all of them. Further functions are called only if they might make another environment than the first; those of
    `make_vec_env` differ in their seeds alone.

    Args:
        env_fns: functions that make the same environment of highway-env, at least one.

    Raises:
        InputError: if the environment, its configuration or a wrapper around it is not supported, or if the functions
            make different environments.
    """

    def __init__(self, env_fns: Sequence[Callable[[], gymnasium.Env[Any, Any]]]) -> None:
        if not env_fns:
            raise InputError("env_fns: expected at least one function that makes an environment")
        single = env_fns[0]()
        if not isinstance(single.unwrapped, AbstractEnv):
            raise InputError(f"HighwayVecEnv runs environments of highway-env, not {single}; use DummyVecEnv")
        _check_alike(single, env_fns)
        wrappers = _wrappers(single)
        method = replaced_in(single.unwrapped)
        if method is not None:
            raise InputError(f"The compiled environments do not have the {method} of this environment; use DummyVecEnv")
        limits = [wrapper._max_episode_steps for wrapper in wrappers if isinstance(wrapper, TimeLimit)]  # noqa: SLF001
        self._monitor = next((wrapper for wrapper in wrappers if isinstance(wrapper, Monitor)), None)
        self._returns = np.zeros(len(env_fns))
        self._lengths = np.zeros(len(env_fns), dtype=np.int64)
        self._attributes = {"spec": single.spec, "config": single.unwrapped.config}
        super().__init__(
            vector_env(
                type(single.unwrapped),
                num_envs=len(env_fns),
                config=self._attributes["config"],
                autoreset_mode=AutoresetMode.SAME_STEP,
                max_episode_steps=min(limits, default=None),
            )
        )

    def reset(self) -> Array:
        """Begin an episode in every sub-environment and return the observations, shape (num_envs, ...).

        Raises:
            InputError: if `set_options` has set options, which the compiled environments do not have.
        """
        if any(self._options):
            raise InputError("The compiled environments have no reset options: make them with another config")
        self._returns[:] = self._lengths[:] = 0
        return super().reset()

    def step_wait(self) -> VecEnvStepReturn:
        """Take the stored actions and return the observations, rewards, dones and infos."""
        observations, rewards, dones, infos = super().step_wait()
        if self._monitor is not None:
            self._returns += rewards
            self._lengths += 1
            for b in np.flatnonzero(dones).tolist():
                infos[b]["episode"] = self._episode(self._monitor, b, infos[b])
            self._returns[dones] = self._lengths[dones] = 0
        return observations, rewards, dones, infos

    def _infos_while_running(self, infos: dict[str, Any]) -> list[dict[str, Any]]:
        return _rows(infos, {"TimeLimit.truncated": False})

    def _episode(self, monitor: Monitor, b: int, info: dict[str, Any]) -> dict[str, Any]:
        """Return what the monitor reports of an episode, and write it to the monitor's file."""
        elapsed = round(time.time() - monitor.t_start, 6)
        episode = {"r": round(float(self._returns[b]), 6), "l": int(self._lengths[b]), "t": elapsed}
        episode |= {key: info[key] for key in monitor.info_keywords}
        if monitor.results_writer:
            monitor.results_writer.write_row(episode)
        return episode

    def close(self) -> None:
        """Close the environment and the monitor's file."""
        super().close()
        if self._monitor is not None:
            self._monitor.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute that all sub-environments share, such as copies of their `spec` or `config`."""
        if attr_name in self._attributes:
            return [copy.deepcopy(self._attributes[attr_name]) for _ in self._get_indices(indices)]
        return super().get_attr(attr_name, indices)

    def env_is_wrapped(self, wrapper_class: Any, indices: VecEnvIndices = None) -> list[bool]:
        """Return whether each sub-environment behaves as if it had a wrapper, such as `Monitor`."""
        is_wrapped = self._monitor is not None and issubclass(Monitor, wrapper_class)
        return [is_wrapped for _ in self._get_indices(indices)]


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
        listed = self._infos_while_running(infos)
        for b in np.flatnonzero(dones).tolist():
            trace = infos["trace"][b]
            listed[b] = {
                "trace": trace,
                "end": trace.end,
                "terminal_observation": _observation_of(observations, b),
                "TimeLimit.truncated": bool(truncated[b] and not terminated[b]),
            }
        if dones.any():
            observations = self._begin(dones)
        return observations, np.asarray(rewards, dtype=np.float32), dones, listed

    def _begin(self, mask: Bools) -> Any:
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


def _check_alike(single: gymnasium.Env[Any, Any], env_fns: Sequence[Callable[[], gymnasium.Env[Any, Any]]]) -> None:
    """Refuse functions that make another environment than the first one, which has made `single`."""
    if all(getattr(make, "__module__", None) == make_vec_env.__module__ for make in env_fns):
        return  # those of one `make_vec_env` differ in their seeds alone
    made: Any = single.unwrapped
    for i, make in enumerate(env_fns[1:], 1):
        if _program(make) == _program(env_fns[0]):
            continue
        other: Any = make()
        differs = type(other.unwrapped) is not type(made) or _config_text(other) != _config_text(single)
        other.close()
        if differs:
            raise InputError(
                f"env_fns[{i}] makes another environment than env_fns[0], or configures it otherwise; use DummyVecEnv"
            )


def _config_text(env: Any) -> str:
    """Return the configuration of an environment as a text, since its values may be arrays."""
    return repr(sorted(env.unwrapped.config.items()))


def _program(make: Any) -> tuple[Any, ...]:
    """Return the code of a function and the identities of the variables and defaults that it uses."""
    cells = getattr(make, "__closure__", None) or ()
    defaults = (*(getattr(make, "__defaults__", None) or ()), *(getattr(make, "__kwdefaults__", None) or {}).values())
    # Functions of the same code on the same objects do the same. With other objects, environments are compared.
    return getattr(make, "__code__", make), tuple(map(id, (*cells, *defaults, getattr(make, "__self__", None))))


def _wrappers(env: gymnasium.Env[Any, Any]) -> list[gymnasium.Wrapper[Any, Any, Any, Any]]:
    """Return the wrappers around an environment, the outermost first."""
    found = []
    while isinstance(env, gymnasium.Wrapper):
        if type(env) not in _KNOWN_WRAPPERS:
            raise InputError(
                f"The compiled environments have no counterpart of the wrapper {type(env).__name__}; use DummyVecEnv, "
                f"or a VecEnvWrapper around them"
            )
        found.append(env)
        env = env.env
    return found


def _rows(infos: dict[str, Any], more: dict[str, Any] | None = None) -> list[dict[str, Any]]:
    """Return the info of each sub-environment, with `more`, from infos in gymnasium's vector format.

    Entries that some sub-environments do not have are left out.
    """
    columns = {
        key: _rows(values) if isinstance(values, dict) else _items(values)
        for key, values in infos.items()
        if not key.startswith("_") and infos[f"_{key}"].all()
    }
    return [dict(zip(columns, row, strict=True)) | (more or {}) for row in zip(*columns.values(), strict=True)]


def _items(values: Array) -> list[Any]:
    return list(values) if values.ndim > 1 else values.tolist()


def _of_one(infos: dict[str, Any], b: int, leave_out: tuple[str, ...] = ()) -> dict[str, Any]:
    """Return the info of one sub-environment from infos in gymnasium's vector format, without the keys `leave_out`."""
    return {
        key: _of_one(values, b) if isinstance(values, dict) else values[b]
        for key, values in infos.items()
        if not key.startswith("_") and key not in leave_out and infos[f"_{key}"][b]
    }


def _observation_of(observations: Any, b: int) -> Any:
    """Return a copy of the observation of one sub-environment."""
    return mapped(lambda array: array[b].copy(), observations)
