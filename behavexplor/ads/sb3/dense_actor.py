"""Fast deterministic answers of policies whose layers are dense, without calling `predict`.

For each call, `predict` of Stable-Baselines3 checks its arguments, and makes tensors and a distribution. This takes
several times as long as the layers of a small network. The arithmetic here is that of `predict`, in the same order and
at the same places of a block, so the actions are equal to the last bit.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, NamedTuple

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.distributions import CategoricalDistribution, DiagGaussianDistribution
from stable_baselines3.common.policies import ActorCriticPolicy, BasePolicy
from stable_baselines3.common.torch_layers import FlattenExtractor, MlpExtractor
from stable_baselines3.dqn.policies import DQNPolicy, QNetwork
from torch.nn.functional import pad

ROWS: Final = 64  # rows in a block
ALIGNMENT: Final = 16  # most numbers that a processor multiplies at a time; rows begin at multiples of it
_BYTES: Final = 4 * ALIGNMENT
Choice = Callable[[torch.Tensor], torch.Tensor]  # from the outputs of the layers, shape (B, outputs), to the actions
Operation = Callable[[], object]


@dataclass
class Block:
    """The block of rows that a network is answering.

    Attributes:
        wanted: how many rows are wanted, counted from the first. The linear layers return 0 for the others.
    """

    wanted: int = ROWS

    @contextmanager
    def wanting(self, count: int) -> Iterator[None]:
        """Ask for the first rows only."""
        self.wanted = count
        try:
            yield
        finally:
            self.wanted = ROWS


class RowLinear(torch.nn.Linear):
    """A linear layer that multiplies each row separately, with weights that stay as they are.

    Attributes:
        block: the block that is being answered.
        columns: the weights, filled up with zeros, shape (padded inputs, outputs).
    """

    block: Block
    columns: torch.Tensor

    def forward(self, rows: torch.Tensor) -> torch.Tensor:
        """Return the products, shape (..., outputs)."""
        if rows.ndim != 2:
            return super().forward(rows)
        given = rows.shape[0]
        count = self.block.wanted if given == ROWS else given
        products = torch.bmm(self._aligned(rows[:count])[:, None], self.columns.expand(count, -1, -1))[:, 0]
        if self.bias is not None:
            products = products + self.bias
        return products if count == given else pad(products, (0, 0, 0, given - count))

    def _aligned(self, rows: torch.Tensor) -> torch.Tensor:
        """Return rows that begin at multiples of `ALIGNMENT` numbers in memory, filled up with zeros."""
        missing = -self.in_features % ALIGNMENT
        if missing or not rows.is_contiguous() or rows.data_ptr() % _BYTES:
            return pad(rows, (0, missing))
        return rows


def multiply_rows_separately(layer: torch.nn.Linear, block: Block) -> None:
    """Let a linear layer multiply each row separately from now on, and of a block only the wanted rows."""
    layer.__class__ = RowLinear
    layer.block = block  # type: ignore[assignment] # attributes of its new class
    layer.columns = pad(layer.weight.detach(), (0, -layer.in_features % ALIGNMENT)).t()


class _Step(NamedTuple):
    """A layer with the block that it reads and the block that it fills, each of shape (ROWS, numbers)."""

    layer: torch.nn.Module
    inputs: torch.Tensor
    outputs: torch.Tensor


class DenseActor:
    """The layers of a policy that lead to its actions.

    Args:
        layers: the layers, in their order. Those with weights are of the class `RowLinear`.
        choice: choice of the actions.
        policy: the policy, for its observation and action spaces.
    """

    def __init__(self, layers: Sequence[torch.nn.Module], choice: Choice, policy: BasePolicy) -> None:
        self._recipe = layers, choice, policy
        self._steps = _steps(layers)
        self._choice = choice
        space = policy.action_space
        self._action_shape = space.shape or ()
        self._bounds = (space.low, space.high) if isinstance(space, gymnasium.spaces.Box) else None
        self._shape = policy.observation_space.shape
        self._inputs = self._steps[0].inputs[:, : int(np.prod(self._shape or ()))].numpy()
        self._outputs = self._steps[-1].outputs
        self._numbers = self._outputs.numpy()
        self._operations: dict[int, list[Operation]] = {}  # by number of rows

    def decide(self, observation: NDArray[Any]) -> NDArray[Any] | None:
        """Choose the most probable actions.

        Args:
            observation: observations, shape (B, ...).

        Returns:
            The actions, shape (B, ...). None if the observations have a wrong shape, or an output is not finite: then
            `predict` answers or fails in its own way.
        """
        if observation.shape[1:] != self._shape:
            return None
        blocks = [observation[begin : begin + ROWS] for begin in range(0, len(observation), ROWS)]
        answers = [answer for block in blocks if (answer := self._answer(block)) is not None]
        if len(answers) < len(blocks):
            return None
        actions = np.concatenate(answers).reshape(-1, *self._action_shape)
        return actions if self._bounds is None else np.minimum(np.maximum(actions, self._bounds[0]), self._bounds[1])

    def __reduce__(self) -> tuple[Any, ...]:
        return DenseActor, self._recipe  # the steps share memory, which copies would not

    def _answer(self, rows: NDArray[Any]) -> NDArray[Any] | None:
        count = len(rows)
        with np.errstate(over="ignore"):  # a number beyond single precision becomes infinite
            self._inputs[:count] = rows.reshape(count, -1)
        if count not in self._operations:
            self._operations[count] = [operation for step in self._steps for operation in _operations(step, count)]
        for operation in self._operations[count]:
            operation()
        if not np.isfinite(self._numbers[:count]).all():
            return None
        return self._choice(self._outputs).numpy()[:count].copy()  # the next call fills the same block


def _steps(layers: Sequence[torch.nn.Module]) -> list[_Step]:
    """Return the steps from the inputs to the outputs, with blocks that are used again in each call."""
    first = next(layer for layer in layers if isinstance(layer, RowLinear))
    steps, block = [], _zeros(first.columns.shape[0])
    for layer in layers:
        if not isinstance(layer, RowLinear):
            steps.append(_Step(layer, block, block))
            continue
        padded = layer.columns.shape[0]
        if block.shape[1] != padded:
            before, block = block, _zeros(padded)
            steps.append(_Step(torch.nn.Identity(), before, block[:, : layer.in_features]))
        steps.append(_Step(layer, block, _zeros(layer.out_features)))
        block = steps[-1].outputs
    return steps


def _zeros(numbers: int) -> torch.Tensor:
    return torch.zeros(ROWS, numbers, device="cpu")


def _operations(step: _Step, count: int) -> list[Operation]:
    """Return the operations of a step. A linear layer multiplies the first `count` rows only."""
    layer, inputs, outputs = step
    if not isinstance(layer, RowLinear):
        return [lambda: outputs.copy_(layer.forward(inputs))]
    products = outputs[:count]
    columns = layer.columns.expand(count, -1, -1)
    operations: list[Operation] = [partial(torch.bmm, inputs[:count, None], columns, out=products[:, None])]
    if layer.bias is not None:
        operations.append(partial(products.add_, layer.bias.detach()))
    return operations


def dense_actor(policy: BasePolicy) -> DenseActor | None:
    """Return the dense actor of a policy whose linear layers are of the class `RowLinear`; None for any other policy.

    PPO, A2C, TRPO and DQN make policies of this form by default.
    """
    space = policy.observation_space
    if not isinstance(space, gymnasium.spaces.Box) or space.dtype.kind != "f":
        return None
    if policy.squash_output or policy.device.type != "cpu":
        return None
    if type(policy) is ActorCriticPolicy:
        return _of_distribution(policy)
    return _of_values(policy) if type(policy) is DQNPolicy else None


def _of_distribution(policy: ActorCriticPolicy) -> DenseActor | None:
    is_flat = type(policy.pi_features_extractor) is FlattenExtractor and type(policy.mlp_extractor) is MlpExtractor
    layers = (*policy.mlp_extractor.policy_net, policy.action_net) if is_flat else ()
    if type(policy.action_dist) is CategoricalDistribution and layers:
        return DenseActor(layers, _most_probable, policy)
    if type(policy.action_dist) is DiagGaussianDistribution and layers and bool((policy.log_std.exp() > 0).all()):
        return DenseActor(layers, _mean, policy)
    return None  # any other distribution, or a normal one without a valid deviation, of which `predict` complains


def _of_values(policy: DQNPolicy) -> DenseActor | None:
    network = policy.q_net
    if type(network) is not QNetwork or type(network.features_extractor) is not FlattenExtractor:
        return None
    return DenseActor(tuple(network.q_net), _greatest, policy)


def _mean(outputs: torch.Tensor) -> torch.Tensor:
    return outputs


def _most_probable(outputs: torch.Tensor) -> torch.Tensor:
    """Return the most probable category: the first one, if several are equal in single precision.

    The probabilities are those of `torch.distributions.Categorical`.
    """
    return (outputs - outputs.logsumexp(dim=-1, keepdim=True)).softmax(dim=-1).argmax(dim=1)


def _greatest(outputs: torch.Tensor) -> torch.Tensor:
    return outputs.argmax(dim=1)
