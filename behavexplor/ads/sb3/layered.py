"""A policy of plain layers, in the form in which Stable-Baselines3 asks policies for actions."""

from dataclasses import dataclass
from typing import Any

import gymnasium
import torch
from stable_baselines3.common.distributions import CategoricalDistribution, DiagGaussianDistribution, Distribution
from stable_baselines3.common.policies import BasePolicy


@dataclass(frozen=True)
class Parts:
    """The layers of a policy, with the functions between them."""

    trunk: torch.nn.Sequential  # layers that the heads share
    # layers from there to the values of the actions, to their logits, or to the mean of a normal distribution
    head: torch.nn.Sequential
    # layers from there to the value of a dueling network; None for any other one
    value: torch.nn.Sequential | None = None
    # logarithms of the standard deviations, shape (numbers of an action,); None if the policy has none
    log_std: torch.Tensor | None = None
    draws: bool = False  # whether the outputs of the head are logits, so that discrete actions can be drawn


class LayeredPolicy(BasePolicy):
    """A policy of plain layers.

    The action of a `Discrete` space is that of the greatest output; a `Box` gets the outputs themselves or, with
    `squash`, their hyperbolic tangents, scaled to its bounds. `action_dist` is None if actions cannot be drawn.
    """

    def __init__(
        self, observation_space: gymnasium.Space[Any], action_space: gymnasium.Space[Any], parts: Parts, *, squash: bool
    ) -> None:
        super().__init__(observation_space, action_space, squash_output=squash)
        self.trunk, self.head, self.value_head = parts.trunk, parts.head, parts.value
        self.log_std = parts.log_std
        self.action_dist: CategoricalDistribution | DiagGaussianDistribution | None = None
        if isinstance(action_space, gymnasium.spaces.Discrete):
            self.action_dist = CategoricalDistribution(int(action_space.n)) if parts.draws else None
        elif parts.log_std is not None and not squash:
            self.action_dist = DiagGaussianDistribution(len(parts.log_std))

    @property
    def chain(self) -> tuple[torch.nn.Module, ...]:
        """The layers in their order, if they are a single line of dense ones and nothing squashes; none otherwise."""
        layers = (*self.trunk, *self.head)
        is_line = self.value_head is None and not self.squash_output
        return layers if is_line and not any(isinstance(one, torch.nn.Conv2d) for one in layers) else ()

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """Return the outputs, shape (B, n), for observations, shape (B, ...)."""
        shared = self.trunk(observation.float())
        outputs: torch.Tensor = self.head(shared)
        if self.value_head is not None:
            outputs = self.value_head(shared) + (outputs - outputs.mean(dim=1, keepdim=True))
        return outputs

    def get_distribution(self, observation: torch.Tensor) -> Distribution:
        """Return the distribution of the actions. `action_dist` must not be None."""
        distribution: Any = self.action_dist
        given = () if isinstance(distribution, CategoricalDistribution) else (self.log_std,)
        made: Distribution = distribution.proba_distribution(self(observation), *given)
        return made

    def _predict(self, observation: Any, deterministic: bool = False) -> torch.Tensor:  # noqa: ARG002 - `draw` draws
        outputs: torch.Tensor = self(observation)
        if isinstance(self.action_space, gymnasium.spaces.Discrete):
            return outputs.argmax(dim=1)
        return torch.tanh(outputs) if self.squash_output else outputs
