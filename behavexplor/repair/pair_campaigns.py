"""The campaigns of a comparison: both drivers in the same scenarios, each in a run folder of its own."""

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from behavexplor.campaign.campaign import search_method
from behavexplor.campaign.config import Budget, CampaignConfig
from behavexplor.campaign.opening import opened
from behavexplor.campaign.store import Store
from behavexplor.data.drawn_scenario import DrawnScenario
from behavexplor.data.durable import folder_in, write_durably
from behavexplor.data.target import Target
from behavexplor.envs.making import is_stock
from behavexplor.execution.simulation import logical_scenario
from behavexplor.execution.start import check_loading, logical_of_target, start_executor
from behavexplor.fuzz.methods import load_method
from behavexplor.judge.robustness import load_specs
from behavexplor.repair.differential import Difference, Driven, search_differences
from behavexplor.repair.pairs import Pairs, paired

FIRST, SECOND, PAGE = "first", "second", "comparison.html"  # run folders and page of a comparison
SETTINGS: Mapping[str, Any] = {"method": "uniform", "batch": 32}  # of both campaigns
DIFFERENCES = "differences.jsonl"

Observe = Callable[[int], None]


def driven(config: CampaignConfig, folder: Path, workers: int, observe: Observe) -> list[str]:
    """Run one of the two campaigns.

    Args:
        config: its configuration.
        folder: its run folder, new or empty.
        workers: number of worker processes; 0 uses this process.
        observe: function that is called with the number of executions.

    Returns:
        Warnings about the driver.

    Raises:
        InputError: if the driver or the environment cannot be used.
        ExecutionError: if an execution could not be carried out.
    """
    with opened(config, folder_in(folder.parent, folder.name), workers, resume=False) as ready:
        ready.campaign.run(lambda progress: observe(progress.executions))
        return ready.warnings


def second_config(first: CampaignConfig, ads: str, folder: Path) -> CampaignConfig:
    """Return the configuration of the second driver, in the scene of the first one's run.

    Args:
        first: configuration of the first driver.
        ads: name of the second driver.
        folder: run folder of the first driver.
    """
    with closing(Store.read(folder)) as store:
        scenario = store.execution(0).scenario
    config = replace(first, ads=ads)
    if isinstance(scenario, DrawnScenario):
        config = replace(config, env_config=scenario.setup.scene_config)
    return config


def compared(folder: Path) -> list[Pairs]:
    """Return the paired statistics of a folder's two runs."""
    with closing(Store.read(folder / FIRST)) as first, closing(Store.read(folder / SECOND)) as second:
        return paired(first.records(), second.records())


def check_search(config: CampaignConfig) -> None:
    """Check the search for differences as far as that is possible before a driver is loaded.

    Args:
        config: configuration of the first driver, with the search method.

    Raises:
        InputError: if the search method cannot be used.
    """
    if is_stock(config.env):  # where the logical scenario depends on what the driver declares
        load_method(config.method)
    else:
        search_method(config, logical_scenario(config.env))


def differences(
    first: CampaignConfig, second: CampaignConfig, folder: Path, workers: int, observe: Observe
) -> list[Difference]:
    """Search for differences, and write their scenarios to a file.

    Args:
        first: configuration of the first driver, with the search method.
        second: configuration of the second driver.
        folder: folder for the file `DIFFERENCES`.
        workers: number of worker processes of each driver; 0 uses this process.
        observe: function that is called with the number of executed scenarios.

    Raises:
        InputError: if a driver or the search method cannot be used.
        RuntimeError: if a scenario could not be executed.
    """
    budget = Budget.parse(first.budget).executions or 0
    with _loaded(first.target, workers) as one, _loaded(second.target, workers) as other:
        method, specs = search_method(first, one.logical), load_specs(first.specs)
        found = search_differences(method, one, other, specs, budget=budget, batch=first.batch, observe=observe)
    lines = [json.dumps(difference.scenario.to_dict(), separators=(",", ":")) for difference in found]
    write_durably(folder_in(folder.parent, folder.name) / DIFFERENCES, "".join(f"{line}\n" for line in lines))
    return found


@contextmanager
def _loaded(target: Target, workers: int) -> Iterator[Driven]:
    executor = start_executor(target, workers)
    try:
        check_loading(executor)
        yield Driven(executor, logical_of_target(executor, target.env))
    finally:
        executor.shutdown(wait=False)
