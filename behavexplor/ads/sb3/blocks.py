"""Evaluation of a network for any number of observations, so that no answer depends on the size of the batch.

On a CPU, the last bits of a matrix product depend on the number of rows and on the position of a row among them. So a
network always receives blocks of the same number of rows, padded with zeros, and its linear layers multiply each row
separately. A network with other layers receives one row at a time.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.policies import BasePolicy
from torch.nn.functional import linear, pad
from torch.overrides import TorchFunctionMode

from behavexplor.data.observations import Observation, arrays_of, mapped

ROWS: Final = 64  # rows in a block
ALIGNMENT: Final = 16  # most numbers that a processor multiplies at a time; rows begin at multiples of it

Memory = tuple[NDArray[Any], ...]


def ask_in_blocks(
    network: BasePolicy,
    observation: Observation,
    memory: Memory | None,
    episode_start: NDArray[np.bool_] | None,
    deterministic: bool,
) -> tuple[NDArray[Any], Memory | None]:
    """Call `network.predict` block by block.

    Args:
        network: policy network of Stable-Baselines3.
        observation: observations, arrays of shape (B, ...).
        memory: memory returned by the last call, arrays of shape (layers, B, ...); None at first.
        episode_start: True for each row that begins an episode, shape (B,); None if no row does.
        deterministic: see `predict` of Stable-Baselines3.

    Returns:
        The actions, shape (B, ...), and the memory. The memory is None if the network has none.
    """
    count = len(arrays_of(observation)[0])
    rows = ROWS if _is_linear(network) else 1
    start = np.zeros(count, dtype=bool) if episode_start is None else np.asarray(episode_start, dtype=bool)
    answers = []
    with _one_thread(), _RowByRow():
        for begin in range(0, count, rows):
            block = slice(begin, begin + rows)
            remembered = None if memory is None else tuple(_filled(array[:, block], rows, 1) for array in memory)
            shown = mapped(partial(_block_of, block=block, rows=rows), observation)
            answers.append(network.predict(shown, remembered, _filled(start[block], rows, 0), deterministic))
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
    missing = [(0, 0)] * array.ndim
    missing[axis] = (0, rows - array.shape[axis])
    return np.pad(array, missing)


def _is_linear(network: torch.nn.Module) -> bool:
    """Return whether only linear layers have weights."""
    layers = [module for module in network.modules() if not list(module.children())]
    return all(isinstance(layer, torch.nn.Linear) or not list(layer.parameters()) for layer in layers)


class _RowByRow(TorchFunctionMode):
    """A mode of torch in which linear layers multiply each row separately."""

    def __torch_function__(
        self, func: Any, types: Any, args: tuple[Any, ...] = (), kwargs: dict[str, Any] | None = None
    ) -> Any:
        by_rows = func is linear and not kwargs and args[0].ndim == 2
        return _linear(*args) if by_rows else func(*args, **(kwargs or {}))


def _linear(rows: torch.Tensor, weight: torch.Tensor, bias: torch.Tensor | None = None) -> torch.Tensor:
    missing = -rows.shape[1] % ALIGNMENT
    rows, weight = pad(rows, (0, missing)), pad(weight, (0, missing))
    products = torch.bmm(rows[:, None], weight.t().expand(len(rows), -1, -1))[:, 0]
    return products if bias is None else products + bias


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
