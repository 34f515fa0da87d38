"""The states of many behaviors in bounded memory."""

import os
import tempfile
import weakref
from collections.abc import Iterator
from contextlib import suppress
from typing import IO, Final

import numpy as np
from numpy.typing import NDArray

from behavexplor.behavior.features import ATTRIBUTES

States = NDArray[np.float32]

IN_MEMORY: Final = 16 * 2**20  # greatest size of states in memory [bytes]: about 1700 behaviors of 30 s


class StateFile:
    """The states of behaviors in the order of their addition. Iteration yields them one by one.

    They are in memory up to `IN_MEMORY` bytes, and beyond in a file of the temporary folder. The file has no name where
    the system permits, so that it never outlives the process.
    """

    def __init__(self, in_memory: int = IN_MEMORY) -> None:
        self._lengths: list[int] = []
        self._file: IO[bytes] = tempfile.SpooledTemporaryFile(in_memory)  # noqa: SIM115 - closed with this object
        weakref.finalize(self, _close, self._file)

    def __len__(self) -> int:
        return len(self._lengths)

    def append(self, states: States) -> None:
        """Add the states of a behavior, shape (N', 8).

        Raises:
            OSError: if the file cannot be written, for example because the disk is full; it names the folder.
        """
        try:
            self._file.seek(0, os.SEEK_END)
            self._file.write(states.tobytes())
        except OSError as error:
            raise OSError(error.errno, error.strerror, tempfile.gettempdir()) from error
        self._lengths.append(len(states))

    def __iter__(self) -> Iterator[States]:
        width = len(ATTRIBUTES)
        self._file.seek(0)
        for length in self._lengths:
            data = self._file.read(length * width * np.dtype(np.float32).itemsize)
            yield np.frombuffer(data, dtype=np.float32).reshape(length, width)


def _close(file: IO[bytes]) -> None:
    with suppress(OSError):  # what could not be written is not needed any more
        file.close()
