"""Waiting times of a user: for help, for the first execution with and without cached kernels, and for a campaign."""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import gymnasium
import highway_env  # noqa: F401 - registers highway-fast-v0
from stable_baselines3 import PPO

from behavexplor.envs.sb3_vec_env import HighwayVecEnv

STOCK = "highway-fast-v0"
STEPS = 20_480  # of training

Row = dict[str, Any]


def startup_rows(budget: int) -> list[Row]:
    """Return the wall times of shell commands [s].

    Args:
        budget: number of executions of the campaign.
    """
    with tempfile.TemporaryDirectory() as folder:
        cold = {"NUMBA_CACHE_DIR": str(Path(folder, "machine-code"))}
        fuzz = ("fuzz", "--env", "intersection-straight", "--quiet")
        once, whole = (*fuzz, "--budget", "1", "--out"), (*fuzz, "--budget", str(budget), "--out")
        policy = ("--ads", "learned:intersection-straight")
        stock = ("fuzz", "--env", STOCK, "--ads", trained_policy(Path(folder)), "--quiet", "--budget", str(budget))
        commands = {
            "fuzz --help": (("fuzz", "--help"), {}),
            "first execution, machine code cached": ((*once, f"{folder}/1"), {}),
            "first execution, nothing cached": ((*once, f"{folder}/2"), cold),
            f"{budget} executions, BehAVExplor and rule": ((*whole, f"{folder}/3"), {}),
            f"{budget} executions, BehAVExplor and a policy": ((*whole, f"{folder}/4", *policy), {}),
            f"{budget} executions, BehAVExplor and PPO in {STOCK}": ((*stock, "--out", f"{folder}/5"), {}),
            f"{budget} executions, uniform and PPO in {STOCK}": (
                (*stock, "--out", f"{folder}/6", "--method", "uniform"),
                {},
            ),
        }
        return [{"command": name, "seconds": _wall(*command)} for name, command in commands.items()]


def trained_policy(folder: Path) -> str:
    """Train a PPO model of 64 x 64 in highway-env's own environment, and return the path of its file."""
    envs = HighwayVecEnv([lambda: gymnasium.make(STOCK, disable_env_checker=True)] * 16)
    options: dict[str, Any] = {"n_steps": 64, "batch_size": 256, "n_epochs": 5, "learning_rate": 5e-4, "gamma": 0.9}
    model = PPO("MlpPolicy", envs, seed=0, device="cpu", **options)
    model.learn(STEPS)
    path = folder / "highway.zip"
    model.save(path)
    return str(path)


def _wall(arguments: tuple[str, ...], environment: dict[str, str]) -> float:
    start = time.perf_counter()
    command = [sys.executable, "-m", "behavexplor", *arguments]
    subprocess.run(command, check=True, capture_output=True, env={**os.environ, **environment})
    return time.perf_counter() - start
