"""How long an experiment will take, as far as can be told before."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from behavexplor.bench.experiment import Experiment, PlannedRun
from behavexplor.bench.runs import run_state
from behavexplor.bench.timing import read_timing
from behavexplor.execution.simulation import Simulation

TRIAL: Final = 10  # executions that are timed
_WARMING: Final = 2  # executions before, in which what is compiled is compiled


def forecast(experiment: Experiment, root: Path, jobs: int) -> float:
    """Return the time that the unfinished runs will take [s].

    What a method needs for its own thinking counts where a campaign of it has been measured already; else it is a
    few executions, timed here and now, that are taken for all.

    Raises:
        InputError: if an ADS or an environment cannot be used.
    """
    runs = experiment.runs()
    measured = _measured(runs, root)
    seconds = 0.0
    for run in runs:
        found = run_state(run, root)
        if found.finished:
            continue
        place = (run.env, run.ads)
        if (*place, run.method) not in measured and place not in measured:
            measured[place] = trial(*place, experiment.batch, experiment.trust)
        seconds += (experiment.budget - found.executions) * measured.get((*place, run.method), measured.get(place, 0))
    return seconds / jobs


def _measured(runs: Sequence[PlannedRun], root: Path) -> dict[tuple[str, ...], float]:
    """Seconds an execution by environment, ADS and method, where any was measured."""
    found: dict[tuple[str, ...], list[float]] = {}
    for run in runs:
        timing = read_timing(root / run.folder)
        if timing.executions:
            seconds = (timing.executing + timing.analysing) / timing.executions
            found.setdefault((run.env, run.ads, run.method), []).append(seconds)
    return {key: float(np.mean(values)) for key, values in found.items()}


def trial(env: str, ads: str, batch: int, trust: Sequence[str]) -> float:
    """Seconds that an execution takes, from a few; as many of them at a time as a campaign has candidates in flight.

    Raises:
        InputError: if the ADS or the environment cannot be used.
    """
    simulation = Simulation(env, ads, trust)
    generator = np.random.default_rng(0)
    scenarios = [simulation.logical.sample(generator) for _ in range(_WARMING + TRIAL)]
    for _ in simulation.run_all(scenarios[:_WARMING], batch):
        pass
    start = time.monotonic()
    for _ in simulation.run_all(scenarios[_WARMING:], batch):
        pass
    seconds = (time.monotonic() - start) / TRIAL
    simulation.close()
    return seconds
