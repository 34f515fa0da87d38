"""One episode: an ADS drives a concrete scenario in an environment."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from behavexplor.scenario import Scenario
from behavexplor.trace import Trace


def rollout(env: gymnasium.Env[Any, Any], ads: Any, scenario: Scenario) -> Trace:
    """Run a scenario to its end.

    Args:
        env: takes `reset(options={"scenario": ...})` and ends an episode with `info["trace"]`.
        ads: see `behavexplor.ads.interface.ADS`; its decision log, if it keeps one, goes into the trace.
        scenario: the concrete scenario.

    Raises:
        ValueError: if what the ADS answers is no action of the environment.
    """
    observation, info = env.reset(options={"scenario": scenario})
    state, start, log = None, np.ones(1, dtype=bool), []
    keeps_log = hasattr(ads, "log")
    done = False
    while not done:
        answer = ads.predict(np.asarray(observation)[None], state, start, deterministic=True)
        action, state = _checked(answer, env.action_space)
        observation, _, terminated, truncated, info = env.step(action)
        start = np.zeros(1, dtype=bool)
        done = terminated or truncated
        if keeps_log:
            log.append(ads.log(state))
    trace: Trace = info["trace"]
    return replace(trace, decisions=_stack(log))


def _checked(answer: Any, space: gymnasium.Space[Any]) -> tuple[NDArray[Any], Any]:
    """The one action and the state that an ADS has answered with.

    Raises:
        ValueError: saying what `predict` must return, if it returned something else.
    """
    if not isinstance(answer, tuple) or len(answer) != 2:
        raise ValueError(f"predict must return a pair (actions, state), got {answer!r:.80}")
    actions = np.asarray(answer[0])
    expected = (1, *(space.shape or ()))
    if actions.shape != expected:
        raise ValueError(f"predict must return actions of shape {expected}, got {actions.shape}")
    if actions.dtype.kind not in "iuf" or not np.isfinite(actions).all():
        raise ValueError(f"predict must return finite numbers as actions, got {actions!r:.80}")
    if isinstance(space, gymnasium.spaces.Discrete) and not space.contains(actions[0]):
        raise ValueError(f"predict must return actions of {space}, got {actions[0]}")
    return actions[0], answer[1]


def _stack(log: list[Mapping[str, Any]]) -> dict[str, Any]:
    """The entries of all decisions of one episode by name, each of shape (D, ...)."""
    if not log:
        return {}
    return {name: np.stack([np.asarray(entry[name])[0] for entry in log]) for name in log[0]}
