"""The corpus: the scenarios that a search keeps to mutate, each with its record."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

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
        energy: the paper's E.
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
    energy: float
    selections: int = 0
    n_failed: int = 0
    n_passed: int = 0


class Corpus:
    """Testcases in the order in which they were kept. Failures never become testcases."""

    def __init__(self) -> None:
        self._testcases: dict[int, Testcase] = {}

    def __len__(self) -> int:
        return len(self._testcases)

    def __iter__(self) -> Iterator[Testcase]:
        return iter(self._testcases.values())

    def __getitem__(self, number: int) -> Testcase:
        """Return the testcase with the given candidate number."""
        return self._testcases[number]

    def add(self, testcase: Testcase) -> None:
        """Add a testcase."""
        self._testcases[testcase.number] = testcase

    def select(self, rng: np.random.Generator, *, uniform: bool = False) -> Testcase:
        """Draw a testcase by energy (paper equation 18) or uniformly, and record the selection."""
        testcases = list(self)
        energies = np.array([0.0 if uniform else testcase.energy for testcase in testcases])
        chosen = testcases[rng.choice(len(testcases), p=selection_probabilities(energies))]
        chosen.selections += 1
        return chosen
