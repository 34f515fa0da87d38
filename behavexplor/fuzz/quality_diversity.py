"""MAP-Elites and novelty search: an archive of pyribs keeps scenarios (elites), of which variations are executed.

MAP-Elites keeps the most dangerous scenario of every kind of behavior, and novelty search those whose executions differ
from all earlier ones.

Sources: Mouret and Clune, "Illuminating search spaces by mapping elites", 2015; Lehman and Stanley, "Abandoning
objectives: evolution through the search for novelty alone", Evolutionary Computation 19(2), 2011. The variation is that
of Vassiliades and Mouret, "Discovering the elite hypervolume by leveraging interspecies correlation", GECCO 2018. The
archives are those of pyribs (Tjanaka et al., GECCO 2023).
"""

from collections.abc import Mapping, Sequence
from dataclasses import field
from importlib import import_module
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Final, Literal

import numpy as np

from behavexplor.behavior.features import ATTRIBUTES, state_matrix
from behavexplor.data.array_types import Floats
from behavexplor.data.conventions import STANDING_SPEED
from behavexplor.data.scenario import LogicalScenario
from behavexplor.data.trace import Trace
from behavexplor.data.validation import between, validated
from behavexplor.errors import InputError, missing_library
from behavexplor.fuzz.search import INITIAL, Candidate
from behavexplor.fuzz.vector_search import Asker
from behavexplor.judge.specs import Verdict

MAX_CELLS = 1_000_000
VARIATION: Final = "variation"  # origin of candidates
ELITES: Final = "number"  # archive field with the candidate number of each elite
Measure = Literal["mean-speed", "braking", "cornering", "standing", "duration"]
SCALES: Mapping[Measure, float] = MappingProxyType(  # values that are scaled to 1; greater values are clipped to 1
    {
        "mean-speed": 12.0,  # mean speed of the ego [m/s]
        "braking": 8.0,  # hardest braking of the ego [m/s2]
        "cornering": 4.0,  # greatest acceleration of the ego across its heading [m/s2]
        "standing": 1.0,  # share of the time in which the ego stood still
        "duration": 120.0,  # duration of the execution [s]
    }
)


def describe(trace: Trace, measures: Sequence[Measure]) -> Floats:
    """Compute measures of the ego's behavior in an execution, each in [0, 1], shape (measures,)."""
    states = dict(zip(ATTRIBUTES, state_matrix(trace).astype(np.float64).T, strict=True))
    speed = states["speed"]
    values = {
        "mean-speed": speed.mean() if len(speed) else 0.0,
        "braking": -states["speed-change"].min(initial=0.0),
        "cornering": np.abs(states["acceleration-across"]).max(initial=0.0),
        "standing": (speed < STANDING_SPEED).mean() if len(speed) else 1.0,
        "duration": trace.duration,
    }
    return np.asarray(np.clip([values[name] / SCALES[name] for name in measures], 0.0, 1.0))


def check_measures(measures: Sequence[Measure]) -> None:
    """Check that there is at least one measure, and that no measure is named twice.

    Raises:
        InputError: if there is none, or one is named twice.
    """
    if not measures or len(set(measures)) < len(measures):
        raise InputError(f"measures: name at least one, and each only once; got {', '.join(measures) or 'none'}")


@validated
class VariationOptions:
    """Normal variation along the line through two elites (Vassiliades and Mouret, GECCO 2018, equation 1)."""

    iso_sigma: Annotated[float, between(1e-3, 1)] = 0.05  # standard deviation of a gene's noise, in shares of its range
    line_sigma: Annotated[float, between(0, 10)] = 0.2  # same for the step to the second elite, in shares of the way
    # probability that an NPC stays as in the first elite. Noise on all NPCs at once would destroy most of what made the
    # elite good.
    npc_keep_probability: Annotated[float, between(0, 0.95)] = 0.5


