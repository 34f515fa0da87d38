"""Distance between two behaviors, given as abstract traces (paper section 3.2.1, equation 9)."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

Labels = NDArray[np.uint8]  # an abstract trace: one abstract state (cluster) per window
Floats = NDArray[np.float64]

MAX_CLUSTERS: Final = 250
_END, _BEYOND = 255, 254  # padding of rows and of queries after their last state; no cluster has these numbers
_WORD = 8  # states compared at once


class AbstractTraces:
    """Abstract traces in one padded matrix of bytes, so that the distances to all of them are computed in one pass."""

    def __init__(self) -> None:
        self._rows = np.full((16, _WORD), _END, dtype=np.uint8)
        self._lengths = np.zeros(16, dtype=np.int64)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def append(self, labels: Labels) -> None:
        """Add an abstract trace, shape (length,)."""
        if self._count == len(self._rows):
            self._grow(2 * len(self._rows), self._rows.shape[1])
        if len(labels) > self._rows.shape[1]:
            self._grow(len(self._rows), _words(len(labels)) * _WORD)
        self._count += 1
        self[self._count - 1] = labels

    def __setitem__(self, index: int, labels: Labels) -> None:
        """Replace an abstract trace by one that is not longer than the longest."""
        self._rows[index] = _END
        self._rows[index, : len(labels)] = labels
        self._lengths[index] = len(labels)

    def __getitem__(self, index: int) -> Labels:
        return self._rows[index, : self._lengths[index]]

    def distances(self, labels: Labels) -> Floats:
        """Compute the distance of an abstract trace from each of these, `dis` of the paper's equation 9.

        (Hamming distance over the common part + difference of the lengths) / the longer length, in [0, 1].

        Args:
            labels: abstract trace, shape (length,).

        Returns:
            Distances, shape (len(self),). The distance of two empty traces is 0.
        """
        length, width = len(labels), min(_words(len(labels)) * _WORD, self._rows.shape[1])
        query = np.full(width, _BEYOND, dtype=np.uint8)
        query[:length] = labels[:width]
        unequal = self._rows[: self._count, :width] != query
        differing = np.bitwise_count(unequal.view(np.uint64)).sum(1, dtype=np.int64)  # padding differs as well
        lengths = self._lengths[: self._count]
        differing += length - width + np.maximum(lengths - length, 0)
        return np.asarray(differing / np.maximum(np.maximum(lengths, length), 1))

    def _grow(self, rows: int, width: int) -> None:
        bigger = np.full((rows, width), _END, dtype=np.uint8)
        bigger[: self._count, : self._rows.shape[1]] = self._rows[: self._count]
        self._lengths = np.concatenate([self._lengths, np.zeros(rows - len(self._lengths), dtype=np.int64)])
        self._rows = bigger


def _words(length: int) -> int:
    return -(-length // _WORD)
