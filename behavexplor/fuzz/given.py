"""Given scenarios, one after the other: no search, for repeating what was found with another driver."""

from pathlib import Path
from typing import ClassVar, Final

from behavexplor.data.scenario import LogicalScenario, read_scenarios
from behavexplor.data.validation import validated
from behavexplor.fuzz.search import Candidate, SearchExhausted, WithoutLearning

GIVEN: Final = "given"  # origin of candidates


@validated
class GivenOptions:
    """Options of `Given`."""

    file: str  # file with one scenario as JSON in each line


class Given(WithoutLearning):
    """Given scenarios: every scenario of a file, in order."""

    Options: ClassVar[type] = GivenOptions

    def __init__(self, logical: LogicalScenario, seed: int, options: GivenOptions) -> None:  # noqa: ARG002
        self._scenarios = read_scenarios(Path(options.file), logical)
        self._asked = 0

    def ask(self) -> Candidate:
        """Return the next scenario."""
        if self._asked == len(self._scenarios):
            raise SearchExhausted(f"All {self._asked} given scenarios have been executed.")
        self._asked += 1
        return Candidate(self._asked - 1, self._scenarios[self._asked - 1], GIVEN, None)
