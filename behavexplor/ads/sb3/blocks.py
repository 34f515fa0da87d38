"""Evaluation of a network for any number of observations, so that no answer depends on the size of the batch.

On a CPU, the last bits of a function of many numbers depend on their count, and on the position of a number among them.
So a network always receives blocks of equally many rows, padded with zeros, and linear layers multiply rows separately.
A network with other layers, or with code from elsewhere, receives one row at a time. `DenseActor` gives the answers of
small networks faster.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from threading import Lock
from typing import Any, Final, NamedTuple

import gymnasium
import numpy as np
import torch
from stable_baselines3.common.distributions import CategoricalDistribution, DiagGaussianDistribution
from stable_baselines3.common.policies import ActorCriticPolicy, BasePolicy
from stable_baselines3.common.torch_layers import FlattenExtractor, MlpExtractor
from stable_baselines3.dqn.policies import DQNPolicy, QNetwork
from torch import Tensor
from torch.nn.functional import pad

from behavexplor.ads.sb3.drawn_actions import drawn_by
from behavexplor.ads.sb3.layered import LayeredPolicy
from behavexplor.data.array_types import Array, Bools, Floats
from behavexplor.data.observations import Observation, arrays_of, mapped

Memory = tuple[Array, ...]
Choice = Callable[[Tensor], Tensor]  # from the outputs of the layers, shape (B, outputs), to the actions
Operation = Callable[[], object]

ROWS: Final = 64  # rows in a block
ALIGNMENT: Final = 16  # most numbers that a processor multiplies at a time; rows begin at multiples of it
_BYTES: Final = 4 * ALIGNMENT
_KNOWN_CODE: Final = ("torch.", "stable_baselines3.", "sb3_contrib.", "behavexplor.")  # where layers may come from
_LOCK: Final = Lock()  # the blocks of a network hold one question at a time


class BlockwiseNetwork:
    """A policy network that is not trained any further, evaluated block by block.

    Its linear layers multiply each row separately from now on.
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
        self, observation: Observation, memory: Memory | None, episode_start: Bools | None, noise: Floats | None = None
    ) -> tuple[Array, Memory | None]:
        """Return the network's actions, shape (B, ...), and its memory; None if it has none.

        Args:
            observation: arrays of shape (B, ...).
            memory: memory that the last call returned, arrays of shape (layers, B, ...); None at first.
            episode_start: True for each row that begins an episode, shape (B,); None if no row does.
            noise: numbers in [0, 1) by which actions are drawn, shape (B, `noise_of(network)`); None for the most
                probable actions.
        """
        with _LOCK, _one_thread():
            if self._actor is not None and noise is None and isinstance(observation, np.ndarray):
                actions = self._actor.decide(observation)
                if actions is not None:
                    return actions, None
            return self._predict(observation, memory, episode_start, noise)

    def _predict(
        self, observation: Observation, memory: Memory | None, episode_start: Bools | None, noise: Floats | None
    ) -> tuple[Array, Memory | None]:
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
    if not all(type(module).__module__.startswith(_KNOWN_CODE) for module in modules):
        return []
    layers = [module for module in modules if not list(module.children()) and list(module.parameters())]
    linear = [layer for layer in layers if type(layer) is torch.nn.Linear]
    return linear if len(linear) == len(layers) else []


def _stay(mode: bool) -> None:
    """Leave a network in the mode in which it is."""


def _block_of(array: Array, block: slice, rows: int) -> Array:
    return _filled(array[block], rows, 0)


def _filled(array: Array, rows: int, axis: int) -> Array:
    """Pad an array with zeros at its end to a length of `rows` along an axis."""
    shape = [*array.shape]
    count, shape[axis] = shape[axis], rows
    filled = np.zeros(shape, dtype=array.dtype)
    filled[(slice(None),) * axis + (slice(count),)] = array
    return filled


@contextmanager
def _drawing(network: BasePolicy, noise: Floats | None) -> Iterator[None]:
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


@dataclass
class Block:
    """The block of rows that a network is answering."""

    wanted: int = ROWS  # how many rows are wanted, counted from the first. The linear layers return 0 for the others.

    @contextmanager
    def wanting(self, count: int) -> Iterator[None]:
        """Ask for the first rows only."""
        self.wanted = count
        try:
            yield
        finally:
            self.wanted = ROWS


class RowLinear(torch.nn.Linear):
    """A linear layer that multiplies each row separately, with weights that stay as they are."""

    block: Block  # the block that is being answered
    columns: Tensor  # the weights, filled up with zeros, shape (padded inputs, outputs)

    def forward(self, rows: Tensor) -> Tensor:
        """Return the products, shape (..., outputs)."""
        if rows.ndim != 2:
            return super().forward(rows)
        given = rows.shape[0]
        count = self.block.wanted if given == ROWS else given
        products = torch.bmm(self._aligned(rows[:count])[:, None], self.columns.expand(count, -1, -1))[:, 0]
        if self.bias is not None:
            products = products + self.bias
        return products if count == given else pad(products, (0, 0, 0, given - count))

    def _aligned(self, rows: Tensor) -> Tensor:
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
    inputs: Tensor
    outputs: Tensor


class DenseActor:
    """The layers of a policy that lead to its actions, for fast answers without `predict`.

    `predict` checks its arguments, and makes tensors and a distribution, which takes several times as long as a small
    network. The arithmetic here is the same, in the same order and at the same places of a block, so the actions are
    equal to the last bit. Layers with weights are of the class `RowLinear`.
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
        self._output_array = self._outputs.numpy()
        self._operations: dict[int, list[Operation]] = {}  # by number of rows

    def decide(self, observation: Array) -> Array | None:
        """Return the most probable actions, shape (B, ...), for observations of shape (B, ...).

        None if the observations have a wrong shape, or an output is not finite: then `predict` answers or fails in its
        own way.
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

    def _answer(self, rows: Array) -> Array | None:
        count = len(rows)
        with np.errstate(over="ignore"):  # a number beyond single precision becomes infinite
            self._inputs[:count] = rows.reshape(count, -1)
        if count not in self._operations:
            self._operations[count] = [operation for step in self._steps for operation in _operations(step, count)]
        for operation in self._operations[count]:
            operation()
        if not np.isfinite(self._output_array[:count]).all():
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


def _zeros(numbers: int) -> Tensor:
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
    if isinstance(policy, LayeredPolicy):
        return _of_chain(policy)
    if type(policy) is ActorCriticPolicy:
        return _of_distribution(policy)
    return _of_values(policy) if type(policy) is DQNPolicy else None


def _of_chain(policy: LayeredPolicy) -> DenseActor | None:
    layers = policy.chain
    if not layers:
        return None
    is_discrete = isinstance(policy.action_space, gymnasium.spaces.Discrete)
    return DenseActor(layers, _greatest if is_discrete else _mean, policy)


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


def _mean(outputs: Tensor) -> Tensor:
    return outputs


def _most_probable(outputs: Tensor) -> Tensor:
    """Return the most probable category: the first one, if several are equal in single precision.

    The probabilities are those of `torch.distributions.Categorical`.
    """
    return (outputs - outputs.logsumexp(dim=-1, keepdim=True)).softmax(dim=-1).argmax(dim=1)


def _greatest(outputs: Tensor) -> Tensor:
    return outputs.argmax(dim=1)
