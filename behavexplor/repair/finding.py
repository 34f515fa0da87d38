"""Failures of a policy that are worth training on: the policy was at fault, and could have avoided them."""

from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from behavexplor.campaign.config import CONFIG, CampaignConfig
from behavexplor.campaign.opening import opened
from behavexplor.campaign.store import Execution, Store
from behavexplor.data.drawn_scenario import DEFAULT, WIDE
from behavexplor.data.target import Target
from behavexplor.execution.simulation import Simulation
from behavexplor.triage.blame import blame
from behavexplor.triage.examination import STREAM


def search_config(target: Target, method: str, budget: int, seed: int) -> CampaignConfig:
    """Return the configuration of the campaign of `found_failures`.

    Raises:
        InputError: if a value is out of range.
    """
    return CampaignConfig(
        env=target.env,
        ads=target.ads,
        method=method,
        budget=str(budget),
        seed=seed,
        batch=32,
        env_config=None if target.env_config is None else dict(target.env_config),
        traffic=WIDE if target.traffic == WIDE else DEFAULT,
        unconfined=target.unconfined,
    )


def found_failures(target: Target, method: str, budget: int, seed: int, folder: Path) -> tuple[list[Any], int]:
    """Run a campaign on a policy, or read it if its folder has it.

    Args:
        target: the policy and its environment.
        method: search method.
        budget: number of executions.
        seed: seed of the campaign.
        folder: run folder.

    Returns:
        The scenarios of the failures for which the policy was at fault, without collisions that no tried evasion
        avoids; and the number of decisions of the whole campaign.

    Raises:
        ExecutionError: if an execution could not be carried out.
    """
    config = search_config(target, method, budget, seed)
    begun = (folder / CONFIG).is_file()  # a folder without it was interrupted before its campaign began
    with opened(config, folder, 0, resume=begun) as ready:
        ready.campaign.run(lambda _: None)
    with closing(Store.read(folder)) as store:
        executions = list(store.executions())
    with closing(
        Simulation(target.env, target.ads, env_config=target.env_config, traffic=target.traffic)
    ) as simulation:
        failures = [one.scenario for one in executions if one.record.at_fault and _preventable(simulation, one, seed)]
        frequency = simulation.env.get_wrapper_attr("config")["policy_frequency"]
    return failures, round(sum(one.record.duration or 0.0 for one in executions) * frequency)


def _preventable(simulation: Simulation, execution: Execution, seed: int) -> bool:
    """Return False for a collision that no tried evasion avoids, and True for any other failure."""
    if execution.record.fault is None:
        return True
    rng = np.random.default_rng([STREAM, seed, execution.id])
    verdict = blame(simulation, execution.scenario, execution.load_trace(), rng)
    return verdict is None or verdict.at_fault
