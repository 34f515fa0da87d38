"""MAP-Elites: the most dangerous scenario of every kind of behavior, in an archive of pyribs.

Source: Mouret and Clune, "Illuminating search spaces by mapping elites", 2015. The variation is that of Vassiliades and
Mouret, "Discovering the elite hypervolume by leveraging interspecies correlation", GECCO 2018. The archive is that of
pyribs (Tjanaka et al., GECCO 2023).
"""

from collections.abc import Mapping
from dataclasses import field
from typing import Annotated, Any, ClassVar

import numpy as np

from behavexplor.data.logical import LogicalScenario
from behavexplor.data.trace import Trace
from behavexplor.data.validation import between, validated
from behavexplor.errors import InputError, missing_library
from behavexplor.fuzz.search import Candidate
from behavexplor.fuzz.variation import ELITES, Measure, VariationOptions, ask_elites, check_measures, describe
from behavexplor.fuzz.vector_search import Asker
from behavexplor.judge.specs import Verdict

MAX_CELLS = 1_000_000


@validated
class MAPElitesOptions:
    """Options of `MAPElites`.

    Attributes:
        initial: number of uniform scenarios executed before the first variation.
        measures: dimensions of the archive; see `behavexplor.fuzz.variation`.
        bins: number of cells along each measure.
        variation: options for the variation of elites.

    Raises:
        InputError: if an option is out of range; the message names it.
    """

    initial: Annotated[int, between(1)] = 20
    measures: tuple[Measure, ...] = ("mean-speed", "braking")
    bins: Annotated[int, between(1)] = 12
    variation: VariationOptions = field(default_factory=VariationOptions)

    def __post_init__(self) -> None:
        check_measures(self.measures)
        cells = self.bins ** len(self.measures)
        if cells > MAX_CELLS:
            raise InputError(f"bins: {cells} cells are more than {MAX_CELLS}; give fewer bins or fewer measures")


class MAPElites:
    """MAP-Elites: the scenario with the lowest violation degree for every kind of behavior (needs pyribs)."""

    Options: ClassVar[type] = MAPElitesOptions

    def __init__(self, logical: LogicalScenario, seed: int, options: MAPElitesOptions) -> None:
        self._options = options
        self._asker = Asker(logical, seed)
        self._archive = _archive(self._asker.encoding.size, options)

    def ask(self) -> Candidate:
        """Return a uniform scenario at first, then variations of elites."""
        return ask_elites(self._asker, self._archive, self._options.initial, self._options.variation)

    def tell(self, candidate: Candidate, trace: Trace, verdict: Verdict) -> Mapping[str, Any]:
        """Put a scenario into its cell, if the cell is empty or the scenario is better than the cell's elite.

        Returns:
            The `cell` of the scenario, and whether it was `kept`.
        """
        measures = describe(trace, self._options.measures)
        objective = 0.0 if verdict.failed else -verdict.degree
        status = self._archive.add_single(
            self._asker.told(candidate), objective, measures, **{ELITES: candidate.number}
        )["status"]
        return {"cell": int(self._archive.index_of_single(measures)), "kept": bool(np.ravel(status)[0] > 0)}

    def status(self) -> Mapping[str, float]:
        """Return the number of cells with an elite, and their share of all cells."""
        return {"elites": len(self._archive), "coverage": float(self._archive.stats.coverage)}


def _archive(size: int, options: MAPElitesOptions) -> Any:
    """Create an archive of pyribs.

    Raises:
        InputError: if pyribs is not installed.
    """
    try:
        from ribs.archives import GridArchive  # noqa: PLC0415 - slow to import
    except ImportError as error:
        raise missing_library("The search method 'map-elites'", "pyribs", "search") from error
    return GridArchive(
        solution_dim=size,
        dims=[options.bins] * len(options.measures),
        ranges=[(0.0, 1.0)] * len(options.measures),
        extra_fields={ELITES: ((), np.int64)},
        seed=0,
    )
