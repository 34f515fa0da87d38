"""What the methods that search vectors have in common when they are asked: numbers, draws, and no scenario twice."""

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from behavexplor.data.logical import LogicalScenario
from behavexplor.data.scenario import Scenario
from behavexplor.errors import InputError
from behavexplor.fuzz.encoding import Encoding
from behavexplor.fuzz.search import Candidate, draws

Floats = NDArray[np.float64]

_ATTEMPTS = 1000


class Asker:
    """Makes candidates of vectors, and remembers those in flight.

    Executing a scenario twice teaches nothing. Where a method makes one that it asked for before, such as a copy
    of a parent, one NPC of it is drawn afresh.
    """

    def __init__(self, logical: LogicalScenario, seed: int) -> None:
        self.encoding = Encoding(logical)
        self._seed = seed
        self._number = 0
        self._asked: set[Scenario] = set()
        self._in_flight: dict[int, Floats] = {}
        self._vectors: list[Floats] = []

    @property
    def asked(self) -> int:
        """How many candidates there were."""
        return self._number

    def draws(self) -> np.random.Generator:
        """The random numbers of the next candidate."""
        return draws(self._seed, self._number)

    def uniform(self, rng: np.random.Generator, count: int = 1) -> Floats:
        """Uniform points, shape (count, n)."""
        return rng.random((count, self.encoding.size))

    def farthest(self, rng: np.random.Generator, samples: int, count: int) -> Floats:
        """Of uniform points those farthest from all that was asked for.

        Args:
            rng: source of the draws.
            samples: how many points are drawn.
            count: how many of them are returned.

        Returns:
            Shape (count, n), the farthest one first.
        """
        vectors = self.uniform(rng, samples)
        if not self._vectors:
            return vectors[:count]
        points = self.encoding.features(vectors)
        known = self.encoding.features(np.array(self._vectors))
        with threadpool_limits(limits=1):  # as many threads as there are would decide ties
            products = points @ known.T
        squared = (points**2).sum(1)[:, None] + (known**2).sum(1) - 2 * products
        return vectors[np.argsort(-squared.min(1), kind="stable")[:count]]

    def candidate(self, vector: Floats, rng: np.random.Generator, origin: str, parent: int | None = None) -> Candidate:
        """The next candidate.

        Args:
            vector: the point of its scenario, shape (n,).
            rng: for what has to be drawn to make the scenario a new one.
            origin: see `Candidate`.
            parent: see `Candidate`.

        Raises:
            InputError: if there is no new scenario.
        """
        scenario = self.encoding.decode(vector)
        for _ in range(_ATTEMPTS):
            if scenario not in self._asked:
                break
            blocks = vector.reshape(self.encoding.n_npcs, -1).copy()
            blocks[rng.integers(len(blocks))] = rng.random(self.encoding.n_genes)
            vector = blocks.ravel()
            scenario = self.encoding.decode(vector)
        else:
            raise InputError(f"None of {_ATTEMPTS} scenarios was new: nothing is left to search")
        number = self._number
        self._number += 1
        self._asked.add(scenario)
        self._in_flight[number] = vector = self.encoding.encode(scenario)
        self._vectors.append(vector)
        return Candidate(number, scenario, origin, parent)

    def told(self, candidate: Candidate) -> Floats:
        """The point of a candidate that is told, shape (n,): of the scenario that was run, after any repair."""
        return self._in_flight.pop(candidate.number)
