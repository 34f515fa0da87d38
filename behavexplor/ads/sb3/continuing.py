"""Models of Stable-Baselines3 that go on learning, built from a model's file without executing code from it."""

import inspect
import io
import warnings
from collections.abc import Mapping
from typing import Any, Final

import sb3_contrib
import stable_baselines3
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.vec_env import VecEnv

from behavexplor.ads.sb3.archive import Archive
from behavexplor.ads.sb3.building import UntrustedError, policy_recipe
from behavexplor.ads.sb3.inert import Inert
from behavexplor.data.conventions import MOST_ENVS
from behavexplor.errors import InputError

# The file does not name the algorithm. The module of its policy tells DQN and QR-DQN. PPO, A2C and TRPO have the same
# policies, and are told apart by the first of these numbers that the file has.
_BY_POLICY_MODULE: Final[Mapping[str, type[BaseAlgorithm]]] = {
    "stable_baselines3.dqn.policies": stable_baselines3.DQN,
    "sb3_contrib.qrdqn.policies": sb3_contrib.QRDQN,
}
_BY_HYPERPARAMETER: Final[Mapping[str, type[BaseAlgorithm]]] = {
    "cg_max_steps": sb3_contrib.TRPO,
    "n_epochs": stable_baselines3.PPO,
    "gae_lambda": stable_baselines3.A2C,
}
# Hyperparameters that are kept. All others have their defaults; some of them are functions, such as the clipping range.
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
    "buffer_size",
    "learning_starts",
    "tau",
    "gradient_steps",
    "target_update_interval",
    "exploration_final_eps",
    "cg_max_steps",
    "cg_damping",
    "line_search_shrinking_factor",
    "line_search_max_iter",
    "n_critic_updates",
)


def continued(archive: Archive, venv: VecEnv) -> BaseAlgorithm:
    """Build a model that goes on learning, with the weights, the optimizer and most hyperparameters of a file.

    The file is that of a PPO, A2C, TRPO, DQN or QR-DQN model with a feed-forward network. DQN and QR-DQN explore as at
    the end of their training; the file has no replay buffer.

    Raises:
        InputError: if the model cannot go on learning, or does not fit the environment.
    """
    path = archive.path
    try:
        policy_class, keywords = policy_recipe(archive)
    except UntrustedError as error:
        raise InputError(f"{path} cannot be trained further without running code from it: {error}") from None
    algorithm: Any = _algorithm_of(archive, policy_class)
    accepted = inspect.signature(algorithm).parameters
    try:
        settings = {name: value for name, value in _settings(archive).items() if name in accepted}
        if "use_rms_prop" in accepted:
            settings["use_rms_prop"] = False  # if the training used it, it is among the keywords of the policy
        model: BaseAlgorithm = algorithm(policy_class, venv, policy_kwargs=keywords, device="cpu", **settings)
        model.policy.load_state_dict(_tensors(archive.weights))
        if archive.optimizer is None:
            warnings.warn(f"{path} has no state of an optimizer, so a new one trains it further", stacklevel=2)
        else:
            model.policy.optimizer.load_state_dict(_online_only(_tensors(archive.optimizer), model.policy.optimizer))
    except Exception as error:  # torch and Stable-Baselines3 can raise anything for wrong values
        first = str(error).split("\n", maxsplit=1)[0]
        raise InputError(f"{path} cannot be trained further in this environment: {first}") from error
    return model


def _online_only(state: dict[str, Any], optimizer: torch.optim.Optimizer) -> dict[str, Any]:
    """Return a stored state of an optimizer for the parameters of the online network only, as `optimizer` has them.

    Before version 2.4.0, Stable-Baselines3 also gave it those of the target network of a DQN model, after the others.
    """
    (group,) = state["param_groups"]
    expected = len(optimizer.param_groups[0]["params"])
    if len(group["params"]) != 2 * expected:
        return state
    kept = group["params"][:expected]
    moments = {number: values for number, values in state["state"].items() if number in kept}
    return {"state": moments, "param_groups": [{**group, "params": kept}]}


def _algorithm_of(archive: Archive, policy_class: type[Any]) -> type[BaseAlgorithm]:
    """Return the algorithm that trained a model. An InputError says if such models cannot go on learning here."""
    module = policy_class.__module__
    if module in _BY_POLICY_MODULE:
        return _BY_POLICY_MODULE[module]
    if issubclass(policy_class, ActorCriticPolicy) and module.startswith("stable_baselines3."):
        for name, algorithm in _BY_HYPERPARAMETER.items():
            if name in archive.numbers:
                return algorithm
    raise InputError(
        f"{archive.path} cannot be trained further: its policy is a {policy_class.__name__}, but only models of PPO, "
        "A2C, TRPO, DQN and QR-DQN with a feed-forward network can go on learning here"
    )


def learning_rate_of(archive: Archive) -> float | None:
    """Return the learning rate of a model's training; None if it was a function.

    Raises:
        InputError: if it is not between 0 and 1.
    """
    rate = archive.numbers.get("learning_rate")
    if rate is not None and not 0.0 < rate < 1.0:
        raise InputError(f"{archive.path} cannot be trained further: its learning rate is {rate}")
    return rate


def sub_environments_of(archive: Archive) -> int:
    """Return the number of sub-environments in a model's training.

    Raises:
        InputError: if it is no such number.
    """
    count = archive.numbers.get("n_envs", 1)
    if not (isinstance(count, int) and 1 <= count <= MOST_ENVS):
        raise InputError(f"{archive.path} cannot be trained further: it was trained in {count} environments at a time")
    return count


def _settings(archive: Archive) -> dict[str, Any]:
    """Return the hyperparameters of a file that are kept."""
    settings: dict[str, Any] = {name: archive.numbers[name] for name in _KEPT if name in archive.numbers}
    if "exploration_final_eps" in settings:
        settings["exploration_initial_eps"] = settings["exploration_final_eps"]
    frequency = archive.settings.get("train_freq")
    if isinstance(frequency, Inert) and frequency.arguments:
        settings["train_freq"] = _train_frequency(frequency)
    return settings


def _train_frequency(frequency: Inert) -> int | tuple[int, str]:
    """Return how often a model is trained, as Stable-Baselines3 takes it."""
    count, *units = frequency.arguments
    is_named = bool(units) and isinstance(units[0], Inert) and bool(units[0].arguments)
    unit = units[0].arguments[0] if is_named else "step"
    return (int(count), str(unit)) if unit == "episode" else int(count)


def _tensors(content: bytes) -> Any:
    return torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
