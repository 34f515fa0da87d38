"""The corpus: the scenarios that a search keeps to mutate, each with its record."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from behavexplor.data.array_types import Floats
from behavexplor.data.scenario import Scenario

SELECTION_CHANGE = -0.05  # dE_S, the decay with each selection
_BENIGN_SHARE = 0.1  # a passed mutant costs less energy than a failed one adds
GAMMA = 1e-5  # gamma of equation 16, against division by zero


def failure_change(failed: bool, n_failed: int, n_passed: int) -> float:
    """Compute dE_F of the parent (paper equation 15).

    Args:
        failed: whether the last mutant of the parent failed.
        n_failed: #F, number of mutants that failed, including the last one.
        n_passed: #NF, number of mutants that did not fail, including the last one.
    """
    if failed:
        return n_failed / (n_passed + n_failed)
    return -_BENIGN_SHARE * n_passed / (n_passed + n_failed)


def degree_change(parent_degree: float, degree: float, distance: float, *, bounded: bool, gamma: float) -> float:
    """Compute dE_V of a mutant and its parent (paper equation 16).

    Args:
        parent_degree: O_s, the violation degree of the parent [m].
        degree: O_s', the violation degree of the mutant [m].
        distance: dis(s', s), the distance of their behaviors, in [0, 1].
        bounded: whether the printed formula is bounded by tanh. Unbounded, a single mutant at distance 1 changes the
            energy by 1e5 per meter, and the selection never recovers from it.
        gamma: the small number in the denominator, against division by zero.
    """
    change = (parent_degree - degree) / (1 - distance + gamma)
    return math.tanh(change) if bounded else change


def selection_probabilities(energies: Floats) -> Floats:
    """Compute p_i of each testcase (paper equation 18), normalized over the positive energies so that they sum to 1.

    Args:
        energies: E of each testcase, shape (n,). If none is positive, all testcases are equally likely.

    Returns:
        Probabilities, shape (n,).
    """
    weights = np.maximum(energies, 0.0)
    total = weights.sum()
    return np.asarray(weights / total if total > 0 else np.full(len(weights), 1 / len(weights)))


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
