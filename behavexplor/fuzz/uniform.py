"""Uniform sampling, the baseline that every search must beat."""

import sys
from collections.abc import Mapping
from typing import Any, ClassVar

from behavexplor.data.scenario import LogicalScenario
from behavexplor.data.trace import Trace
from behavexplor.data.validation import validated
from behavexplor.fuzz.search import Candidate, UniformCandidate
from behavexplor.judge.specs import Verdict


@validated
class UniformOptions:
    """Uniform sampling has no options."""


class Uniform:
    """Uniform sampling: every scenario is drawn independently, with each parameter uniform in its range."""

    Options: ClassVar[type] = UniformOptions
    foreseen = sys.maxsize  # no result changes any candidate, see `behavexplor.fuzz.search.SearchMethod`

    def __init__(self, logical: LogicalScenario, seed: int, options: UniformOptions) -> None:  # noqa: ARG002
        self._logical = logical
        self._seed = seed
        self._asked = 0

    def ask(self) -> Candidate:
        """Return the next candidate, which draws its scenario when that is first used; see `UniformCandidate`."""
        number = self._asked
        self._asked += 1
        return UniformCandidate(number, self._logical, self._seed)

    def tell(self, candidate: Candidate, trace: Trace, verdict: Verdict) -> Mapping[str, Any]:  # noqa: ARG002
        """Ignore the execution, since nothing is learned."""
        return {}

    def status(self) -> Mapping[str, float]:
        """Return no figures."""
        return {}
