"""Shared part of all methods that search vectors: candidate numbers, draws, no scenario twice, and objectives."""

import numpy as np
from threadpoolctl import threadpool_limits

from behavexplor.data.array_types import Floats
from behavexplor.data.scenario import LogicalScenario, Scenario
from behavexplor.errors import InputError
from behavexplor.fuzz.search import Candidate, draws
from behavexplor.judge.specs import Verdict

_ATTEMPTS = 1000
_APART = 1e-3  # e of `objectives` [m]


class Asker:
    """Vector search: makes candidates from vectors, and remembers the vectors in flight.

    Executing a scenario twice teaches nothing. If a method makes a scenario that it asked for before, such as a copy of
    a parent, one of its NPCs is redrawn.
    """

    def __init__(self, logical: LogicalScenario, seed: int) -> None:
        self.encoding = logical.encoding
        self._seed = seed
        self._number = 0
        self._asked: set[Scenario] = set()
        self._in_flight: dict[int, Floats] = {}
        self._vectors: list[Floats] = []

    @property
    def asked(self) -> int:
        """Number of candidates so far."""
        return self._number

    def draws(self) -> np.random.Generator:
        """Return the random generator of the next candidate."""
        return draws(self._seed, self._number)

    def uniform(self, rng: np.random.Generator, count: int = 1) -> Floats:
        """Draw uniform points, shape (count, n)."""
        return rng.random((count, self.encoding.size))

    def farthest(self, rng: np.random.Generator, samples: int, count: int) -> Floats:
        """Draw `samples` uniform points, and return the `count` of them farthest from all earlier candidates.

        The farthest one is first, shape (count, n).
        """
        vectors = self.uniform(rng, samples)
        if not self._vectors:
            return vectors[:count]
        points = self.encoding.features(vectors)
        known = self.encoding.features(np.array(self._vectors))
        with threadpool_limits(limits=1):  # otherwise ties would depend on the number of threads
            products = points @ known.T
        squared = (points**2).sum(1)[:, None] + (known**2).sum(1) - 2 * products
        return vectors[np.argsort(-squared.min(1), kind="stable")[:count]]

    def has_asked(self, vector: Floats) -> bool:
        """Return whether the scenario of a point, shape (n,), has been a candidate."""
        return self.encoding.decode(vector) in self._asked

    def candidate(self, vector: Floats, rng: np.random.Generator, origin: str, parent: int | None = None) -> Candidate:
        """Make the next candidate.

        Args:
            vector: point of its scenario, shape (n,).
            rng: random generator, used if the scenario is not new and NPCs must be redrawn.
            origin: origin of the candidate; see `Candidate`.
            parent: parent of the candidate; see `Candidate`.

        Raises:
            InputError: if no new scenario was found.
        """
        scenario = self.encoding.decode(vector)
        for _ in range(_ATTEMPTS):
            if scenario not in self._asked:
                break
            blocks = vector.reshape(self.encoding.n_blocks, -1).copy()
            blocks[rng.integers(len(blocks))] = rng.random(self.encoding.n_genes)
            vector = blocks.ravel()
            scenario = self.encoding.decode(vector)
        else:
            raise InputError(f"No new scenario in {_ATTEMPTS} attempts: the search space is exhausted")
        number = self._number
        self._number += 1
        self._asked.add(scenario)
        self._in_flight[number] = vector = self.encoding.encode(scenario)
        self._vectors.append(vector)
        return Candidate(number, scenario, origin, parent)

    def told(self, candidate: Candidate) -> Floats:
        """Return the point of a told candidate, shape (n,). It encodes the executed scenario, after any repair."""
        return self._in_flight.pop(candidate.number)


def objectives(verdict: Verdict) -> Floats:
    """Compute the distance of an execution from violating each spec, in [0, 1); shape (specs,).

    An objective is 0 if and only if the spec is violated. Otherwise, a degree d becomes (d + e) / (d + e + 1), the
    usual normalization of search-based testing (Arcuri, "It really does matter how you normalize the branch distance",
    STVR 2013). It keeps the order and needs no upper limit of the degree. The small e distinguishes an execution that
    came arbitrarily close to a violation from one that violates the spec.
    """
    degrees = np.maximum(np.array(list(verdict.degrees.values())), 0.0) + _APART
    violated = [name in verdict.violated for name in verdict.degrees]
    return np.where(violated, 0.0, degrees / (degrees + 1))
