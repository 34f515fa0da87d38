"""A model of Stable-Baselines3 in memory as a driving system under test."""

from collections.abc import Iterator, Mapping
from copy import deepcopy
from io import BytesIO
from typing import Any

import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper, VecFrameStack, VecNormalize

from behavexplor.ads.sb3.description import ENVIRONMENT_KEYS, Description
from behavexplor.ads.sb3.normalization import Moments, Statistics
from behavexplor.ads.sb3.policy import SB3Policy


def policy_of(model: BaseAlgorithm) -> SB3Policy:
    """Return a copy of a model's policy as it is now, so that the model can be trained on.

    Statistics of `VecNormalize`, stacked frames and the configuration of highway-env are those of the model's
    environment.
    """
    network = _copied(model.policy)
    wrappers = list(_wrappers(model.get_env()))
    stacks = [wrapper.stacked_obs.n_stack for wrapper in wrappers if isinstance(wrapper, VecFrameStack)]
    scaling = [wrapper for wrapper in wrappers if isinstance(wrapper, VecNormalize) and wrapper.norm_obs]
    config = training_env(model)[1] or {}
    declared = {name: config[name] for name in ENVIRONMENT_KEYS if name in config}
    description = Description(config=config or None, frame_stack=stacks[0] if stacks else 1, **declared)
    return SB3Policy(network, description, _statistics(scaling[0]) if scaling else None, None)


def _copied(policy: BasePolicy) -> BasePolicy:
    """Return a copy of a policy. Its tensors from the last update cannot be copied, so it is saved and loaded."""
    file: Any = BytesIO()  # torch writes to it as to a path
    policy.save(file)
    file.seek(0)
    with torch.random.fork_rng(devices=[]):  # a new network draws its first weights
        return type(policy).load(file, device="cpu")


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


def _statistics(scaling: VecNormalize) -> Statistics:
    """Return the statistics by which an environment scales observations now."""
    found = scaling.obs_rms
    moments = {key: _moments(of) for key, of in found.items()} if isinstance(found, Mapping) else _moments(found)
    return Statistics(moments, float(scaling.clip_obs), float(scaling.epsilon))


def _moments(found: RunningMeanStd) -> Moments:
    return Moments(found.mean.copy(), found.var.copy())
