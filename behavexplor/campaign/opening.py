"""Setup and teardown of a campaign: its search method, executor, ADS check and run folder; and its end by signals."""

import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from types import FrameType

import numpy as np

from behavexplor.ads.interface import ADS
from behavexplor.behavior.miner import k_means
from behavexplor.behavior.novelty import NoveltyArchive
from behavexplor.campaign.campaign import TOGETHER, Campaign, search_method
from behavexplor.campaign.config import Budget, CampaignConfig, check_revision, point_to_latest, stored_config
from behavexplor.campaign.judges import LEAST_EXECUTIONS, PASS_BY_FRAMES, Judges, pass_by
from behavexplor.campaign.progress import Stage
from behavexplor.campaign.provenance import own_run, remember
from behavexplor.campaign.same_driver import check_identity, identity_of
from behavexplor.campaign.store import Store, check_free
from behavexplor.data.durable import write_durably
from behavexplor.data.motion_bytes import unpack_motion
from behavexplor.data.road_shape import ROAD_FILE
from behavexplor.data.scenario import LogicalScenario
from behavexplor.data.trace import RESOLUTION
from behavexplor.errors import InputError
from behavexplor.execution.evaluator import ROAD, evaluator_recipe
from behavexplor.execution.executor import LOCK_STEP, Executor
from behavexplor.execution.forkserver import share_imports
from behavexplor.execution.service import Recipe
from behavexplor.execution.simulation import fixed_logical_scenario
from behavexplor.execution.start import check_ads, logical_of_target, start_executor
from behavexplor.fuzz.methods import load_method
from behavexplor.judge.robustness import load_specs
from behavexplor.judge.specs import judge


@dataclass(frozen=True)
class Ready:
    """A campaign that is ready to run."""

    campaign: Campaign
    store: Store
    warnings: list[str]  # warnings about the ADS, each of them a sentence


@contextmanager
def opened(
    config: CampaignConfig,
    folder: Path,
    workers: int,
    *,
    resume: bool,
    cluster: str = "",
    driver: ADS | None = None,
    stop_after: int | None = None,
    patience: AbstractContextManager[object] | None = None,
) -> Iterator[Ready]:
    """Prepare a campaign, and release its resources afterwards.

    From then on, the folder counts as one that this machine has made, see `behavexplor.campaign.provenance`: a new one
    at once, and a resumed one after its stored executions have come out again.

    Args:
        config: configuration of the campaign.
        folder: run folder, new or empty unless the campaign is resumed.
        workers: greatest number of processes that execute scenarios; they start when they are needed. 0 means this
            process, or on a cluster one node for each core.
        resume: whether to resume the campaign in the folder.
        cluster: name of a cluster, see `behavexplor.execution.ray_cluster.parse_cluster`; empty for this machine.
        driver: object of this process that drives in place of the driving system that the configuration names. There
            are no workers then. None for none.
        stop_after: number of failures after which the campaign stops; None for no such number.
        patience: context manager that is entered while the ADS is loaded and checked.

    Yields:
        The campaign, ready to run.

    Raises:
        InputError: if the ADS, the environment, the search method, a spec, the cluster or the run folder cannot be
            used, if the campaign has another revision, or if its driver or other code has changed since it began.
    """
    begun = time.monotonic()
    check_revision(stored_config(folder).unverified if resume else config, str(folder))
    if not resume:
        check_free(folder)  # before the driver is loaded, which takes a while
    # both before any code that the configuration names is run
    own = own_run(config, folder)
    identity = identity_of(config)
    recipe = _recipe(config)
    specs = load_specs(config.specs)
    if workers and not cluster and driver is None:
        share_imports(recipe.preload)
    logical = fixed_logical_scenario(config.env)
    search = None if logical is None else search_method(config, logical)
    with ExitStack() as stack:
        with patience or nullcontext():
            executor = start_executor(config.target, workers, cluster, recipe, driver)
            stack.callback(executor.shutdown, wait=False)
            warnings = check_ads(executor, meanwhile=load_analysis) + _warnings_of_idle_workers(config, workers)
        logical = logical or logical_of_target(executor, config.env)
        search = search or search_method(config, logical)
        if not resume:
            remember(own)
        store = _reopened(folder, config) if resume else Store.create(folder, config.to_yaml())
        stack.callback(store.close)
        check_identity(store, identity)
        point_to_latest(folder)
        _write_road(folder, logical, executor)
        judges = _judges(config, workers, logical)
        if judges is not None:
            stack.callback(judges.shutdown)
        campaign = Campaign(config, search, logical, store, executor, specs, stop_after, judges)
        campaign.clock.seconds[Stage.STARTING] = time.monotonic() - begun
        yield Ready(campaign, store, warnings)
        if resume and campaign.is_replayed:  # what was stored came out again
            remember(own)


