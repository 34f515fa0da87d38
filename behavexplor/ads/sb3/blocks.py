"""Evaluation of a network for any number of observations, so that no answer depends on the size of the batch.

On a CPU, the last bits of a matrix product depend on the number of rows and on the position of a row among them. So a
network always receives blocks of the same number of rows, padded with zeros, and its linear layers multiply each row
separately. A network with other layers, or with code from elsewhere, receives one row at a time.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.policies import BasePolicy
from torch.nn.functional import pad

from behavexplor.ads.sb3.drawing_actions import drawn_by
from behavexplor.data.observations import Observation, arrays_of, mapped

ROWS: Final = 64  # rows in a block
ALIGNMENT: Final = 16  # most numbers that a processor multiplies at a time; rows begin at multiples of it

_KNOWN: Final = ("torch.", "stable_baselines3.", "sb3_contrib.")

Memory = tuple[NDArray[Any], ...]


def prepare_blocks(network: BasePolicy) -> int:
    """Prepare a network that is not trained any further, and return the number of rows in its blocks.

    Its linear layers multiply each row separately from now on.
    """
    network.set_training_mode(False)
    network.set_training_mode = _stay  # type: ignore[method-assign] # `predict` visits every layer to set the mode
    modules = list(network.modules())
    layers = [module for module in modules if not list(module.children()) and list(module.parameters())]
    if not all(type(module).__module__.startswith(_KNOWN) for module in modules):
        return 1
    if not all(type(layer) in (torch.nn.Linear, RowLinear) for layer in layers):
        return 1
    for layer in layers:
        layer.__class__ = RowLinear
    return ROWS


def _stay(mode: bool) -> None:
    """Leave a network in the mode in which it is."""


class RowLinear(torch.nn.Linear):
    """A linear layer that multiplies each row separately, with weights that stay as they are."""

    def forward(self, rows: torch.Tensor) -> torch.Tensor:
        """Return the products, shape (..., outputs)."""
        if rows.ndim != 2:
            return super().forward(rows)
        missing = -self.in_features % ALIGNMENT
        if not hasattr(self, "padded"):
            self.padded = pad(self.weight.detach(), (0, missing)).t()
        products = torch.bmm(pad(rows, (0, missing))[:, None], self.padded.expand(len(rows), -1, -1))[:, 0]
        return products if self.bias is None else products + self.bias


def ask_in_blocks(
    network: BasePolicy,
    rows: int,
    observation: Observation,
    memory: Memory | None,
    episode_start: NDArray[np.bool_] | None,
    noise: NDArray[np.float64] | None = None,
) -> tuple[NDArray[Any], Memory | None]:
    """Call `network.predict` block by block.

    Args:
        network: policy network of Stable-Baselines3.
        rows: number of rows in a block, see `prepare_blocks`.
        observation: observations, arrays of shape (B, ...).
        memory: memory returned by the last call, arrays of shape (layers, B, ...); None at first.
        episode_start: True for each row that begins an episode, shape (B,); None if no row does.
        noise: numbers in [0, 1) by which actions are drawn, shape (B, n), see `behavexplor.ads.sb3.drawing_actions`;
            None for the most probable actions.

    Returns:
        The actions, shape (B, ...), and the memory. The memory is None if the network has none.
    """
    count = len(arrays_of(observation)[0])
    start = np.zeros(count, dtype=bool) if episode_start is None else np.asarray(episode_start, dtype=bool)
    answers = []
    with _one_thread():
        for begin in range(0, count, rows):
            block = slice(begin, begin + rows)
            remembered = None if memory is None else tuple(_filled(array[:, block], rows, 1) for array in memory)
            shown = mapped(partial(_block_of, block=block, rows=rows), observation)
            with _drawing(network, None if noise is None else _filled(noise[block], rows, 0)):
                answers.append(network.predict(shown, remembered, _filled(start[block], rows, 0), deterministic=True))
    actions = np.concatenate([action for action, _ in answers])[:count]
    memories: list[Memory | None] = [own for _, own in answers]
    if any(own is None for own in memories):
        return actions, None
    together = zip(*(own for own in memories if own is not None), strict=True)
    return actions, tuple(np.concatenate(arrays, axis=1)[:, :count] for arrays in together)


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