class EliteSearch:
    """The part that both methods share: uniform scenarios at first, then variations of two uniformly drawn elites.

    `archive` is the name of a class of pyribs, made with the `settings`. `options` have `initial` and a `variation`.

    Raises:
        InputError: if pyribs is not installed.
    """

    _name: ClassVar[str]

    def __init__(self, logical: LogicalScenario, seed: int, options: Any, archive: str, **settings: Any) -> None:
        self._options = options
        self._asker = Asker(logical, seed)
        try:
            archives = import_module("ribs.archives")  # slow to import
        except ImportError as error:
            raise missing_library(f"The search method {self._name!r}", "pyribs", "search") from error
        make, size = getattr(archives, archive), self._asker.encoding.size
        self._archive: Any = make(solution_dim=size, extra_fields={ELITES: ((), np.int64)}, seed=0, **settings)

    @property
    def foreseen(self) -> int:
        """Number of uniform scenarios that are left to ask for."""
        return max(int(self._options.initial) - self._asker.asked, 0)

    def ask(self) -> Candidate:
        """Return a uniform scenario at first, and while the archive is empty, then variations of elites."""
        rng = self._asker.draws()
        if self._archive.empty or self._asker.asked < self._options.initial:
            return self._asker.candidate(self._asker.uniform(rng)[0], rng, INITIAL)
        return self._varied(rng)

    def _varied(self, rng: np.random.Generator) -> Candidate:
        from ribs.emitters.operators import IsoLineOperator  # noqa: PLC0415 - slow to import

        options: VariationOptions = self._options.variation
        elites = self._archive.data(["solution", ELITES])
        first, second = rng.integers(len(elites[ELITES]), size=2)
        parents = elites["solution"][[first, second]]
        operator = IsoLineOperator(options.iso_sigma, options.line_sigma, seed=int(rng.integers(2**63)))
        blocks = operator.ask(parents[:, None])[0].reshape(self._asker.encoding.n_blocks, -1)
        stay = rng.random(len(blocks)) < options.npc_keep_probability
        blocks[stay] = parents[0].reshape(blocks.shape)[stay]
        return self._asker.candidate(np.clip(blocks.ravel(), 0.0, 1.0), rng, VARIATION, int(elites[ELITES][first]))


@validated
class MAPElitesOptions:
    """Options of `MAPElites`."""

    initial: Annotated[int, between(1)] = 20  # number of uniform scenarios executed before the first variation
    measures: tuple[Measure, ...] = ("mean-speed", "braking")  # dimensions of the archive; see `SCALES`
    bins: Annotated[int, between(1)] = 12  # number of cells along each measure
    variation: VariationOptions = field(default_factory=VariationOptions)

    def __post_init__(self) -> None:
        check_measures(self.measures)
        cells = self.bins ** len(self.measures)
        if cells > MAX_CELLS:
            raise InputError(f"bins: {cells} cells are more than {MAX_CELLS}; give fewer bins or fewer measures")


class MAPElites(EliteSearch):
    """MAP-Elites: the scenario with the lowest violation degree for every kind of behavior (needs pyribs)."""

    Options: ClassVar[type] = MAPElitesOptions
    _name = "map-elites"

    def __init__(self, logical: LogicalScenario, seed: int, options: MAPElitesOptions) -> None:
        n = len(options.measures)
        super().__init__(logical, seed, options, "GridArchive", dims=[options.bins] * n, ranges=[(0.0, 1.0)] * n)

    def tell(self, candidate: Candidate, trace: Trace, verdict: Verdict) -> Mapping[str, Any]:
        """Put a scenario into its cell if no elite there is as good; return the `cell`, and whether it was `kept`."""
        measures = describe(trace, self._options.measures)
        objective = 0.0 if verdict.failed else -verdict.degree
        added = self._archive.add_single(self._asker.told(candidate), objective, measures, **{ELITES: candidate.number})
        return {"cell": int(self._archive.index_of_single(measures)), "kept": bool(np.ravel(added["status"])[0] > 0)}

    def status(self) -> Mapping[str, float]:
        """Return the number of cells with an elite, and their share of all cells."""
        return {"elites": len(self._archive), "coverage": float(self._archive.stats.coverage)}


@validated
class NoveltySearchOptions:
    """Options of `NoveltySearch`."""

    initial: Annotated[int, between(1)] = 20  # number of uniform scenarios executed before the first variation
    measures: tuple[Measure, ...] = tuple(SCALES)  # measures that distinguish behaviors; see `SCALES`
    neighbors: Annotated[int, between(1)] = 15  # number of nearest neighbors whose mean distance is the novelty
    threshold: Annotated[float, between(0)] = 0.1  # least novelty of a kept scenario; each measure spans [0, 1]
    variation: VariationOptions = field(default_factory=VariationOptions)

    def __post_init__(self) -> None:
        check_measures(self.measures)


class NoveltySearch(EliteSearch):
    """Novelty search: scenarios whose behavior is new, regardless of their violation degree (needs pyribs)."""

    Options: ClassVar[type] = NoveltySearchOptions
    _name = "novelty-search"

    def __init__(self, logical: LogicalScenario, seed: int, options: NoveltySearchOptions) -> None:
        settings = {"k_neighbors": options.neighbors, "novelty_threshold": options.threshold}
        super().__init__(logical, seed, options, "ProximityArchive", measure_dim=len(options.measures), **settings)

    def tell(self, candidate: Candidate, trace: Trace, verdict: Verdict) -> Mapping[str, Any]:  # noqa: ARG002
        """Keep a novel scenario. Return its novelty as `distance` (1 for the first one), and whether it was `kept`."""
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
