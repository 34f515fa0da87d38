"""Actions that a policy draws by given random numbers, so that they do not depend on the other rows of a batch."""

from collections.abc import Callable
from typing import Any, Final

import gymnasium
import numpy as np
import torch
from stable_baselines3.common.policies import BasePolicy
from torch import Tensor

from behavexplor.data.array_types import Floats

_EDGE: Final = 1e-7  # least distance of a share from 0 and 1, where the quantiles of a normal distribution are infinite
_KNOWN_DISTRIBUTIONS: Final = frozenset(  # of Stable-Baselines3 and sb3-contrib
    {
        "CategoricalDistribution",
        "MaskableCategoricalDistribution",
        "MultiCategoricalDistribution",
        "BernoulliDistribution",
        "DiagGaussianDistribution",
    }
)


def noise_of(network: BasePolicy) -> int:
    """Return how many random numbers an action needs; 0 if the policy has no distribution that is known here."""
    policy: Any = network
    if _is_squashed(policy):
        return 0 if policy.actor.use_sde else _action_size(policy.action_space)
    is_known = type(getattr(policy, "action_dist", None)).__name__ in _KNOWN_DISTRIBUTIONS
    return _action_size(policy.action_space) if is_known and hasattr(policy, "get_distribution") else 0


def drawn_by(network: BasePolicy, noise: Floats) -> Callable[..., Any]:
    """Return a replacement for `network._predict` that draws by numbers in [0, 1), shape (B, `noise_of(network)`).

    Each number of an action is the quantile of its distribution at one of them. Torch's own generator would draw
    numbers that depend on the other rows of a batch.
    """
    shares = torch.as_tensor(noise, dtype=torch.float32)
    policy: Any = network
    if _is_squashed(policy):
        return lambda observation, *_, **__: _squashed(policy, observation, shares)
    if hasattr(policy, "lstm_actor"):
        return lambda *given, **named: _recurrent(policy, shares, *given, **named)
    return lambda observation, *_, **__: _sampled(policy.get_distribution(observation), shares)


def _is_squashed(policy: Any) -> bool:
    """Return whether actions are a squashed normal distribution, as in SAC, TQC and CrossQ."""
    return hasattr(getattr(policy, "actor", None), "get_action_dist_params")


def _squashed(network: Any, observation: Any, shares: Tensor) -> Tensor:
    mean, log_deviation, _ = network.actor.get_action_dist_params(observation)
    return torch.tanh(mean + torch.exp(log_deviation) * _normal(shares).reshape(mean.shape))


def _recurrent(
    network: Any, shares: Tensor, observation: Any, lstm_states: Any, episode_starts: Tensor, *_: Any, **__: Any
) -> tuple[Tensor, Any]:
    distribution, states = network.get_distribution(observation, lstm_states, episode_starts)
    return _sampled(distribution, shares), states


def _sampled(distribution: Any, shares: Tensor) -> Tensor:
    """Return the actions at the given shares of a distribution."""
    parts = distribution.distribution
    if isinstance(parts, list):
        return torch.stack([_category(part, shares[:, i]) for i, part in enumerate(parts)], dim=1)
    if isinstance(parts, torch.distributions.Categorical):
        return _category(parts, shares[:, 0])
    if isinstance(parts, torch.distributions.Bernoulli):
        return (shares < parts.probs).float()
    drawn: Tensor = parts.mean + parts.stddev * _normal(shares).reshape(parts.mean.shape)
    return drawn


def _category(distribution: torch.distributions.Categorical, shares: Tensor) -> Tensor:
    """Return the category in which each share of the cumulative probabilities lies, shape (B,)."""
    passed: Tensor = distribution.probs.cumsum(dim=1) <= shares[:, None]
    return passed.sum(dim=1).clamp(max=distribution.probs.shape[1] - 1)


def _normal(shares: Tensor) -> Tensor:
    quantiles: Tensor = torch.special.ndtri(shares.clamp(_EDGE, 1 - _EDGE))
    return quantiles


def _action_size(space: gymnasium.Space[Any]) -> int:
    return int(np.prod(space.shape or (1,)))
