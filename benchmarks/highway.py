"""highway-env's own environments, compiled, in comparison with highway-env in the same run, resets included.

EnvPool is measured beside them if it is installed (`pip install envpool`); nothing else uses it.
"""

import logging
import time
import warnings
from collections.abc import Callable
from functools import cache
from typing import Any

import gymnasium
import numpy as np
from gymnasium.envs.registration import load_env_creator

from behavexplor import HIGHWAY_ENV, NAMESPACE

BATCHES = (1, 16, 256)
REPETITIONS = 3  # highway-env and the others take turns, because the machine may be busy
ENVPOOL = {
    "highway-v0": "Highway-v0",
    "highway-fast-v0": "HighwayFast-v0",
    "merge-v0": "Merge-v0",
    "roundabout-v0": "Roundabout-v0",
    "intersection-v0": "Intersection-v0",
    "exit-v0": "Exit-v0",
    "two-way-v0": "TwoWay-v0",
    "u-turn-v0": "UTurn-v0",
}
# highway-env's intersection changes a class for the whole process, so these come last.
IDS = sorted((name for name in HIGHWAY_ENV if name != "intersection-v1"), key=lambda name: "intersection" in name)

Drive = Callable[[], int]  # drives for a while, and returns the number of decisions


def highway_rows(seconds: float) -> list[dict[str, Any]]:
    """Return a row for each environment.

    Args:
        seconds: CPU time to measure each for, in each repetition [s].
    """
    logging.disable(logging.WARNING)  # highway-env's, about routes
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return [_row(name, seconds) for name in IDS]


def _row(name: str, seconds: float) -> dict[str, Any]:
    drives = {"highway-env": _original(name)}
    drives |= {f"batch {count}": _compiled(name, count) for count in BATCHES}
    if _has_envpool() and name in ENVPOOL:
        drives |= {f"EnvPool {count}": _envpool(name, count) for count in BATCHES}
    for drive in drives.values():
        drive()  # compiles what is not cached
    spent, decisions = dict.fromkeys(drives, 0.0), dict.fromkeys(drives, 0)
    for _ in range(REPETITIONS):
        for what, drive in drives.items():
            start = time.process_time()
            while time.process_time() < start + seconds:
                decisions[what] += drive()
            spent[what] += time.process_time() - start
    costs = {what: 1e6 * spent[what] / decisions[what] for what in drives}
    row = {"environment": name, "highway-env ms": costs.pop("highway-env") / 1e3}
    row |= {f"{what} us": cost for what, cost in costs.items()}
    return row | {f"x {what}": 1e3 * row["highway-env ms"] / costs[what] for what in costs}


def _original(name: str) -> Drive:
    env = load_env_creator(HIGHWAY_ENV[name])(None)
    env.reset(seed=0)
    limit = gymnasium.spec(f"{NAMESPACE}/{name}").max_episode_steps or np.inf
    steps = 0

    def drive() -> int:
        nonlocal steps
        *_, terminated, truncated, _ = env.step(env.action_space.sample())
        steps += 1
        if terminated or truncated or steps >= limit:
            env.reset()
            steps = 0
        return 1

    return drive


def _compiled(name: str, count: int) -> Drive:
    env = gymnasium.make_vec(
        f"{NAMESPACE}/{name}", num_envs=count, vectorization_mode="vector_entry_point", autoreset_mode="SameStep"
    )
    env.reset(seed=0)
    return _steps(env, count, env.single_action_space.n)


@cache
def _has_envpool() -> bool:
    try:
        import envpool  # noqa: F401, PLC0415 - not a dependency
    except (ImportError, OSError):  # OSError: some of its wheels lack files of other environments
        return False
    return True


def _envpool(name: str, count: int) -> Drive:
    import envpool  # noqa: PLC0415 - not a dependency

    env = envpool.make_gymnasium(ENVPOOL[name], num_envs=count, num_threads=1, seed=0)
    env.reset()
    return _steps(env, count, env.action_space.n)


def _steps(env: Any, count: int, n_actions: int) -> Drive:
    """Return a function that takes random actions. They are drawn before, because drawing takes time."""
    steps = max(256 // count, 4)
    actions = np.random.default_rng(0).integers(n_actions, size=(steps, count))

    def drive() -> int:
        for taken in actions:
            env.step(taken)
        return steps * count

    return drive
