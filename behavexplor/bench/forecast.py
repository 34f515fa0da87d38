"""Estimates of the running time of an experiment."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from behavexplor.bench.experiment import Experiment, PlannedRun
from behavexplor.bench.runs import run_state
from behavexplor.bench.timing import read_timing
from behavexplor.execution.simulation import Simulation

TRIAL: Final = 10  # number of timed executions
_WARMING: Final = 2  # number of executions before them, which compile kernels


def forecast(experiment: Experiment, root: Path, jobs: int) -> float:
    """Return the estimated time for the unfinished runs [s].

    The estimate uses the measured time per execution of finished campaigns with the same environment, ADS and method.
    Without such a campaign, a few executions are timed now, and the time of the search method itself is left out.

    Args:
        experiment: the experiment.
        root: the experiment's folder.
        jobs: number of campaigns at a time.

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
    """Return the mean measured time per execution by environment, ADS and method [s]."""
    found: dict[tuple[str, ...], list[float]] = {}
    for run in runs:
        timing = read_timing(root / run.folder)
        if timing.executions:
            seconds = (timing.executing + timing.analysing) / timing.executions
            found.setdefault((run.env, run.ads, run.method), []).append(seconds)
    return {key: float(np.mean(values)) for key, values in found.items()}


def trial(env: str, ads: str, batch: int, trust: Sequence[str]) -> float:
    """Return the mean time of a few executions [s].

    Args:
        env: environment.
        ads: driving system under test.
        batch: number of scenarios that run at a time, as a campaign's `batch`.
        trust: digests of trusted policy files.

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
