"""Rates of arrival and violations of a driver, from Python."""

from collections.abc import Callable, Mapping
from typing import Any, Final

import gymnasium

from behavexplor.ads.in_memory import given_driver
from behavexplor.api.conducting import in_this_process, worker_count
from behavexplor.api.environments import environment_of, given_config
from behavexplor.campaign.config import CampaignConfig, campaign_config
from behavexplor.errors import InputError
from behavexplor.evaluation import Evaluation, estimate_rates, start_judge
from behavexplor.execution.start import logical_of_target

_UNUSED: Final = frozenset({"method", "options", "budget", "batch", "specs", "revision"})  # keys of searches only


def evaluate(
    driver: Any,
    env: str | gymnasium.Env[Any, Any] | None = None,
    *,
    scenarios: int = 1000,
    seed: int = 0,
    env_config: Mapping[str, Any] | None = None,
    workers: int | None = None,
    observe: Callable[[int], None] | None = None,
    **settings: Any,
) -> Evaluation:
    """Drive uniformly drawn scenarios, and count how often a driver arrives, collides and touches illegal lines.

    Args:
        driver: see `behavexplor.find_failures`.
        env: see `behavexplor.find_failures`.
        scenarios: number of scenarios.
        seed: seed of the drawn scenarios.
        env_config: see `behavexplor.find_failures`.
        workers: see `behavexplor.find_failures`.
        observe: function that gets the number of finished scenarios.
        settings: further keys of the configuration that tell how to drive, see
            `behavexplor.campaign.config.CampaignConfig`.

    Raises:
        InputError: if an argument cannot be used.
        behavexplor.execution.ads_error.ADSError: if the driver fails in a scenario.
    """
    if unused := sorted(_UNUSED & settings.keys()):
        raise InputError(
            f"An evaluation draws scenarios uniformly and has no use for {unused[0]}: give scenarios and seed"
        )
    given = given_driver(driver)
    name, changes = environment_of(given.trained_in(env) or CampaignConfig.env)
    values = {"env": name, "ads": given.name, "env_config": given_config(changes, env_config), **settings}
    target = campaign_config(values).target
    count = worker_count(given, target, workers)
    with in_this_process(count):
        executor = start_judge(target, count, given.driver)
        try:
            logical = logical_of_target(executor, target.env)
            return estimate_rates(executor, logical, scenarios, seed, observe)
        finally:
            executor.shutdown(wait=False)
