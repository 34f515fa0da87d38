"""Where the wall time of a campaign from the shell goes, by its own clock, and the CPU time of its process."""

import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from behavexplor.campaign.store import Store
from benchmarks.startup import FIRST, STOCK, trained_policy

Row = dict[str, Any]


def stage_rows(budget: int) -> list[Row]:
    """Return the time in each stage [s] of campaigns of several kinds, and the CPU time of their own process [s].

    Args:
        budget: number of executions of each campaign.
    """
    with tempfile.TemporaryDirectory() as folder:
        policy = f"learned:{FIRST}"
        kinds = {
            ("constant", 2): ("--env", FIRST, "--ads", "constant"),
            (policy, 0): ("--env", FIRST, "--ads", policy),
            (policy, 2): ("--env", FIRST, "--ads", policy),
            ("rule", 2): ("--env", FIRST, "--ads", "rule"),
            (f"PPO in {STOCK}", 2): ("--env", STOCK, "--ads", trained_policy(Path(folder), STOCK)),
        }
        return [
            {"driver": driver, "workers": workers, "n": budget}
            | _campaign((*flags, "--workers", str(workers), "--budget", str(budget)), Path(folder, str(number)))
            for number, ((driver, workers), flags) in enumerate(kinds.items())
        ]


def _campaign(flags: tuple[str, ...], folder: Path) -> Row:
    before = _cpu_of_children()
    command = [sys.executable, "-m", "behavexplor", "fuzz", *flags, "--quiet", "--out", str(folder)]
    subprocess.run(command, check=True, capture_output=True)
    store = Store.read(folder)
    stages = store.stages
    store.close()
    return {"CPU of its own process": _cpu_of_children() - before, **stages}


def _cpu_of_children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
