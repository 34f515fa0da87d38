"""Functions that start executors: for one target or for any service, in this process, in workers or on a cluster."""

import json
from collections.abc import Callable
from typing import Any

from behavexplor.ads.interface import ADS
from behavexplor.ads.loading import check_name
from behavexplor.data.drawn_logical import DrawnLogicalScenario
from behavexplor.data.logical import LogicalScenario
from behavexplor.data.target import Target
from behavexplor.errors import InputError, sentence
from behavexplor.execution.evaluator import LOGICAL, PREFLIGHT, evaluator_recipe, needs_confinement
from behavexplor.execution.executor import Executor
from behavexplor.execution.fingerprint import FINGERPRINT
from behavexplor.execution.in_process import InProcessExecutor
from behavexplor.execution.pool import WorkerPool
from behavexplor.execution.ray_cluster import RayExecutor
from behavexplor.execution.service import Recipe
from behavexplor.execution.simulation import logical_scenario


def start_executor(target: Target, workers: int, cluster: str = "", recipe: Recipe | None = None) -> Executor:
    """Start the executor for the scenarios of a target.

    Args:
        target: the driving system and its environment.
        workers: greatest number of worker processes, or number of nodes of a cluster. 0 means this process, without
            limits of time and memory, or on a cluster one node for each core.
        cluster: name of a cluster, see `behavexplor.execution.ray_cluster.parse_cluster`; empty for this machine.
        recipe: recipe of the service for the target; by default that of an `Evaluator`.

    Raises:
        InputError: if the environment, the ADS or the cluster cannot be used, or if an ADS that must be confined
            would run in this process.
    """
    check_name(target.ads)
    recipe = recipe or evaluator_recipe(target)
    if cluster:
        limits = (target.time_limit, target.memory_limit)
        return RayExecutor(cluster, workers, recipe, limits, (target.ads,))
    if workers < fewest_workers(target):
        raise InputError(
            f"--workers 0 would run {target.ads!r} in this process, which cannot be confined: use --workers 1, or let "
            "the driver write files and use the network with --unconfined"
        )
    if workers == 0:
        service = recipe.make()
        service.begin()
        return InProcessExecutor(service, recipe.batched)
    return WorkerPool(workers, recipe, target.time_limit, target.memory_limit)


def start_in_process(target: Target, driver: ADS, recipe: Recipe | None = None) -> Executor:
    """Start the executor for a driver that exists in this process only.

    Args:
        target: the environment, and the name of the driver.
        driver: the driver.
        recipe: recipe of an evaluator for the target; by default that of a plain one.

    Raises:
        InputError: if the environment cannot be used, or the driver cannot drive in it.
    """
    recipe = recipe or evaluator_recipe(target)
    evaluator: Any = recipe.make()
    evaluator.driver = driver
    evaluator.begin()
    return InProcessExecutor(evaluator, recipe.batched)


def fewest_workers(target: Target) -> int:
    """Return the least number of workers: 1 if the ADS must be confined, which only a process of its own can be."""
    return int(needs_confinement(target))


def logical_of_target(executor: Executor, env: str) -> LogicalScenario:
    """Return the logical scenario of a target, whose configuration may depend on what the ADS declares.

    Args:
        executor: executor of the target.
        env: name of the environment.

    Raises:
        InputError: if the ADS or the environment cannot be loaded.
    """
    try:
        described = executor.submit(LOGICAL, b"").result()
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"The driving system ended its process while it was loaded: {error}") from error
    return DrawnLogicalScenario.from_json(described.decode()) if described else logical_scenario(env)


def check_loading(executor: Executor) -> None:
    """Load the ADS in the place where it will run.

    Raises:
        InputError: if it cannot be loaded.
    """
    executor.submit(FINGERPRINT, b"[]").result()


def check_ads(executor: Executor, meanwhile: Callable[[], None] = lambda: None) -> list[str]:
    """Check the ADS in the place where it will run. This also compiles the kernels for all workers.

    Args:
        executor: executor of the ADS.
        meanwhile: work to do in this process while the ADS is loaded in another one.

    Returns:
        Warnings, each of them a printable sentence.

    Raises:
        InputError: if the ADS cannot be loaded.
    """
    checking = executor.submit(PREFLIGHT, b"")
    meanwhile()
    try:
        return [sentence(str(warning)) for warning in json.loads(checking.result())]
    except InputError:
        raise
    except Exception:  # an ADS that ends its process will do so again in the campaign, where it is recorded
        return []
