"""Uniform sampling: the baseline that every search must beat."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from behavexplor.data.logical import LogicalScenario
from behavexplor.data.trace import Trace
from behavexplor.fuzz.search import UNIFORM, Candidate, draws
from behavexplor.judge.specs import Verdict


@dataclass(frozen=True)
class UniformOptions:
    """Uniform sampling has no options."""


class Uniform:
    """Every scenario drawn afresh, each parameter uniform in its range; nothing is learned."""

    Options: ClassVar[type] = UniformOptions

    def __init__(self, logical: LogicalScenario, seed: int, options: UniformOptions) -> None:  # noqa: ARG002
        self._logical = logical
        self._seed = seed
        self._asked = 0

    def ask(self) -> Candidate:
        """The next scenario, from the sampler."""
        number = self._asked
        self._asked += 1
        return Candidate(number, self._logical.sample(draws(self._seed, number)), UNIFORM, None)

    def tell(self, candidate: Candidate, trace: Trace, verdict: Verdict) -> Mapping[str, Any]:  # noqa: ARG002
        """Nothing is learned."""
        return {}

    def status(self) -> Mapping[str, float]:
        """Nothing to show."""
        return {}
