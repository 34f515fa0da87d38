"""Search for the simplest scenario that still has a property, in passes, as Hypothesis shrinks test cases.

The passes remove parts, make values plain, and round what is left. They are repeated until none of them changes
anything. There is no chance in them, so the result depends only on the scenario and on the property.
"""

from collections.abc import Callable, Sequence
from functools import partial
from itertools import combinations
from math import comb
from typing import Final, NamedTuple, Protocol

from behavexplor.data.scenario import Part, Parts, Size, Value

MOST_SUBSETS: Final = 200  # so many sets of parts are all tried at once; larger scenarios lose their parts one by one
SMALL: Final = 2  # number of parts up to which all sets of parts are tried
DIGITS: Final = (0, 1, 2)  # decimals to which values are rounded

Place = tuple[int, int]  # index of a part, and of a value in it
Unit = tuple[Place, ...]  # values that are changed together


class Property(Protocol):
    """A property of scenarios that minimization keeps."""

    def held_by(self, candidates: Sequence[Parts]) -> Sequence[bool]:
        """Return whether each candidate has the property, as far as executing it once can tell."""

    def kept_by(self, candidate: Parts) -> bool:
        """Return whether a candidate for which `held_by` is true may take the place of the scenario so far."""


class Shrunk(NamedTuple):
    """A minimized scenario."""

    parts: Parts  # its parts
    executions: int  # number of candidates that were executed
    is_minimal: bool  # whether no pass could change it any more; False if the limit of executions was reached before


def shrink(parts: Parts, held: Property, *, removable: bool, limit: int) -> Shrunk:
    """Minimize a scenario, given by its parts, which has the property `held`.

    `removable` says whether a scenario is valid without some of its parts. After `limit` executions, no further
    candidates are executed.
    """
    asked = _Asked(parts, held, limit)
    before = None
    while parts != before:
        before = parts
        if removable:
            parts = _with_fewer_parts(parts, asked)
        parts = _changed(parts, asked, _whole_parts(parts), _made_plain)
        parts = _changed(parts, asked, _single_values(parts), _made_plain)
        for digits in DIGITS:
            parts = _changed(parts, asked, _single_values(parts), partial(_rounded, digits=digits))
    return Shrunk(parts, asked.executions, is_minimal=not asked.is_exhausted)


def size_of(parts: Parts, *, removable: bool) -> Size:
    """Return the size of a scenario."""
    count = len(parts) if removable else sum(part.free > 0 for part in parts)
    return Size(count, sum(part.free for part in parts))


class _Asked:
    """What is known of candidates, each of which is executed once."""

    def __init__(self, parts: Parts, held: Property, limit: int) -> None:
        self._held = held
        self._limit = limit
        self._known = {parts: True}
        self._kept = {parts: True}
        self.is_exhausted = False

    @property
    def executions(self) -> int:
        return len(self._known) - 1

    def held_by(self, candidates: Sequence[Parts]) -> list[bool]:
        """Return whether each candidate has the property; False for a new candidate beyond the limit."""
        new = [candidate for candidate in dict.fromkeys(candidates) if candidate not in self._known]
        left = max(self._limit - self.executions, 0)
        self.is_exhausted |= len(new) > left
        if new[:left]:
            self._known |= zip(new[:left], self._held.held_by(new[:left]), strict=True)
        return [self._known.get(candidate, False) for candidate in candidates]

    def first_kept(self, candidates: Sequence[Parts]) -> Parts | None:
        """Return the first candidate that may take the place of the scenario, or None."""
        held = self.held_by(candidates)
        return next((one for one, is_held in zip(candidates, held, strict=True) if is_held and self._keeps(one)), None)

    def _keeps(self, candidate: Parts) -> bool:
        if candidate not in self._kept:
            self._kept[candidate] = self._held.kept_by(candidate)
        return self._kept[candidate]


def _with_fewer_parts(parts: Parts, asked: _Asked) -> Parts:
    """Return as few of the parts as possible: small sets first, then without one part after the other."""
    for size in range(min(SMALL + 1, len(parts))):
        if comb(len(parts), size) <= MOST_SUBSETS:
            fewer = asked.first_kept(list(combinations(parts, size)))
            if fewer is not None:
                return fewer
    while True:
        fewer = asked.first_kept([parts[:i] + parts[i + 1 :] for i in range(len(parts))])
        if fewer is None:
            return parts
        parts = fewer


def _changed(parts: Parts, asked: _Asked, units: Sequence[Unit], change: Callable[[Value], Value]) -> Parts:
    """Change as many units as possible: all of them, then halves, quarters, and so on down to single units."""
    units = [unit for unit in units if _with(parts, [unit], change) != parts]
    size = len(units)
    while size and units:
        chunks = [units[i : i + size] for i in range(0, len(units), size)]
        held = asked.held_by([_with(parts, chunk, change) for chunk in chunks])
        good = [chunk for chunk, is_held in zip(chunks, held, strict=True) if is_held]
        while good:
            together = [unit for chunk in good for unit in chunk]
            changed = asked.first_kept([_with(parts, together, change)])
            if changed is not None:
                parts, units = changed, [unit for unit in units if unit not in together]
                break
            good = good[: len(good) // 2]
        size //= 2
    return parts


def _with(parts: Parts, units: Sequence[Unit], change: Callable[[Value], Value]) -> Parts:
    """Return parts in which some values are changed."""
    values = [list(part.values) for part in parts]
    for unit in units:
        for i, j in unit:
            values[i][j] = change(values[i][j])
    return tuple(Part(part.label, tuple(new)) for part, new in zip(parts, values, strict=True))


def _whole_parts(parts: Parts) -> list[Unit]:
    return [tuple((i, j) for j in range(len(part.values))) for i, part in enumerate(parts)]


def _single_values(parts: Parts) -> list[Unit]:
    return [((i, j),) for i, part in enumerate(parts) for j in range(len(part.values))]


def _made_plain(_: Value) -> Value:
    return None


def _rounded(value: Value, digits: int) -> Value:
    return round(value, digits) if isinstance(value, float) else value
