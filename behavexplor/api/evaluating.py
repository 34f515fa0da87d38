"""Rates of arrival and violations of a driver, from Python."""

import json
from collections.abc import Callable, Mapping
from math import inf
from typing import Any, Final

import gymnasium
from gymnasium.envs.registration import EnvSpec
from gymnasium.wrappers import OrderEnforcing, PassiveEnvChecker, RecordEpisodeStatistics, RecordVideo, TimeLimit

from behavexplor.ads.in_memory import given_driver
from behavexplor.api.conducting import in_this_process, worker_count
from behavexplor.campaign.config import CampaignConfig, campaign_config
from behavexplor.data.drawn_scenario import DECLARED, config_text
from behavexplor.envs.making import default_config, is_highway
from behavexplor.errors import InputError, brief
from behavexplor.evaluation import Evaluation, estimate_rates, start_judge
from behavexplor.execution.start import logical_of_target
from behavexplor.judge.rates import Goal

_HARMLESS: Final = (  # a driver is not told rewards, and limits of time are checked on their own
    OrderEnforcing,
    PassiveEnvChecker,
    RecordEpisodeStatistics,
    RecordVideo,
    TimeLimit,
    gymnasium.RewardWrapper,
)
_MONITOR: Final = "stable_baselines3.common.monitor"  # the module of a wrapper that changes nothing either
_UNUSED: Final = frozenset({"method", "options", "budget", "batch", "specs", "revision"})  # keys of searches only


def environment_of(given: str | gymnasium.Env[Any, Any]) -> tuple[str, Mapping[str, Any] | None]:
    """Return the name of an environment, and its configuration.

    Args:
        given: name as in `behavexplor.envs.making.environment_id`, or an environment that gymnasium has made.

    Returns:
        The name and the configuration; None as the configuration of a name. The configuration of an object is what
        differs from its default. For an environment of highway-env, it also has all keys of the scene, because a model
        could have been trained in another scene.

    Raises:
        InputError: if it is neither, or has a wrapper that would change what a driver observes or does, or a limit that
            would end episodes early.
    """
    if isinstance(given, str):
        return given, None
    if not isinstance(given, gymnasium.Env):
        raise InputError(f"An environment must be an id or an environment of gymnasium, and {brief(given)} is neither")
    _check_wrappers(given)
    if given.spec is None:
        raise InputError(f"The environment {brief(given)} has no spec, so it cannot be made again: use gymnasium.make")
    from behavexplor.envs.source_gate import REWARDS, replaced_in  # noqa: PLC0415 - slow to import, and only objects need it

    method = replaced_in(given.unwrapped, REWARDS)
    if method is not None:
        raise InputError(
            f"The environment is made again in a campaign, without its {method}: override it in a subclass"
        )
    config = getattr(given.unwrapped, "config", {})
    _check_limit(given.spec, config)
    own, is_stated = default_config(given.spec.id), is_highway(given.spec.id)
    kept = {key for key, value in config.items() if (is_stated and key not in DECLARED) or own.get(key, ...) != value}
    return given.spec.id, json.loads(config_text({key: config[key] for key in kept}))


def given_config(of_env: Mapping[str, Any] | None, given: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """Return what is known of a configuration, from an environment object and from what is given beside it.

    Returns:
        The configuration, as far as it is known; None if nothing is known.
    """
    if of_env is None and given is None:
        return None
    return dict(json.loads(config_text({**(of_env or {}), **(given or {})})))


def _check_wrappers(env: gymnasium.Env[Any, Any]) -> None:
    while isinstance(env, gymnasium.Wrapper):
        if not isinstance(env, _HARMLESS) and type(env).__module__ != _MONITOR:
            raise InputError(
                f"The environment has the wrapper {type(env).__name__}, which is not applied in a campaign: give the "
                f"environment without it, and a driver that does what the wrapper did"
            )
        env = env.env


def _check_limit(spec: EnvSpec, config: Mapping[str, Any]) -> None:
    """Refuse a limit of steps that the environment is not registered with, if it would end an episode early."""
    limit = spec.max_episode_steps
    if limit is None or limit == gymnasium.spec(spec.id).max_episode_steps:
        return
    if limit < config.get("duration", inf) * config.get("policy_frequency", 1):
        raise InputError(
            f"The environment ends its episodes after {limit} steps, which is not done in a campaign: leave out the "
            f"limit, and give the environment's configuration a shorter `duration`"
        )


def evaluate(
    driver: Any,
    env: str | gymnasium.Env[Any, Any] | None = None,
    *,
    scenarios: int = 1000,
    seed: int = 0,
    goal: Goal | None = None,
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
        goal: what is to be known of a rate; the evaluation ends as soon as it is, after at most `scenarios`.
        env_config: see `behavexplor.find_failures`.
        workers: see `behavexplor.find_failures`.
        observe: function that gets the number of finished scenarios.
        settings: further keys of the configuration that tell how to drive, see
            `behavexplor.campaign.config.CampaignConfig`.

    Raises:
        InputError: if an argument cannot be used.
        behavexplor.execution.executor.ADSError: if the driver fails in a scenario.
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
            return estimate_rates(executor, logical, scenarios, seed, observe, goal=goal)
        finally:
            executor.shutdown(wait=False)
