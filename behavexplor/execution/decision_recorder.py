"""Recording of what an ADS logs of its decisions."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behavexplor.data.array_types import Floats
from behavexplor.data.trace import Trace
from behavexplor.errors import place_of
from behavexplor.execution.executor import ADSError

_LEAST_ROOM: Final = 64  # rows


class DecisionRecorder:
    """Records what an ADS logs of its decisions, in B episodes in lock-step. Without a method `log`, that is nothing.

    Args:
        ads: driving system, see `behavexplor.ads.interface.DecisionLog`.
        count: number B of episodes.
    """

    def __init__(self, ads: Any, count: int) -> None:
        self._ads = ads if callable(getattr(ads, "log", None)) else None  # else, it is something of the ADS's own
        self._columns: dict[str, Floats] | None = None  # by name, shape (rows, B, ...), a row for each step
        self._rows = 0  # number of rows in use
        self._room = 0  # number of rows for which there is room
        self._begins = np.zeros(count, dtype=np.int64)  # first row of each episode
        self._oldest = 0  # first row of the running episode that began first

    def begin(self, slots: NDArray[np.bool_], running: NDArray[np.bool_]) -> None:
        """Begin episodes.

        Args:
            slots: True for each episode that begins, shape (B,).
            running: True for each episode that runs, including the new ones, shape (B,).
        """
        if slots[running].all():  # no older episode goes on, and these may have other names and shapes
            self._columns, self._rows, self._room = None, 0, 0
        self._begins[slots] = self._rows
        self._oldest = int(self._begins[running].min())

    def add(self, state: Any) -> None:
        """Add the latest decisions.

        Args:
            state: state that `predict` returned.

        Raises:
            ADSError: if the ADS raises an exception, or returns something else than
                `behavexplor.ads.interface.DecisionLog` says.
        """
        if self._ads is None:
            return
        try:
            latest = {name: np.asarray(values) for name, values in self._ads.log(state).items()}
        except Exception as error:
            raise ADSError("raised", f"log(state) must return arrays by name: {error}", place_of(error)) from error
        self._append(latest)

    def completed(self, trace: Trace, slot: int) -> Trace:
        """Return the trace of an episode that has ended, with its decisions, arrays of shape (D, ...).

        Args:
            trace: trace without decisions.
            slot: index of the episode.

        Raises:
            InputError: if a logged number is not finite.
        """
        if not self._columns:
            return trace
        first, end = self._begins[slot], self._rows
        return trace.with_decisions({name: column[first:end, slot] for name, column in self._columns.items()})

    def _append(self, latest: Mapping[str, NDArray[Any]]) -> None:
        if self._columns is None:
            count = len(self._begins)
            self._columns = {name: np.empty((0, count, *values.shape[1:])) for name, values in latest.items()}
        if latest.keys() != self._columns.keys():
            names = f"first {list(self._columns)}, now {list(latest)}"
            raise ADSError("raised", f"log(state) must return the same names at every decision: {names}")
        if self._rows == self._room:
            self._columns = self._with_room(self._columns)
        for name, values in latest.items():
            row = self._columns[name][self._rows]
            if values.shape != row.shape or values.dtype.kind not in "biuf":
                wanted = f"numbers of shape {row.shape} as {name!r}"
                raise ADSError("raised", f"log(state) must return {wanted}, got {values.dtype} of shape {values.shape}")
            row[:] = values
        self._rows += 1

    def _with_room(self, columns: Mapping[str, Floats]) -> dict[str, Floats]:
        """Return columns without the rows from before the running episodes, and with room for more."""
        kept = slice(self._oldest, self._rows)
        self._begins -= self._oldest
        self._rows -= self._oldest
        self._oldest = 0
        self._room = max(_LEAST_ROOM, 2 * self._rows)
        roomy = {name: np.empty((self._room, *column.shape[1:])) for name, column in columns.items()}
        for name, column in columns.items():
            roomy[name][: self._rows] = column[kept]
        return roomy
