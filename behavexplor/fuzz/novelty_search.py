"""Novelty search: scenarios whose executions differ from all earlier ones, in an archive of pyribs.

Source: Lehman and Stanley, "Abandoning objectives: evolution through the search for novelty alone", Evolutionary
Computation 19(2), 2011. The archive is that of pyribs (Tjanaka et al., GECCO 2023).
"""

from collections.abc import Mapping
from dataclasses import field
from typing import Annotated, Any, ClassVar

import numpy as np

from behavexplor.data.logical import LogicalScenario
from behavexplor.data.trace import Trace
from behavexplor.data.validation import between, validated
from behavexplor.errors import missing_library
from behavexplor.fuzz.search import Candidate
from behavexplor.fuzz.variation import ELITES, SCALES, Measure, VariationOptions, ask_elites, check_measures, describe
from behavexplor.fuzz.vector_search import Asker
from behavexplor.judge.specs import Verdict


@validated
class NoveltySearchOptions:
    """Options of `NoveltySearch`.

    Attributes:
        initial: number of uniform scenarios executed before the first variation.
        measures: measures that distinguish behaviors; see `behavexplor.fuzz.variation`.
        neighbors: number of nearest neighbors whose mean distance is the novelty.
        threshold: least novelty of a kept scenario, in the space of the measures, each of which spans [0, 1].
        variation: options for the variation of kept scenarios.

    Raises:
        InputError: if an option is out of range; the message names it.
    """

    initial: Annotated[int, between(1)] = 20
    measures: tuple[Measure, ...] = tuple(SCALES)
    neighbors: Annotated[int, between(1)] = 15
    threshold: Annotated[float, between(0)] = 0.1
    variation: VariationOptions = field(default_factory=VariationOptions)

    def __post_init__(self) -> None:
        check_measures(self.measures)


class NoveltySearch:
    """Novelty search: scenarios whose behavior is new, regardless of their violation degree (needs pyribs)."""

    Options: ClassVar[type] = NoveltySearchOptions

    def __init__(self, logical: LogicalScenario, seed: int, options: NoveltySearchOptions) -> None:
        self._options = options
        self._asker = Asker(logical, seed)
        self._archive = _archive(self._asker.encoding.size, options)

    def ask(self) -> Candidate:
        """Return a uniform scenario at first, then variations of kept scenarios."""
        return ask_elites(self._asker, self._archive, self._options.initial, self._options.variation)

    def tell(self, candidate: Candidate, trace: Trace, verdict: Verdict) -> Mapping[str, Any]:  # noqa: ARG002
        """Keep a scenario if its execution was novel.

        Returns:
            The mean `distance` from the nearest kept executions (1 for the first), and whether it was `kept`.
        """
        measures = describe(trace, self._options.measures)
        first = self._archive.empty
        added = self._archive.add_single(self._asker.told(candidate), None, measures, **{ELITES: candidate.number})
        return {
            "distance": 1.0 if first else float(np.ravel(added["novelty"])[0]),
            "kept": bool(np.ravel(added["status"])[0] > 0),
        }

    def status(self) -> Mapping[str, float]:
        """Return the size of the archive."""
        return {"archive": len(self._archive)}


def _archive(size: int, options: NoveltySearchOptions) -> Any:
    """Create an archive of pyribs.

    Raises:
        InputError: if pyribs is not installed.
    """
    try:
        from ribs.archives import ProximityArchive  # noqa: PLC0415 - slow to import
    except ImportError as error:
        raise missing_library("The search method 'novelty-search'", "pyribs", "search") from error
    return ProximityArchive(
        solution_dim=size,
        measure_dim=len(options.measures),
        k_neighbors=options.neighbors,
        novelty_threshold=options.threshold,
        extra_fields={ELITES: ((), np.int64)},
        seed=0,
    )
