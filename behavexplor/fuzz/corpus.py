"""The corpus: the scenarios that a search keeps to mutate, each with its record."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from behavexplor.data.array_types import Floats
from behavexplor.data.scenario import Scenario
from behavexplor.fuzz.energy import selection_probabilities


@dataclass(slots=True)
class Testcase:
    """A kept scenario with its record. The paper calls it a seed.

    Attributes:
        number: number of the candidate that became this testcase.
        scenario: the scenario to mutate.
        parent: number of the testcase from which it was mutated, if any.
        degree: violation degree of its execution, the paper's O [m].
        behavior: index of its behavior in the miner.
        selections: number of times that it was selected.
        n_failed: number of its mutants that failed, the paper's #F.
        n_passed: number of its mutants that did not fail, the paper's #NF.
    """

    __test__ = False  # keeps pytest from collecting the class

    number: int
    scenario: Scenario
    parent: int | None
    degree: float
    behavior: int
    selections: int = 0
    n_failed: int = 0
    n_passed: int = 0


class Corpus:
    """Testcases in the order in which they were kept, with their energies. Failures never become testcases."""

    def __init__(self) -> None:
        self._testcases: list[Testcase] = []
        self._places: dict[int, int] = {}  # by the number of the candidate
        self._energies = np.zeros(16)  # grows by doubling, so that no execution pays for the whole corpus

    def __len__(self) -> int:
        return len(self._testcases)

    def __iter__(self) -> Iterator[Testcase]:
        return iter(self._testcases)

    def __getitem__(self, number: int) -> Testcase:
        """Return the testcase with the given candidate number."""
        return self._testcases[self._places[number]]

    @property
    def energies(self) -> Floats:
        """The paper's E of each testcase, in their order, shape (len(self),)."""
        return self._energies[: len(self)]

    def add(self, testcase: Testcase, energy: float) -> None:
        """Add a testcase with its initial energy."""
        if len(self) == len(self._energies):
            self._energies = np.concatenate([self._energies, np.zeros(len(self))])
        self._places[testcase.number] = len(self)
        self._testcases.append(testcase)
        self.set_energy(testcase.number, energy)

    def energy(self, number: int) -> float:
        """Return the energy of the testcase with the given candidate number."""
        return float(self._energies[self._places[number]])

    def set_energy(self, number: int, energy: float) -> None:
        """Change the energy of the testcase with the given candidate number."""
        self._energies[self._places[number]] = energy

    def select(self, rng: np.random.Generator, *, uniform: bool = False) -> Testcase:
        """Draw a testcase by energy (paper equation 18) or uniformly, and record the selection."""
        energies = np.zeros(len(self)) if uniform else self.energies
        chosen = self._testcases[rng.choice(len(self), p=selection_probabilities(energies))]
        chosen.selections += 1
        return chosen
