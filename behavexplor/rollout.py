"""One episode: an ADS drives a concrete scenario in an environment."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np

from behavexplor.scenario import Scenario
from behavexplor.trace import Trace


def rollout(env: gymnasium.Env[Any, Any], ads: Any, scenario: Scenario) -> Trace:
    """Run a scenario to its end.

    Args:
        env: takes `reset(options={"scenario": ...})` and ends an episode with `info["trace"]`.
        ads: see `behavexplor.ads.interface.ADS`; its decision log, if it keeps one, goes into the trace.
        scenario: the concrete scenario.
    """
    observation, info = env.reset(options={"scenario": scenario})
    state, start, log = None, np.ones(1, dtype=bool), []
    keeps_log = hasattr(ads, "log")
    done = False
    while not done:
        actions, state = ads.predict(np.asarray(observation)[None], state, start, deterministic=True)
        observation, _, terminated, truncated, info = env.step(actions[0])
        start = np.zeros(1, dtype=bool)
        done = terminated or truncated
        if keeps_log:
            log.append(ads.log(state))
    trace: Trace = info["trace"]
    return replace(trace, decisions=_stack(log))


def _stack(log: list[Mapping[str, Any]]) -> dict[str, Any]:
    """The entries of all decisions of one episode by name, each of shape (D, ...)."""
    if not log:
        return {}
    return {name: np.stack([np.asarray(entry[name])[0] for entry in log]) for name in log[0]}
