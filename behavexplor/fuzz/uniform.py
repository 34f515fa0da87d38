"""Uniform sampling, the baseline that every search must beat."""

from typing import ClassVar

from behavexplor.data.scenario import LogicalScenario
from behavexplor.data.validation import validated
from behavexplor.fuzz.search import Candidate, UniformCandidate, WithoutLearning


@validated
class UniformOptions:
    """Uniform sampling has no options."""


class Uniform(WithoutLearning):
    """Uniform sampling: every scenario is drawn independently, with each parameter uniform in its range."""

    Options: ClassVar[type] = UniformOptions

    def __init__(self, logical: LogicalScenario, seed: int, options: UniformOptions) -> None:  # noqa: ARG002
        self._logical = logical
        self._seed = seed
        self._asked = 0

    def ask(self) -> Candidate:
        """Return the next candidate, which draws its scenario when that is first used; see `UniformCandidate`."""
        number = self._asked
        self._asked += 1
        return UniformCandidate(number, self._logical, self._seed)
