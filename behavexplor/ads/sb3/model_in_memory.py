"""A model of Stable-Baselines3 in memory as a driving system under test."""

import logging
from collections.abc import Iterable, Iterator, Mapping
from copy import deepcopy
from typing import Any, Final

import gymnasium
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import (
    DummyVecEnv,
    VecCheckNan,
    VecEnv,
    VecEnvWrapper,
    VecExtractDictObs,
    VecFrameStack,
    VecMonitor,
    VecNormalize,
    VecTransposeImage,
    VecVideoRecorder,
)

from behavexplor.ads.learned.network_file import DIVERGED
from behavexplor.ads.sb3.building import new_policy
from behavexplor.ads.sb3.description import ENVIRONMENT_KEYS, Description
from behavexplor.ads.sb3.normalization import Moments, Statistics
from behavexplor.ads.sb3.policy import SB3Policy
from behavexplor.data.observations import Observation
from behavexplor.errors import InputError

_LOG: Final = logging.getLogger(__name__)
_CHANGING: Final = (  # what the policy observes or does
    gymnasium.ObservationWrapper,
    gymnasium.ActionWrapper,
    gymnasium.wrappers.NormalizeObservation,
    VecExtractDictObs,
    VecTransposeImage,
)
_KNOWN: Final = (  # these change neither, or are applied in a campaign, even if they are named above
    gymnasium.RewardWrapper,
    gymnasium.wrappers.FlattenObservation,
    gymnasium.wrappers.FrameStackObservation,
    Monitor,
    gymnasium.wrappers.NormalizeReward,
    gymnasium.wrappers.OrderEnforcing,
    gymnasium.wrappers.PassiveEnvChecker,
    gymnasium.wrappers.RecordEpisodeStatistics,
    gymnasium.wrappers.RecordVideo,
    gymnasium.wrappers.TimeLimit,
    VecCheckNan,
    VecFrameStack,
    VecMonitor,
    VecNormalize,
    VecVideoRecorder,
)


def policy_of(model: BaseAlgorithm) -> SB3Policy:
    """Return a copy of a model's policy as it is now, so that the model can be trained on.

    Statistics of `VecNormalize`, stacked frames and the configuration of highway-env are those of the model's
    environment. A warning names each other wrapper that may change what the policy observes or does.

    Raises:
        InputError: if the environment has a wrapper that is known to change them, and is not applied in a campaign; if
            it has two `VecFrameStack`, or two `VecNormalize` for observations; or if weights are not finite.
    """
    wrappers = list(_wrappers(model.get_env()))
    _check_wrappers([*wrappers, *_single_wrappers(model.get_env())])
    network = _copied(model)
    stack = _only([wrapper for wrapper in wrappers if isinstance(wrapper, VecFrameStack)])
    scaling = _only([wrapper for wrapper in wrappers if isinstance(wrapper, VecNormalize) and wrapper.norm_obs])
    config = training_env(model)[1] or {}
    declared = {name: config[name] for name in ENVIRONMENT_KEYS if name in config}
    description = Description(config=config or None, frame_stack=stack.stacked_obs.n_stack if stack else 1, **declared)
    last = None if wrappers or training_env(model)[0] else _last_observations(model)
    return SB3Policy(network, description, _statistics(scaling) if scaling else None, last)


def _only(wrappers: list[Any]) -> Any:
    """Return the wrapper of a kind, or None if there is none; a campaign would not apply a second one."""
    if len(wrappers) > 1:
        name = type(wrappers[0]).__name__
        raise InputError(
            f"The model was trained in {len(wrappers)} wrappers {name}, and a campaign applies one of a kind"
        )
    return wrappers[0] if wrappers else None


def _last_observations(model: BaseAlgorithm) -> Observation | None:
    """Return the observations at the end of the training of a model that was loaded without its environment.

    They show whether statistics were lost. A model that has its environment has its statistics.
    """
    last: Observation | None = model._last_obs  # noqa: SLF001 - nothing else keeps them
    return last


def _copied(model: BaseAlgorithm) -> BasePolicy:
    """Return a copy of a model's policy, made as its algorithm makes it.

    The policy cannot be copied itself, because of its tensors from the last update. And its own `save` leaves out what
    the policies of sb3-contrib are made of.
    """
    with torch.random.fork_rng(devices=[]):  # a new network draws its first weights
        spaces = (model.observation_space, model.action_space)
        network = new_policy(model.policy_class, *spaces, model.policy_kwargs, use_sde=model.use_sde)
    network.load_state_dict(model.policy.state_dict())
    if not all(weights.isfinite().all() for weights in network.parameters()):
        raise InputError(f"The model {DIVERGED}")
    network.set_training_mode(False)
    return network


def training_env(model: BaseAlgorithm) -> tuple[str | None, Mapping[str, Any] | None]:
    """Return the id of a model's environment and its configuration in highway-env; None for what is not known."""
    env = model.get_env()
    spec, config = _shared(env, "spec"), _shared(env, "config")
    return None if spec is None else str(spec.id), deepcopy(config) if isinstance(config, Mapping) else None


def _shared(env: VecEnv | None, name: str) -> Any:
    """Return an attribute of the first sub-environment; None if it has none."""
    if env is None:
        return None
    try:
        return env.get_attr(name, indices=[0])[0]
    except Exception:  # the environment is anything, in this process or in another one
        return None


def _wrappers(env: VecEnv | None) -> Iterator[VecEnvWrapper]:
    while isinstance(env, VecEnvWrapper):
        yield env
        env = env.venv


def _single_wrappers(env: VecEnv | None) -> Iterator[gymnasium.Wrapper[Any, Any, Any, Any]]:
    """Yield the wrappers of the first sub-environment that its registration does not have.

    Only those around environments of highway-env and this package are found, and only in this process.
    """
    *_, inner = [env, *(wrapper.venv for wrapper in _wrappers(env))]
    single = inner.envs[0] if isinstance(inner, DummyVecEnv) else None
    spec = None if single is None else single.spec
    if spec is None or not str(spec.entry_point).startswith(("highway_env.", "behavexplor.")):
        return
    registered = {wrapper.name for wrapper in gymnasium.spec(spec.id).additional_wrappers}
    while isinstance(single, gymnasium.Wrapper):
        if single.class_name() not in registered:
            yield single
        single = single.env


def _check_wrappers(wrappers: Iterable[Any]) -> None:
    """Refuse wrappers that change what the policy observes or does, and warn of those that may."""
    for wrapper in wrappers:
        pads_otherwise = getattr(wrapper, "padding_type", "reset") != "reset"  # stacked frames, at a start
        if isinstance(wrapper, _KNOWN) and not pads_otherwise:
            continue
        applied = f"The model was trained in the wrapper {type(wrapper).__name__}, which is not applied in a campaign"
        if isinstance(wrapper, _CHANGING):
            raise InputError(f"{applied}: give a driver whose predict method does what the wrapper did")
        _LOG.warning("%s. If it changes what the policy observes or does, the policy drives otherwise here", applied)


def _statistics(scaling: VecNormalize) -> Statistics:
    """Return the statistics by which an environment scales observations now."""
    found = scaling.obs_rms
    moments = {key: _moments(of) for key, of in found.items()} if isinstance(found, Mapping) else _moments(found)
    return Statistics(moments, float(scaling.clip_obs), float(scaling.epsilon))


def _moments(found: RunningMeanStd) -> Moments:
    return Moments(found.mean.copy(), found.var.copy())
