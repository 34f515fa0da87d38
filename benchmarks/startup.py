"""Waiting times of a user: for help, for the first execution with and without cached kernels, and for a campaign."""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

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
        commands = {
            "fuzz --help": (("fuzz", "--help"), {}),
            "first execution, machine code cached": ((*once, f"{folder}/1"), {}),
            "first execution, nothing cached": ((*once, f"{folder}/2"), cold),
            f"{budget} executions, BehAVExplor and rule": ((*whole, f"{folder}/3"), {}),
            f"{budget} executions, BehAVExplor and a policy": ((*whole, f"{folder}/4", *policy), {}),
        }
        return [{"command": name, "seconds": _wall(*command)} for name, command in commands.items()]


def _wall(arguments: tuple[str, ...], environment: dict[str, str]) -> float:
    start = time.perf_counter()
    command = [sys.executable, "-m", "behavexplor", *arguments]
    subprocess.run(command, check=True, capture_output=True, env={**os.environ, **environment})
    return time.perf_counter() - start
