"""Evaluation of a network for any number of observations, so that no answer depends on the size of the batch.

On a CPU, the last bits of a function of many numbers depend on their count, and on the position of a number among them.
So a network always receives blocks of the same number of rows, padded with zeros, and its linear layers multiply each
row separately. A network with other layers, or with code from elsewhere, receives one row at a time.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from threading import Lock
from typing import Any, Final

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.policies import BasePolicy

from behavexplor.ads.sb3.dense_actor import ROWS, Block, dense_actor, multiply_rows_separately
from behavexplor.data.observations import Observation, arrays_of, mapped

_EDGE: Final = 1e-7  # least distance of a share from 0 and 1, where the quantiles of a normal distribution are infinite
_DISTRIBUTIONS: Final = frozenset(  # distributions of Stable-Baselines3 and sb3-contrib
    {
        "CategoricalDistribution",
        "MaskableCategoricalDistribution",
        "MultiCategoricalDistribution",
        "BernoulliDistribution",
        "DiagGaussianDistribution",
    }
)

Tensor = torch.Tensor
_KNOWN: Final = ("torch.", "stable_baselines3.", "sb3_contrib.")
_LOCK: Final = Lock()  # the blocks of a network hold one question at a time
Memory = tuple[NDArray[Any], ...]


def noise_of(network: BasePolicy) -> int:
    """Return how many random numbers an action needs; 0 if the policy has no distribution that is known here."""
    policy: Any = network
    if _is_squashed(policy):
        return 0 if policy.actor.use_sde else _numbers(policy.action_space)
    is_known = type(getattr(policy, "action_dist", None)).__name__ in _DISTRIBUTIONS
    return _numbers(policy.action_space) if is_known and hasattr(policy, "get_distribution") else 0


def drawn_by(network: BasePolicy, noise: NDArray[np.float64]) -> Callable[..., Any]:
    """Return a replacement for `network._predict` that draws its actions.

    Args:
        network: the policy network.
        noise: numbers in [0, 1), shape (B, `noise_of(network)`).
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


def _numbers(space: gymnasium.Space[Any]) -> int:
    return int(np.prod(space.shape or (1,)))


class BlockwiseNetwork:
    """A policy network that is not trained any further, evaluated block by block.

    Args:
        network: policy network of Stable-Baselines3. Its linear layers multiply each row separately from now on.
    """

    def __init__(self, network: BasePolicy) -> None:
        network.set_training_mode(False)
        network.set_training_mode = _stay  # type: ignore[method-assign] # `predict` visits every layer to set the mode
        self._network = network
        self._block = Block()
        layers = _linear_layers(network)
        self._rows = ROWS if layers else 1
        for layer in layers:
            multiply_rows_separately(layer, self._block)
        self._actor = dense_actor(network) if layers else None

    def ask(
        self,
        observation: Observation,
        memory: Memory | None,
        episode_start: NDArray[np.bool_] | None,
        noise: NDArray[np.float64] | None = None,
    ) -> tuple[NDArray[Any], Memory | None]:
        """Return the network's actions.

        Args:
            observation: observations, arrays of shape (B, ...).
            memory: memory returned by the last call, arrays of shape (layers, B, ...); None at first.
            episode_start: True for each row that begins an episode, shape (B,); None if no row does.
            noise: numbers in [0, 1) by which actions are drawn, shape (B, n), see
                `behavexplor.ads.sb3.blocks`; None for the most probable actions.

        Returns:
            The actions, shape (B, ...), and the memory. The memory is None if the network has none.
        """
        with _LOCK, _one_thread():
            if self._actor is not None and noise is None and isinstance(observation, np.ndarray):
                actions = self._actor.decide(observation)
                if actions is not None:
                    return actions, None
            return self._predict(observation, memory, episode_start, noise)

    def _predict(
        self,
        observation: Observation,
        memory: Memory | None,
        episode_start: NDArray[np.bool_] | None,
        noise: NDArray[np.float64] | None,
    ) -> tuple[NDArray[Any], Memory | None]:
        """Call the network's `predict` for each block."""
        count, rows = len(arrays_of(observation)[0]), self._rows
        start = np.zeros(count, dtype=bool) if episode_start is None else np.asarray(episode_start, dtype=bool)
        answers = []
        for begin in range(0, count, rows):
            block = slice(begin, begin + rows)
            remembered = None if memory is None else tuple(_filled(array[:, block], rows, 1) for array in memory)
            shown = mapped(partial(_block_of, block=block, rows=rows), observation)
            begins = _filled(start[block], rows, 0)
            drawing = _drawing(self._network, None if noise is None else _filled(noise[block], rows, 0))
            with drawing, self._block.wanting(min(rows, count - begin)):
                answers.append(self._network.predict(shown, remembered, begins, deterministic=True))
        actions = np.concatenate([action for action, _ in answers])[:count]
        memories: list[Memory | None] = [own for _, own in answers]
        if any(own is None for own in memories):
            return actions, None
        together = zip(*(own for own in memories if own is not None), strict=True)
        return actions, tuple(np.concatenate(arrays, axis=1)[:, :count] for arrays in together)


def _linear_layers(network: BasePolicy) -> list[torch.nn.Linear]:
    """Return the layers with weights; none if one of them is not linear, or the network has code from elsewhere."""
    modules = list(network.modules())
    if not all(type(module).__module__.startswith(_KNOWN) for module in modules):
        return []
    layers = [module for module in modules if not list(module.children()) and list(module.parameters())]
    linear = [layer for layer in layers if type(layer) is torch.nn.Linear]
    return linear if len(linear) == len(layers) else []


def _stay(mode: bool) -> None:
    """Leave a network in the mode in which it is."""


def _block_of(array: NDArray[Any], block: slice, rows: int) -> NDArray[Any]:
    return _filled(array[block], rows, 0)


def _filled(array: NDArray[Any], rows: int, axis: int) -> NDArray[Any]:
    """Pad an array with zeros at its end to a length of `rows` along an axis."""
    shape = [*array.shape]
    count, shape[axis] = shape[axis], rows
    filled = np.zeros(shape, dtype=array.dtype)
    filled[(slice(None),) * axis + (slice(count),)] = array
    return filled


@contextmanager
def _drawing(network: BasePolicy, noise: NDArray[np.float64] | None) -> Iterator[None]:
    """Let a network draw its actions; `predict` then scales and clips them as always."""
    if noise is None:
        yield
        return
    network._predict = drawn_by(network, noise)  # type: ignore[method-assign] # noqa: SLF001 - its documented hook
    try:
        yield
    finally:
        del network._predict  # noqa: SLF001


@contextmanager
def _one_thread() -> Iterator[None]:
    """Restrict torch to one thread: the distribution of rows over several threads changes the last bits, too."""
    before = torch.get_num_threads()
    if before != 1:
        torch.set_num_threads(1)
    try:
        yield
    finally:
        if before != 1:
            torch.set_num_threads(before)
