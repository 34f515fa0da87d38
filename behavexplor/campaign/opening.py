"""A campaign made ready to run: its ADS loaded, its run folder open, what executes it started; and all of it closed."""

from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path

from behavexplor.campaign.campaign import Campaign, search_method
from behavexplor.campaign.config import Budget, CampaignConfig, stored_config
from behavexplor.campaign.store import Store
from behavexplor.errors import InputError
from behavexplor.execution.simulation import logical_scenario
from behavexplor.execution.start import check_ads, start_executor
from behavexplor.judge.robustness import load_specs


@dataclass(frozen=True)
class Ready:
    """A campaign that can be run now, and what it stands on.

    Attributes:
        campaign: not yet run.
        store: its run folder.
        warnings: what is wrong with the ADS, a sentence each.
    """

    campaign: Campaign
    store: Store
    warnings: list[str]


@contextmanager
def opened(
    config: CampaignConfig,
    folder: Path,
    workers: int,
    *,
    resume: bool,
    cluster: str = "",
    patience: AbstractContextManager[object] | None = None,
) -> Iterator[Ready]:
    """Make a campaign ready, and release all of it afterwards.

    Args:
        config: what it is.
        folder: its run folder, new or empty unless it is resumed.
        workers: processes that execute scenarios; 0 is this one, or on a cluster as many as it has cores.
        resume: go on with what the folder holds.
        cluster: where the processes are, see `behavexplor.execution.cluster.address.parse_cluster`; empty for this
            machine.
        patience: entered while the ADS is loaded and tried.

    Raises:
        InputError: if the ADS, the environment, the search method, a spec, the cluster or the run folder cannot be
            used.
    """
    logical = logical_scenario(config.env)
    search, specs = search_method(config, logical), load_specs(config.specs)
    with ExitStack() as stack:
        with patience or nullcontext():
            executor = start_executor(config.target, workers, cluster)
            stack.callback(executor.shutdown, wait=False)
            warnings = check_ads(executor)
        store = _reopened(folder, config) if resume else Store.create(folder, config.to_yaml())
        stack.callback(store.close)
        yield Ready(Campaign(config, search, logical, store, executor, specs), store, warnings)


def _reopened(run: Path, config: CampaignConfig) -> Store:
    """The store of a run that has no more executions than the budget allows."""
    store = Store.reopen(run)
    try:
        _check_budget(run, config, len(store))
        if not _is_shorter(config.budget, stored_config(run).budget):
            store.write_config(config.to_yaml())
    except InputError:
        store.close()
        raise
    return store


def _is_shorter(budget: str, stored: str) -> bool:
    """Whether a budget is a smaller one of the same kind: that only ends the run earlier this time."""
    new, old = Budget.parse(budget), Budget.parse(stored)
    if new.executions is not None and old.executions is not None:
        return new.executions < old.executions
    return new.seconds is not None and old.seconds is not None and new.seconds < old.seconds


def _check_budget(run: Path, config: CampaignConfig, count: int) -> None:
    executions = Budget.parse(config.budget).executions
    if executions is not None and executions < count:
        raise InputError(f"--budget {executions} is less than the {count} executions that {run} has already")