def _foresees(config: CampaignConfig) -> bool:
    """Return whether the search method has candidates that need no result, see `SearchMethod`."""
    return hasattr(load_method(config.method), "foreseen")


def _recipe(config: CampaignConfig) -> Recipe:
    # no candidate depends on a result, so results may arrive in groups
    if getattr(load_method(config.method), "foreseen", None) == sys.maxsize:
        return replace(evaluator_recipe(config.target), together=TOGETHER)
    return evaluator_recipe(config.target, LOCK_STEP if _foresees(config) else config.batch)


def _judges(config: CampaignConfig, workers: int, logical: LogicalScenario) -> Judges | None:
    """Return the judges of a campaign; None for a short one, without workers, or if the user's own specs judge, too."""
    executions = Budget.parse(config.budget).executions
    is_long = executions is None or executions >= LEAST_EXECUTIONS
    if not (workers and is_long) or config.specs:
        return None
    nearness = getattr(load_method(config.method), "uses_nearness", False)
    return Judges(workers, logical, nearness=nearness)


def _warnings_of_idle_workers(config: CampaignConfig, workers: int) -> list[str]:
    """Return a warning about workers to which the batch gives nothing to do, in a list; empty without such workers."""
    if workers <= config.batch or _foresees(config):
        return []
    idle = f"{workers - config.batch} of {workers} workers have nothing to do"
    return [f"With --batch {config.batch}, {idle}: a larger batch gives other records, faster"]


def _write_road(folder: Path, logical: LogicalScenario, executor: Executor) -> None:
    """Write the shape of the road of a highway-env environment, if the folder lacks it."""
    if logical.has_original and not (folder / ROAD_FILE).is_file():
        write_durably(folder / ROAD_FILE, executor.submit(ROAD, b"").result().decode())


def _reopened(run: Path, config: CampaignConfig) -> Store:
    """Return the store of a run to resume."""
    store = Store.reopen(run)
    try:
        _check_budget(run, config, len(store))
        if not _is_shorter(config.budget, stored_config(run).unverified.budget):
            store.write_config(config.to_yaml())
    except InputError:
        store.close()
        raise
    return store


def _is_shorter(budget: str, stored: str) -> bool:
    """Return whether a budget is smaller than the stored one, and of the same kind.

    A smaller budget ends the run earlier this time, but does not replace the stored budget.
    """
    new, old = Budget.parse(budget), Budget.parse(stored)
    if new.executions is not None and old.executions is not None:
        return new.executions < old.executions
    return new.seconds is not None and old.seconds is not None and new.seconds < old.seconds


def _check_budget(run: Path, config: CampaignConfig, count: int) -> None:
    executions = Budget.parse(config.budget).executions
    if executions is not None and executions < count:
        raise InputError(f"--budget {executions} is less than the {count} executions that {run} already has")


def load_analysis() -> None:
    """Import the modules and load the machine code that the analysis of a trace needs, by analyzing a small one.

    The first campaign on a machine compiles that code here. Otherwise, its first execution would wait for it.
    """
    k_means(np.eye(2), 1, ["random"], 0)  # imports scikit-learn
    unpack_motion(np.zeros((1, 2, PASS_BY_FRAMES), dtype=np.uint8), PASS_BY_FRAMES, RESOLUTION)
    trace = pass_by()
    judge(trace)
    NoveltyArchive().observe(trace)


Handler = Callable[[int, FrameType | None], object] | signal.Handlers


@contextmanager
def stopped_by_signals(stop: Callable[[], None], again: Handler) -> Iterator[None]:
    """Make the first Ctrl-C (or SIGTERM) call `stop`, to end the code in this context; `again` handles the second."""

    def first(number: int, _frame: FrameType | None) -> None:
        stop()
        signal.signal(number, again)

    previous = {number: signal.signal(number, first) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
