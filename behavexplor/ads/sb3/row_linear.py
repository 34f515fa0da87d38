"""Linear layers whose answer to a row does not depend on the other rows.

On a CPU, the last bits of a matrix product depend on the number of rows and on the position of a row among them.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final

import torch
from torch.nn.functional import pad

ROWS: Final = 64  # rows in a block
ALIGNMENT: Final = 16  # most numbers that a processor multiplies at a time; rows begin at multiples of it
_BYTES: Final = 4 * ALIGNMENT


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
