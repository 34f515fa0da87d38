"""Estimates of the running time of an experiment."""

import math
import time
from collections.abc import Sequence
from contextlib import closing, suppress
from pathlib import Path
from typing import Final

import numpy as np

from behavexplor.bench.experiment import Experiment, PlannedRun
from behavexplor.bench.runs import run_state
from behavexplor.campaign.progress import executing_and_analysing
from behavexplor.campaign.record import DATABASE
from behavexplor.campaign.store import Store
from behavexplor.data.target import Target
from behavexplor.execution.evaluator import EXECUTE
from behavexplor.execution.executor import ADSError, Executor
from behavexplor.execution.start import fewest_workers, logical_of_target, start_executor

TRIAL: Final = 10  # number of timed executions
_WARMING: Final = 2  # number of executions before them, which compile kernels


def forecast(experiment: Experiment, runs: Sequence[PlannedRun], root: Path, jobs: int) -> float:
    """Return the estimated time for the unfinished runs of an experiment [s].

    The estimate uses the measured time per execution of finished campaigns with the same environment, ADS and method.
    Without such a campaign, a few executions are timed now, and the time of the search method itself is left out.

    Args:
        experiment: the experiment.
        runs: runs of the experiment that may be unfinished.
        root: the experiment's folder.
        jobs: number of campaigns at a time.

    Raises:
        InputError: if an ADS or an environment cannot be used.
    """
    measured = _measured(runs, root)
    seconds = 0.0
    for run in runs:
        found = run_state(run, root)
        if found.finished:
            continue
        place = (run.env, run.ads)
        if (*place, run.method) not in measured and place not in measured:
            measured[place] = trial(run.config.target, experiment.batch)
        seconds += (experiment.budget - found.executions) * measured.get((*place, run.method), measured.get(place, 0))
    return seconds / jobs


def _measured(runs: Sequence[PlannedRun], root: Path) -> dict[tuple[str, ...], float]:
    """Return the mean measured time per execution by environment, ADS and method [s]."""
    found: dict[tuple[str, ...], list[float]] = {}
    for run in runs:
        if not (root / run.folder / DATABASE).is_file():
            continue
        with closing(Store.read(root / run.folder)) as store:
            seconds, count = sum(executing_and_analysing(store.stages)), len(store)
        if count and not math.isnan(seconds):
            found.setdefault((run.env, run.ads, run.method), []).append(seconds / count)
    return {key: float(np.mean(values)) for key, values in found.items()}


def trial(target: Target, batch: int) -> float:
    """Return the mean time of a few executions [s].

    Args:
        target: the driving system and its environment.
        batch: number of scenarios that run at a time, as a campaign's `batch`.

    Raises:
        InputError: if the ADS or the environment cannot be used.
    """
    generator = np.random.default_rng(0)
    with start_executor(target, fewest_workers(target)) as executor:
        logical = logical_of_target(executor, target.env)
        requests = [logical.sample(generator).to_json().encode() for _ in range(_WARMING + TRIAL)]
        _execute(executor, requests[:_WARMING], batch)
        start = time.monotonic()
        _execute(executor, requests[_WARMING:], batch)
        return (time.monotonic() - start) / TRIAL


def _execute(executor: Executor, requests: Sequence[bytes], batch: int) -> None:
    """Execute scenarios, as many at a time as a campaign does."""
    for begin in range(0, len(requests), batch):
        futures = [executor.submit(EXECUTE, request) for request in requests[begin : begin + batch]]
        for future in futures:
            with suppress(ADSError):  # a campaign records it, and goes on
                future.result()
