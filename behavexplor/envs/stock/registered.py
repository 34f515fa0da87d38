"""The vector environments that are registered with gymnasium, each by its name there with underscores."""

import warnings
from functools import partial
from typing import Any

from gymnasium.envs.registration import load_env_creator
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv
from gymnasium.wrappers import TimeLimit
from highway_env.envs.common.abstract import AbstractEnv

from behavexplor import HIGHWAY_ENV
from behavexplor.envs.source_gate import ChangedError
from behavexplor.envs.stock.stock_env import StockVectorEnv


def vector_env(env_class: type[AbstractEnv], **arguments: Any) -> VectorEnv[Any, Any, Any]:
    """Make the compiled vector environment of a class of highway-env.

    If the classes that run are not those that the compiled engine was ported from, because this program has replaced a
    method or highway-env is another release, highway-env itself runs, and a warning says so.

    Args:
        env_class: the environment.
        arguments: see `StockVectorEnv`.

    Raises:
        InputError: if the compiled engine does not support the environment or its configuration.
    """
    try:
        return StockVectorEnv(env_class, **arguments)
    except ChangedError as error:
        warnings.warn(
            f"highway-env itself runs, hundreds of times as slow, because the {error.reason}: this program "
            f"has replaced it, or highway-env is another release",
            stacklevel=2,
        )
    return _original(env_class, **arguments)


def _original(
    env_class: type[AbstractEnv],
    num_envs: int = 1,
    config: Any = None,
    autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    render_mode: str | None = None,
    max_episode_steps: int | None = None,
) -> VectorEnv[Any, Any, Any]:
    """Make a vector environment of highway-env's own environments, with the arguments of `StockVectorEnv`."""

    def single() -> Any:
        env = env_class(config, render_mode)
        return env if max_episode_steps is None else TimeLimit(env, max_episode_steps)

    return SyncVectorEnv([single] * num_envs, autoreset_mode=autoreset_mode)


def __getattr__(name: str) -> partial[VectorEnv[Any, Any, Any]]:
    """Return the function that makes a vector environment, such as `highway_fast_v0`."""
    entry_points = {registered.replace("-", "_"): entry_point for registered, entry_point in HIGHWAY_ENV.items()}
    if name not in entry_points:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    env_class: Any = load_env_creator(entry_points[name])
    return partial(vector_env, env_class)
