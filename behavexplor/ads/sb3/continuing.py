"""Models of Stable-Baselines3 that go on learning, built from a model's file without executing code from it."""

import inspect
import io
from collections.abc import Mapping
from typing import Any, Final

import sb3_contrib
import stable_baselines3
import torch
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.vec_env import VecEnv

from behavexplor.ads.sb3.archive import Archive
from behavexplor.ads.sb3.building import UntrustedError, policy_recipe
from behavexplor.errors import InputError

# The file does not name the algorithm. It is the first one whose number of this name is in the file.
_ALGORITHMS: Final[Mapping[str, type[OnPolicyAlgorithm]]] = {
    "cg_max_steps": sb3_contrib.TRPO,
    "n_epochs": stable_baselines3.PPO,
    "gae_lambda": stable_baselines3.A2C,
}
# Hyperparameters that go on. The learning rate and the clipping range may be functions; they have defaults.
_KEPT: Final = (
    "n_steps",
    "batch_size",
    "n_epochs",
    "gamma",
    "gae_lambda",
    "ent_coef",
    "vf_coef",
    "max_grad_norm",
    "normalize_advantage",
    "target_kl",
    "use_sde",
    "sde_sample_freq",
)


def continued(archive: Archive, venv: VecEnv) -> OnPolicyAlgorithm:
    """Build a model with the weights, the optimizer and the hyperparameters of a file.

    Args:
        archive: the file of a PPO, A2C or TRPO model with a feed-forward network.
        venv: environment in which the model goes on learning.

    Raises:
        InputError: if the model cannot go on learning, or does not fit the environment.
    """
    path = archive.path
    try:
        policy_class, keywords = policy_recipe(archive)
    except UntrustedError as error:
        raise InputError(f"{path} cannot be trained further without running code from it: {error}") from None
    algorithm: Any = algorithm_of(archive, policy_class)
    accepted = inspect.signature(algorithm).parameters
    settings = {name: archive.numbers[name] for name in _KEPT if name in archive.numbers and name in accepted}
    try:
        model: OnPolicyAlgorithm = algorithm(policy_class, venv, policy_kwargs=keywords, device="cpu", **settings)
        model.policy.load_state_dict(_tensors(archive.weights))
        if archive.optimizer is not None:
            model.policy.optimizer.load_state_dict(_tensors(archive.optimizer))
    except Exception as error:  # torch and Stable-Baselines3 can raise anything for wrong values
        first = str(error).split("\n", maxsplit=1)[0]
        raise InputError(f"{path} cannot be trained further in this environment: {first}") from error
    return model


def algorithm_of(archive: Archive, policy_class: type[Any]) -> type[OnPolicyAlgorithm]:
    """Return the algorithm that trained a model.

    Raises:
        InputError: if it is not PPO, A2C or TRPO with a feed-forward network.
    """
    if issubclass(policy_class, ActorCriticPolicy) and policy_class.__module__.startswith("stable_baselines3."):
        for name, algorithm in _ALGORITHMS.items():
            if name in archive.numbers:
                return algorithm
    raise InputError(
        f"{archive.path} cannot be trained further: its policy is a {policy_class.__name__}, but only models of PPO, "
        "A2C and TRPO with a feed-forward network can go on learning here"
    )


def learning_rate_of(archive: Archive) -> float | None:
    """Return the learning rate of a model's training; None if it was a function."""
    rate = archive.numbers.get("learning_rate")
    return None if rate is None else float(rate)


def sub_environments_of(archive: Archive) -> int:
    """Return the number of sub-environments in a model's training."""
    return max(int(archive.numbers.get("n_envs", 1)), 1)


def _tensors(content: bytes) -> Any:
    return torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
