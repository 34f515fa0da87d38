"""Waiting times of a user: for help, for the first execution with and without cached kernels, and for a campaign."""

import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import gymnasium
import highway_env  # noqa: F401 - registers highway-fast-v0
from stable_baselines3 import PPO

from behavexplor.envs.making import environment_id
from behavexplor.envs.sb3_vec_env import DrivingVecEnv, HighwayVecEnv
from benchmarks.execution import Pace

FIRST = "intersection-straight"
STOCK = "highway-fast-v0"
STEPS = {STOCK: 20_480, FIRST: 40_960}  # of training
RUNS = 5

Row = dict[str, Any]


def startup_rows(budget: int) -> list[Row]:
    """Return the wall times of shell commands [s]; those of whole campaigns are medians of five runs.

    Machines differ in speed. So each row also says how many executions plain highway-env does in that time, by its CPU
    time for one execution just before and just after each run.

    Args:
        budget: number of executions of each campaign.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        cold = {"NUMBA_CACHE_DIR": str(folder / "machine-code")}
        fuzz = ("fuzz", "--quiet", "--env", FIRST)
        policies = {env: ("--ads", trained_policy(folder, env)) for env in STEPS}
        whole, stock = (*fuzz, "--budget", str(budget)), ("fuzz", "--quiet", "--env", STOCK, "--budget", str(budget))
        campaigns = {
            "BehAVExplor and a constant action": (*whole, "--ads", "constant"),
            "BehAVExplor and a policy": (*whole, "--ads", f"learned:{FIRST}"),
            f"BehAVExplor and PPO in {FIRST}": (*whole, *policies[FIRST]),
            "BehAVExplor and rule": whole,
            f"BehAVExplor and PPO in {STOCK}": (*stock, *policies[STOCK]),
            f"uniform and PPO in {STOCK}": (*stock, *policies[STOCK], "--method", "uniform"),
        }
        pace = Pace(FIRST)
        runs = {
            "fuzz --help": [_wall(pace, ("fuzz", "--help"))],
            "first execution, machine code cached": [_wall(pace, (*fuzz, "--budget", "1", "--out", f"{folder}/1"))],
            "first execution, nothing cached": [_wall(pace, (*fuzz, "--budget", "1", "--out", f"{folder}/2"), cold)],
        }
        for title, command in campaigns.items():
            runs[f"{budget} executions, {title}"] = [
                _wall(pace, (*command, "--out", f"{folder}/{title}-{number}")) for number in range(RUNS)
            ]
    return [
        {
            "command": command,
            "seconds": statistics.median(seconds for seconds, _ in times),
            "executions of highway-env": statistics.median(executions for _, executions in times),
        }
        for command, times in runs.items()
    ]


def trained_policy(folder: Path, env: str) -> str:
    """Train a PPO model of 64 x 64 in an environment, and return the path of its file."""
    if env == STOCK:
        envs: Any = HighwayVecEnv([lambda: gymnasium.make(STOCK, disable_env_checker=True)] * 16)
    else:
        envs = DrivingVecEnv(gymnasium.make_vec(environment_id(env), num_envs=32, autoreset_mode="SameStep"))
    options: dict[str, Any] = {"n_steps": 64, "batch_size": 256, "n_epochs": 5, "learning_rate": 5e-4, "gamma": 0.9}
    model = PPO("MlpPolicy", envs, seed=0, device="cpu", **options)
    model.learn(STEPS[env])
    path = folder / f"{env}.zip"
    model.save(path)
    return str(path)


def _wall(
    pace: Pace, arguments: tuple[str, ...], environment: Mapping[str, str] = MappingProxyType({})
) -> tuple[float, float]:
    """Return the wall time of a command [s], and how many executions plain highway-env does in that time."""
    before = pace.now()
    start = time.perf_counter()
    command = [sys.executable, "-m", "behavexplor", *arguments]
    subprocess.run(command, check=True, capture_output=True, env={**os.environ, **environment})
    seconds = time.perf_counter() - start
    return seconds, 2 * seconds / (before + pace.now())
