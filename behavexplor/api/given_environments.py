"""Environments as a user gives them: by name or as an object of gymnasium, and with changes of the configuration."""

import json
from collections.abc import Mapping
from math import inf
from typing import Any, Final

import gymnasium
from gymnasium.envs.registration import EnvSpec
from gymnasium.wrappers import OrderEnforcing, PassiveEnvChecker, RecordEpisodeStatistics, RecordVideo, TimeLimit

from behavexplor.data.drawn_scenario import DECLARED, config_text
from behavexplor.envs.making import default_config, is_highway
from behavexplor.errors import InputError, brief

_HARMLESS: Final = (  # a driver is not told rewards, and limits of time are checked on their own
    OrderEnforcing,
    PassiveEnvChecker,
    RecordEpisodeStatistics,
    RecordVideo,
    TimeLimit,
    gymnasium.RewardWrapper,
)
_MONITOR: Final = "stable_baselines3.common.monitor"  # the module of a wrapper that changes nothing either


def environment_of(given: str | gymnasium.Env[Any, Any]) -> tuple[str, Mapping[str, Any] | None]:
    """Return the name of an environment, and its configuration, which is None for an environment given by name.

    An environment is given by name, as in `behavexplor.envs.making.environment_id`, or as an object that gymnasium has
    made. The configuration of an object is what differs from its default. For an environment of highway-env, it also
    has all keys of the scene, because a model could have been trained in another scene.

    Raises:
        InputError: if it is neither; or if it cannot be made again as it is: it has no spec, one of its methods is
            replaced, a wrapper would change what a driver observes or does, or a limit would end episodes early.
    """
    if isinstance(given, str):
        return given, None
    if not isinstance(given, gymnasium.Env):
        raise InputError(f"An environment must be an id or an environment of gymnasium, and {brief(given)} is neither")
    _check_wrappers(given)
    if given.spec is None:
        raise InputError(f"The environment {brief(given)} has no spec, so it cannot be made again: use gymnasium.make")
    from behavexplor.envs.source_gate import REWARDS, replaced_in  # noqa: PLC0415 - slow to import, and only objects need it

    method = replaced_in(given.unwrapped, allowed=REWARDS)
    if method is not None:
        raise InputError(
            f"The environment is made again in a campaign, without its {method}: override it in a subclass"
        )
    config = getattr(given.unwrapped, "config", {})
    _check_limit(given.spec, config)
    own, is_stated = default_config(given.spec.id), is_highway(given.spec.id)
    of_scene = set(config) - set(DECLARED) if is_stated else set()
    changed = {key for key in config.keys() - of_scene if key not in own or own[key] != config[key]}
    return given.spec.id, json.loads(config_text({key: config[key] for key in of_scene | changed}))


def given_config(of_env: Mapping[str, Any] | None, given: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """Return the configuration of an environment object with what is `given` for it; None if there is neither.

    If both have a key, the given value counts.

    Raises:
        InputError: if what is given is no configuration.
    """
    if of_env is None and given is None:
        return None
    if not isinstance(given, Mapping | None):
        raise InputError(f"env_config must be a mapping from keys to values, got {brief(given)}")
    whole = {**(of_env or {}), **(given or {})}
    return dict(json.loads(config_text(whole)))  # values of numpy become plain ones


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
