"""The corpus: the scenarios that a search keeps to make others from, each with its record."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from behavexplor.data.scenario import Scenario
from behavexplor.fuzz.energy import selection_probabilities


@dataclass(slots=True)
class Testcase:
    """A kept scenario with its record; the paper calls it a seed.

    Attributes:
        number: of the candidate that it was.
        scenario: what is mutated.
        parent: number of the testcase that it was made from, if any.
        degree: violation degree of its execution, the paper's O [m].
        behavior: index of its behavior in the miner.
        energy: the paper's E.
        selections: how often it was selected.
        n_failed: how many of its mutants failed, the paper's #F.
        n_passed: how many did not, #NF.
    """

    __test__ = False  # pytest, this is not yours

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
    """Testcases in the order they were kept; failures never become testcases."""

    def __init__(self) -> None:
        self._testcases: dict[int, Testcase] = {}

    def __len__(self) -> int:
        return len(self._testcases)

    def __iter__(self) -> Iterator[Testcase]:
        return iter(self._testcases.values())

    def __getitem__(self, number: int) -> Testcase:
        """The testcase that was the candidate of this number."""
        return self._testcases[number]

    def add(self, testcase: Testcase) -> None:
        """Keep a testcase."""
        self._testcases[testcase.number] = testcase

    def select(self, rng: np.random.Generator, *, uniform: bool = False) -> Testcase:
        """A testcase drawn by energy (paper equation 18), or uniformly; the selection is recorded."""
        testcases = list(self)
        energies = np.array([0.0 if uniform else testcase.energy for testcase in testcases])
        chosen = testcases[rng.choice(len(testcases), p=selection_probabilities(energies))]
        chosen.selections += 1
        return chosen
